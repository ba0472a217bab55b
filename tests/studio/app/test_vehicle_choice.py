"""Vehicles of a case that are made of its logs or taken from a recording, in the order in which they are asked for."""

from __future__ import annotations

import shutil
import threading
from collections.abc import Callable, Iterator
from pathlib import Path

import msgspec
import pytest

from dynamics.errors import RequestError
from dynamics.files import write_json
from dynamics.vehicle_file import find_vehicle
from runtime.flight_setup import VEHICLE_TEXT
from runtime.record.recording import read_attachments
from studio.app.log_page import change, use_flown_vehicle
from studio.app.opened import OpenCase
from studio.case.case import Case
from studio.work.results import FILES, FLIGHTS, VEHICLE, Added, FlightInfo
from studio.work.task import Task
from studio.work.worker import Outcome

RECORDING = Path(__file__).parents[2] / "data" / "recorded_flight" / "flight.mcap"
SIH = find_vehicle("px4_sih").read_text(encoding="utf-8")
PATIENCE = 20.0  # s


class HeldWorker:
    """A worker without a process: each task waits until it is let go, or its case gives it up."""

    def __init__(self) -> None:
        self.began: list[Task] = []
        self.go, self.ended, self.started = threading.Event(), threading.Event(), threading.Event()

    def run(self, task: Task, progress: Callable[[float, str], None]) -> Outcome:
        self.ended.clear()
        self.began.append(task)
        self.started.set()
        while task.step == "make" and not self.go.wait(0.01):
            if self.ended.is_set():
                return Outcome("cancelled")
        progress(0.5, "at work")
        result = Path(task.result)
        result.mkdir(parents=True)
        if task.step == "make":
            text = SIH.replace('name = "px4_sih"', f'name = "{task.name}"')
            (result / VEHICLE).write_text(text, encoding="utf-8")
        return Outcome("done")

    def cancel(self) -> None:
        self.ended.set()

    def close(self) -> None:
        self.cancel()


@pytest.fixture
def worker() -> HeldWorker:
    return HeldWorker()


@pytest.fixture
def held(tmp_path: Path, worker: HeldWorker) -> Iterator[OpenCase]:
    """A case with a log, whose worker waits."""
    log = tmp_path / "log.csv"
    log.write_text("t\n1\n")
    case = Case.create(tmp_path / "case")
    case.add_logs([log])
    opened = OpenCase(case, lambda: worker)  # type: ignore[arg-type,return-value]
    yield opened
    opened.close()


def _click(opened: OpenCase, **fields: object) -> None:
    change(opened, "make-vehicle", "", {"made-name": "mine", "made-mass": 1.0, **fields})


def _made(opened: OpenCase) -> list[str]:
    return [version.action for version in opened.case.state.versions]


def test_making_a_vehicle_answers_at_once_and_many_clicks_make_one_version(held: OpenCase, worker: HeldWorker) -> None:
    for _ in range(3):
        _click(held)
    assert held.job is not None
    assert held.job.step == "make:mine"
    assert held.case.version is None
    worker.go.set()
    held.wait(PATIENCE)
    _click(held)
    held.wait(PATIENCE)
    assert _made(held) == ["made mine from the log"]
    assert [task.step for task in worker.began].count("make") == 1
    assert (held.case.folder / "mine.toml").is_file()
    assert held.case.version is not None
    assert held.case.version.command.startswith("alula vehicle from-log")


def test_the_newest_click_wins(held: OpenCase, worker: HeldWorker) -> None:
    _click(held)
    assert worker.started.wait(PATIENCE)
    _click(held, **{"made-mass": 1.2})
    worker.go.set()
    held.wait(PATIENCE)
    assert _made(held) == ["made mine from the log"]
    assert worker.began[1].numbers == {"mass": 1.2}
    assert held.case.version is not None
    assert "--mass 1.2" in held.case.version.command


