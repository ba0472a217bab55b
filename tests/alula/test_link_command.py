"""`alula link` prints its report as a table or as JSON, and ends with an exit code that a script can use."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import pytest

from alula.cli.app import main
from simulation.mock_process import free_port, mock_process
from tests.support.fake_vehicle import FakeVehicle

pytestmark = pytest.mark.realtime(repeats_only=True)


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


@pytest.mark.long("six checks of a link, each of some seconds")
def test_a_key_is_made_set_up_and_required(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    """Over the mock, which signs by pymavlink; whether it would fly at once is another matter."""
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    key, other = str(tmp_path / "my.key"), str(tmp_path / "other.key")
    for path in (key, other):
        assert run(monkeypatch, "--new-signing-key", path) == 0
    assert run(monkeypatch, "--link", "udpin:0.0.0.0:0", "--setup-signing", key) == 2
    assert "sent in the clear" in capsys.readouterr().err

    def report(*arguments: str) -> dict[str, Any]:
        assert run(monkeypatch, "--link", mock.url, "--window", "0.5", "--json", *arguments) in (0, 4)
        return dict(json.loads(capsys.readouterr().out))

    with mock_process() as mock:
        assert report()["signing"]["autopilot_signs"] is False
        signing = report("--setup-signing", key)["signing"]
        assert signing["required"]
        assert signing["autopilot_signs"]
        assert signing["signed"] > 100
        unsigned = report()
        assert any("signs its messages" in problem["text"] for problem in unsigned["problems"])
        assert run(monkeypatch, "--link", mock.url, "--timeout", "2", "--signing-key", other) == 4
        assert "wrong key. Then give the key that the autopilot has" in capsys.readouterr().err
        assert run(monkeypatch, "--link", mock.url, "--timeout", "2", "--setup-signing", other) == 4
        assert "only its present key can change that" in capsys.readouterr().err
        assert report("--signing-key", key, "--setup-signing", other)["signing"]["signed"] > 100
    shown = "".join(path.read_text(errors="replace") for path in (tmp_path / "state").rglob("*.json"))
    assert Path(key).read_text().strip() not in shown
