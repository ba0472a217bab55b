"""`alula link` prints its report as a table or as JSON, and ends with an exit code that a script can use."""

from __future__ import annotations

import json
import sys

import pytest

from alula.cli.app import main
from simulation.mock_process import free_port
from tests.support.fake_vehicle import FakeVehicle

pytestmark = pytest.mark.realtime(alone=False)


def run(monkeypatch: pytest.MonkeyPatch, *arguments: str) -> int:
    monkeypatch.setattr(sys, "argv", ["alula", "link", *arguments])
    with pytest.raises(SystemExit) as end:
        main()
    return int(end.value.code or 0)


def test_a_link_that_never_speaks_ends_with_4(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(monkeypatch, "--link", f"udpin:127.0.0.1:{free_port()}", "--timeout", "0.2") == 4
    message = capsys.readouterr().err
    assert "No MAVLink arrived" in message
    assert "Traceback" not in message


def test_a_bad_connection_string_ends_with_2(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(monkeypatch, "--link", "ttyACM0") == 2
    assert "Give one of: udpin:0.0.0.0:14540" in capsys.readouterr().err


@pytest.mark.parametrize("as_json", [True, False])
def test_a_vehicle_without_an_estimate_is_reported_and_ends_with_4(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], as_json: bool
) -> None:
    port = free_port()
    with FakeVehicle(("127.0.0.1", port)) as vehicle:
        vehicle.parameters = {}
        code = run(
            monkeypatch, "--link", f"udpin:127.0.0.1:{port}", "--window", "0.5", *(["--json"] if as_json else [])
        )
    shown = capsys.readouterr()
    assert code == 4
    assert "the reasons are in the report" in shown.err
    if as_json:
        report = json.loads(shown.out)
        assert (report["vehicle"]["system"], report["is_ready"]) == (1, False)
        assert [stream["name"] for stream in report["streams"]] == ["ODOMETRY", "HIGHRES_IMU", "ATTITUDE_QUATERNION"]
    else:
        assert "HOLD" in shown.out
        assert "No state estimate arrived" in shown.out
