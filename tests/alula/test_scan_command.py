"""`alula scan` and what `alula inspect` tells of a flight's health: lines, columns, bad files, exit codes."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest

from tests.support.command_line import Run, command_line

LOGS = Path("tests/data/default_rate_logs")
FLIGHT_REVIEW = {
    "Duration", "MavType", "Estimator", "AutostartId", "Hardware", "Software", "SoftwareVersion", "UUID",
    "NumLoggedErrors", "NumLoggedWarnings", "FlightModes", "FlightModeDurations", "StartTime",
}  # fmt: skip


@pytest.fixture
def run(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Run:
    return command_line(monkeypatch, capsys)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    shutil.copy(LOGS / "uavcan.ulg.gz", tmp_path)
    (tmp_path / "picture.ulg").write_bytes(b"\x89PNG\r\n\x1a\n" + bytes(100))
    (tmp_path / "cut.ulg.gz").write_bytes((LOGS / "uavcan.ulg.gz").read_bytes()[:2000])
    (tmp_path / "notes.txt").write_text("no log")
    return tmp_path


@pytest.mark.parametrize("jobs", [1, 2])
def test_every_log_is_a_line_and_bad_ones_have_an_error(run: Run, folder: Path, jobs: int) -> None:
    code, out, err = run("scan", folder, "--jobs", str(jobs))
    assert code == 0, err
    lines = {Path(line["file"]).name: line for line in map(json.loads, out.splitlines())}
    assert set(lines) == {"uavcan.ulg.gz", "picture.ulg", "cut.ulg.gz"}
    assert all(line.keys() >= FLIGHT_REVIEW | {"outcome", "error", "health"} for line in lines.values())
    good = lines["uavcan.ulg.gz"]
    assert (good["outcome"], good["MavType"], good["AutostartId"], good["FlightModes"]) == (
        "ok",
        "Quadrotor",
        4006,
        "3,5",
    )
    assert len(good["health"]["sentences"]) == 2
    assert {name: line["outcome"] for name, line in lines.items() if name != "uavcan.ulg.gz"} == {
        "picture.ulg": "error",
        "cut.ulg.gz": "error",
    }


def test_a_log_without_modes_has_none(run: Run, tmp_path: Path) -> None:
    shutil.copy("tests/data/rotorpy_100hz/flight_0.csv.gz", tmp_path)
    code, out, err = run("scan", tmp_path)
    assert code == 0, err
    line = json.loads(out)
    assert (line["outcome"], line["FlightModes"], line["FlightModeDurations"]) == ("ok", "", "")


def test_lines_go_into_a_file(run: Run, folder: Path, tmp_path: Path) -> None:
    code, out, _ = run("scan", folder, "--out", tmp_path / "scan.ndjson")
    assert (code, out) == (0, "")
    assert len((tmp_path / "scan.ndjson").read_text().splitlines()) == 3


def test_a_folder_without_logs_is_refused(run: Run, tmp_path: Path) -> None:
    code, _, err = run("scan", tmp_path)
    assert code == 2
    assert "no log" in err


def test_none_that_can_be_read_ends_with_3(run: Run, tmp_path: Path) -> None:
    (tmp_path / "picture.ulg").write_bytes(b"\x89PNG\r\n\x1a\n" + bytes(100))
    code, out, _ = run("scan", tmp_path)
    assert code == 3
    assert len(out.splitlines()) == 1


def test_inspect_answers_before_it_refuses_a_log_of_10_hz(run: Run) -> None:
    code, out, err = run("inspect", LOGS / "disconnected_battery.ulg.gz")
    assert code == 3
    assert "unusable" in out
    assert out.index("vibration is") < out.index("unusable")
    assert "Traceback" not in err


def test_inspects_json_has_the_health_beside_what_is_there(run: Run) -> None:
    code, out, _ = run("inspect", LOGS / "no_satellites.ulg.gz", "--json")
    (answer,) = json.loads(out)
    assert code == 3
    assert {"verdict", "sentence", "channels", "health"} <= answer.keys()
    assert answer["health"]["first"] == ""
