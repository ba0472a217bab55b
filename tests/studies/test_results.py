"""Results on disk: which kind a path holds, and what its page shows."""

from __future__ import annotations

import math
import shutil
import statistics
from pathlib import Path

import pytest

from dynamics.errors import DataError, RequestError
from flights.followed import TRACKED
from runtime.record.recording import read_recording
from runtime.record.records import TOPICS, EstimateRecord, EventRecord, PhaseRecord, ReferenceRecord, TickRecord
from studies.results.kinds import kind_of, stamp
from studies.results.read import show
from tests.support.command_line import Run, command_line
from tests.support.results_on_disk import evaluation_file, fleet_folder, sweep_folder, training_file
from training.progress_file import append
from training.reports import Report

RECORDING = Path(__file__).parents[1] / "data" / "recorded_flight" / "flight.mcap"


@pytest.fixture
def run(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Run:
    return command_line(monkeypatch, capsys)


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
    messages = read_recording(RECORDING).messages
    phases = [(row["time"], row["phase"]) for row in messages[TOPICS[PhaseRecord]]]
    begin = next(time for time, phase in phases if phase == TRACKED)
    end = next(time for time, _ in phases if time > begin)
    planned = {row["time"]: row["position_world"] for row in messages[TOPICS[ReferenceRecord]]}
    flown = {row["time"]: row["position_world"] for row in messages[TOPICS[EstimateRecord]] if row["time"] in planned}
    distances = [math.dist(flown[time], planned[time]) for time in flown if begin <= time < end]
    rms = 100 * math.sqrt(statistics.fmean(distance**2 for distance in distances))
    assert shown.lines[0] == (
        f"Position error while it tracked: {rms:.1f} cm RMS, {100 * max(distances):.1f} cm at most, by its estimate."
    )
    ticks = messages[TOPICS[TickRecord]]
    assert f"{len(ticks):,} ticks" in shown.lines[1]
    assert f" {sum(bool(row['late_cause']) for row in ticks)} late (" in shown.lines[1]
    events = ["Events"] if messages.get(TOPICS[EventRecord]) else []
    assert [table.title for table in shown.tables] == ["Timing of the ticks", *events, "States"]


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
