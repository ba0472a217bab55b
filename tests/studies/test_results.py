"""Results on disk: which kind a path holds, and what its page shows."""

from __future__ import annotations

import shutil
from pathlib import Path

import msgspec
import pytest

from dynamics.errors import DataError, RequestError
from dynamics.files import write_json
from studies.evaluation.run import EvaluationAnswer
from studies.fleet.files import ABOUT as FLEET_ABOUT
from studies.fleet.files import LINES, FleetAbout
from studies.fleet.flight import FleetFlight
from studies.results.kinds import kind_of, stamp
from studies.results.read import show
from studies.sweep.about import ABOUT, SweepAbout
from studies.sweep.cell import Cell, CellResult, FailedCell
from tests.support.command_line import Run, command_line
from training.card import FlightError
from training.evaluation import Evaluation, EvaluationReport, Peak
from training.progress_file import append, begin
from training.reports import Report

RECORDING = Path(__file__).parents[1] / "data" / "recorded_flight" / "flight.mcap"
ERROR = FlightError("line.csv", 100, 0.2, 0.4, 0.3, 0.6)


@pytest.fixture
def run(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Run:
    return command_line(monkeypatch, capsys)


def fleet_folder(folder: Path) -> Path:
    flights = [
        FleetFlight("a.csv", "diagnosed", vehicle="quad", verdict="explained", sentence="The model explains it."),
        FleetFlight("b.csv", "refused", error="no rows"),
    ]
    folder.mkdir()
    (folder / LINES).write_bytes(b"".join(msgspec.json.encode(f) + b"\n" for f in flights))
    write_json(FleetAbout(str(folder.parent), 8), folder / FLEET_ABOUT)
    (folder.parent / "a.csv").touch()
    return folder


def sweep_folder(folder: Path) -> Path:
    folder.mkdir()
    write_json(SweepAbout("grid", ("history",), 4), folder / ABOUT)
    cells = [Cell(f"h{h}_seed0", {"history": float(h), "seed": 0.0}, "pi_tcn", 0) for h in (4, 20, 30)]
    for cell in cells[:2]:
        write_json(CellResult(cell, "", (ERROR,), (), 0.1, 10, 1.0, 1e-4, "here"), folder / f"{cell.name}.json")
    write_json(FailedCell(cells[2], "no memory", "here"), folder / f"{cells[2].name}.failed")
    (folder / "other.json").write_text("[1, 2]")
    return folder


def training_file(folder: Path) -> Path:
    path = folder / "m.progress.jsonl"
    begin(path, 2, "alula train", resume=False)
    append(path, Report(0, 100, 200, 0.5, 0.1, 0.4, 0.4, 1e-3))
    return path


def evaluation_file(folder: Path) -> Path:
    model = Evaluation("m", "pi_tcn", 20, "logged", False, (ERROR,))
    nominal = Evaluation("NOM", "nominal", 1, "logged", False, (ERROR,))
    report = EvaluationReport((nominal, model), (Peak("line.csv", 3.0, 20.0),), {"line.csv": "0"})
    write_json(EvaluationAnswer(report, ()), folder / "ev.json")
    return folder / "ev.json"


def test_a_fleet_shows_its_flights_and_how_many_are_missing(tmp_path: Path) -> None:
    shown = show(fleet_folder(tmp_path / "fleet"))
    assert shown.kind == "fleet"
    assert shown.share == 2 / 8
    assert list(shown.logs) == ["a.csv"]  # the other one is not there any more
    assert [row[0] for row in shown.tables[-1].rows] == ["a.csv", "b.csv"]
    assert "no rows" in shown.tables[-1].rows[1]


def test_a_sweep_shows_the_cells_that_are_trained(tmp_path: Path) -> None:
    shown = show(sweep_folder(tmp_path / "sweep"))
    assert shown.share == 3 / 4
    assert shown.tables
    assert shown.images
    assert any("failed: h30_seed0: no memory" in line for line in shown.lines)
    assert any("1 of 4 cells" in line for line in shown.lines)


def test_a_training_shows_its_course_and_at_the_end_its_card(tmp_path: Path) -> None:
    path = training_file(tmp_path)
    for name in ("m.pt", "m.pt.run", "m.progress.jsonl"):
        shown = show(tmp_path / name)
        assert shown.kind == "training"
        assert shown.share == 0.25  # half of the first of two members
        assert "Error over the steps" in shown.pictures
    before = stamp(path)
    append(path, Report(0, 200, 200, 0.5, 0.1, 0.4, 0.4, 1e-3))
    assert stamp(path) != before


def test_an_evaluation_shows_its_tables(tmp_path: Path) -> None:
    shown = show(evaluation_file(tmp_path))
    assert shown.kind == "evaluation"
    assert "Error by flight" in shown.pictures
    assert any("RMSE" in table.title for table in shown.tables)


def test_an_evaluation_of_another_version_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "ev.json"
    path.write_text('{"evaluated": {"models": 3}}')
    with pytest.raises(RequestError, match="Evaluate again"):
        show(path)


def test_a_recording_shows_tracking_timing_and_states() -> None:
    shown = show(RECORDING)
    assert shown.kind == "recording"
    assert {"Tracking", "Timing"} <= set(shown.pictures)
    assert shown.lines[0].startswith("Position error while it tracked: 5.2 cm RMS")
    assert "3 late (scheduler 2, link 1)" in shown.lines[1]
    assert [table.title for table in shown.tables] == ["Timing of the ticks", "States"]


def test_a_recording_that_was_cut_off_is_shown_to_there(tmp_path: Path) -> None:
    data = RECORDING.read_bytes()
    (tmp_path / "cut.mcap").write_bytes(data[: len(data) // 2])
    assert any("cut off" in line for line in show(tmp_path).lines)


def test_a_file_that_is_no_recording_is_refused(tmp_path: Path) -> None:
    (tmp_path / "a.mcap").write_bytes(b"nothing")
    with pytest.raises((RequestError, DataError)):
        show(tmp_path)


@pytest.mark.parametrize("name", ["none", "a.txt", "empty"])
def test_a_path_without_a_result_is_refused_with_what_can_be_shown(tmp_path: Path, name: str) -> None:
    (tmp_path / "a.txt").touch()
    (tmp_path / "empty").mkdir()
    with pytest.raises(RequestError, match="is not there" if name == "none" else "alula sweep"):
        kind_of(tmp_path / name)


def test_a_replay_writes_a_page(run: Run, tmp_path: Path) -> None:
    recording = shutil.copy(RECORDING, tmp_path)
    code, _, wrong = run("replay", str(recording), "--html", str(tmp_path / "page.html"))
    assert code == 0, wrong
    page = (tmp_path / "page.html").read_text()
    assert "setpoints compared" in page
    assert "Position error while it tracked" in page
    assert len(page) < 5e6