def test_a_vehicle_that_is_chosen_meanwhile_is_not_overwritten(held: OpenCase, worker: HeldWorker) -> None:
    _click(held)
    assert worker.started.wait(PATIENCE)
    change(held, "vehicle", "", {"bundled": "px4_sih"})
    worker.go.set()
    held.wait(PATIENCE)
    assert _made(held) == ["chose px4_sih"]


def test_the_same_vehicle_is_taken_again_after_another_one(held: OpenCase, worker: HeldWorker) -> None:
    worker.go.set()
    _click(held)
    held.wait(PATIENCE)
    change(held, "vehicle", "", {"bundled": "px4_sih"})
    held.wait(PATIENCE)
    _click(held)
    held.wait(PATIENCE)
    assert _made(held) == ["made mine from the log", "chose px4_sih", "made mine from the log"]


@pytest.mark.parametrize(
    ("fields", "words"),
    [({"made-mass": 1000.0}, "1000 g are 1"), ({"made-arm": 225.0}, "225 mm are 0.225"), ({"made-mass": ""}, "Weigh")],
)
def test_a_number_in_another_unit_is_refused_before_anything_runs(
    held: OpenCase, fields: dict[str, object], words: str
) -> None:
    with pytest.raises(RequestError, match=words):
        _click(held, **fields)
    assert held.job is None


def test_effects_that_were_added_to_another_vehicle_are_not_taken(held: OpenCase) -> None:
    held.case.set_vehicle("px4_sih")
    task = held._task("add", "add", effect="", reference="")
    Path(task.result).mkdir(parents=True)
    (Path(task.result) / VEHICLE).write_text(SIH, encoding="utf-8")
    held.case.set_vehicle("crazyflie")
    held._finish("add", task, Outcome("done"))
    assert _made(held) == ["chose px4_sih", "chose crazyflie"]
    assert "Add them again" in held.failure
    assert not (Path(task.result) / FILES[Added]).exists()


def _with_recording(opened: OpenCase, tmp_path: Path, text: str) -> str:
    """The case has read a recording with that vehicle."""
    recording = Path(shutil.copy(RECORDING, tmp_path))
    opened.case.add_logs([recording])
    folder = opened.case.result_folder("flights")
    folder.mkdir(parents=True)
    write_json([FlightInfo(recording.name, str(recording), vehicle=text)], folder / FLIGHTS)
    return str(recording)


def test_a_recording_offers_the_vehicle_that_flew_it(held: OpenCase, tmp_path: Path) -> None:
    log = _with_recording(held, tmp_path, read_attachments(RECORDING)[VEHICLE_TEXT])
    use_flown_vehicle(held, log)
    assert _made(held) == ["took the vehicle of flight.mcap"]
    assert Path(held.case.state.vehicle).is_file()


def test_a_recordings_effect_files_are_never_run(held: OpenCase, tmp_path: Path) -> None:
    marker, program = tmp_path / "was_run", tmp_path / "own.py"
    program.write_text(f"open({str(marker)!r}, 'w')\n")
    listed = f"effect_files = [{str(program)!r}]\n"
    log = _with_recording(held, tmp_path, listed + SIH)
    use_flown_vehicle(held, log)
    assert not marker.exists()
    assert held.case.state.effect_files == ()
    own = listed + SIH + '\n[[effects]]\nname = "my_own_drag"\n'
    folder = held.case.result_folder("flights")
    write_json([msgspec.structs.replace(held.flights()[1][0], vehicle=own)], folder / FLIGHTS)  # type: ignore[index]
    with pytest.raises(RequestError, match="drop that file under 'Effects of your own' first"):
        use_flown_vehicle(held, log)
    assert not marker.exists()


def test_a_file_that_is_no_recording_has_no_attachments(tmp_path: Path) -> None:
    (tmp_path / "log.csv").write_text("t\n1\n")
    assert read_attachments(tmp_path / "log.csv") == {}
    assert read_attachments(tmp_path / "none.mcap") == {}
