"""The steps of a case in a process of their own, from logs to the version whose error fell; a journey clicks them."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest

from diagnosis.proof import Proof
from diagnosis.thresholds import DEFAULT
from dynamics.vehicle_file import read_vehicle
from simulation.versions_in_flight import VersionsInFlight
from studio.app.opened import PAGES, OpenCase
from studio.case.case import Case
from studio.case.commands import script
from studio.work.arrays import read_array
from studio.work.results import Added, Checked, Compared, Diagnosed, Evidence
from studio.work.worker import Worker
from tests.studio.conftest import PLANTED

TIMEOUT = 250.0  # s on a busy machine; alone each step takes some seconds


def _do(opened: OpenCase, step: str, **arguments: str) -> None:
    opened.start(step, **arguments)
    opened.wait(TIMEOUT)
    assert opened.failure == ""


def _statuses(opened: OpenCase) -> dict[str, str]:
    return {page: opened.status(page) for page in PAGES}


def _require_residual(opened: OpenCase) -> None:
    """The rows that a page draws have the error that the comparison states."""
    compared = opened.result(Compared, "compare")
    folder = opened.case.shown_result("compare")
    assert compared is not None
    assert folder is not None
    rows = read_array(folder, "residual")
    worst = max(compared.comparison.axes, key=lambda axis: axis.rms / axis.floor)
    channel = 3 * ["imu", "mocap", "angular", "attitude_rate"].index(worst.kind) + "xyz".index(worst.axis)
    assert np.sqrt(np.mean(np.square(rows[:, channel], dtype=float))) == pytest.approx(worst.rms, rel=1e-4)


def _require_evidence(opened: OpenCase, planted: float) -> None:
    """The evidence of a diagnosed drag has its best fit at the planted value, N s/m."""
    _do(opened, "explain", effect="linear_drag")
    evidence = opened.result(Evidence, "explain:linear_drag")
    assert evidence is not None
    slider, diagnosed = evidence.sliders[0], opened.result(Diagnosed, "diagnose")
    assert diagnosed is not None
    # the answer's own value and interval, and the odds that name it
    named = diagnosed.diagnosis.effects[0].parameters["coefficient"]
    assert (slider.values[slider.best], slider.std) == pytest.approx((named.value, named.std))
    assert evidence.score == diagnosed.ranking[0].score >= DEFAULT.likelihood.named
    assert slider.values[slider.best] == pytest.approx(planted, rel=0.05)  # N s/m
    errors = [sum(value for value in row if value is not None) for row in slider.rms]
    assert np.argmin(errors) in (slider.best - 1, slider.best, slider.best + 1)
    assert evidence.share["mocap"] > 0.8


@pytest.mark.long("two diagnoses and two flights")
@pytest.mark.parametrize(
    ("logs", "vehicle", "planted"),
    [
        pytest.param("short_logs", "arpl_250g", PLANTED, id="short flights"),
        pytest.param("ulogs", "px4_sih", 2.0, id="real PX4", marks=pytest.mark.slow),
    ],
)
def test_the_path_unlocks_step_by_step_and_the_error_falls(
    opened: OpenCase, logs: str, vehicle: str, planted: float, request: pytest.FixtureRequest
) -> None:
    locked = dict.fromkeys(PAGES[1:], "locked")
    assert _statuses(opened) == {"log": "open", **locked}
    opened.case.add_logs(request.getfixturevalue(logs))
    assert opened.status("check") == "open"
    _do(opened, "check")
    assert opened.lock_reason("compare") == "choose a vehicle first."
    opened.case.set_vehicle(vehicle)
    opened.start_if_open("compare")
    opened.wait(TIMEOUT)
    assert _statuses(opened) == {
        "log": "done", "check": "done", "compare": "done", "diagnose": "open", "add": "locked", "prove": "locked"
    }  # fmt: skip
    _require_residual(opened)

    _do(opened, "diagnose")
    diagnosed = opened.result(Diagnosed, "diagnose")
    assert diagnosed is not None
    assert "linear_drag" in diagnosed.sentence
    assert diagnosed.ranking[0].key == "linear_drag"

    _require_evidence(opened, planted)

    _do(opened, "add")
    added = opened.result(Added, "add", shown=True)
    assert added is not None
    version = opened.case.version
    assert version is not None
    assert (version.number, version.parent, version.effects) == (2, 1, ("linear_drag",))
    assert version.channels["mocap"].after < 0.5 * version.channels["mocap"].before
    assert opened.status("compare") == "done"  # follows by itself
    assert opened.status("diagnose") == "out of date"
    assert opened.status("prove") == "open"

    _do(opened, "prove")
    proved = opened.result(Proof, "prove")
    assert proved is not None
    assert proved.channels["mocap"].after < 0.5 * proved.channels["mocap"].before
    assert proved.open_loop.after[-1].position < proved.open_loop.before[-1].position
    _do(opened, "fly", reference="Lemniscate")
    flown = opened.result(VersionsInFlight, "fly:Lemniscate")
    assert flown is not None
    assert flown.after.rmse < 0.5 * flown.before.rmse

    opened.case.undo()
    assert _statuses(opened)["diagnose"] == "done"  # the result of before is there at once
    assert opened.status("prove") == "locked"


@pytest.mark.long("four diagnoses, two of them in another process")
def test_the_script_of_a_case_goes_the_same_way(opened: OpenCase, short_logs: list[Path], tmp_path: Path) -> None:
    opened.case.add_logs(short_logs)
    opened.case.set_vehicle("arpl_250g")
    _do(opened, "check")
    assert opened.status("add") == "locked"
    _do(opened, "diagnose")
    _require_evidence(opened, PLANTED)
    _do(opened, "add")
    version = opened.case.version
    assert version is not None
    assert opened.status("diagnose") == "out of date"
    assert version.command == f"alula add {' '.join(map(str, short_logs))} --vehicle arpl_250g"
    opened.case.undo()
    assert "alula add" not in script(opened.case)
    opened.case.redo()
    file, again = tmp_path / "case.sh", tmp_path / "once again"
    file.write_text(script(opened.case))
    place = str(Path(sys.executable).parent)
    path = {"PATH": f"{place}:{os.environ['PATH']}", "PYTHONPATH": str(Path(__file__).parents[3])}
    run = subprocess.run(["sh", file, again], capture_output=True, text=True, env={**os.environ, **path}, check=False)
    assert run.returncode == 0, run.stderr
    assert "held out" in run.stdout
    made = read_vehicle(again / "arpl_250g.v2.toml")
    theirs = opened.case.vehicle()
    # to rounding: another process sums in another order
    assert [use.label for use in made.effects] == [use.label for use in theirs.effects]
    for mine, other in zip(made.effects, theirs.effects, strict=True):
        assert mine.parameters == pytest.approx(other.parameters, rel=1e-9)


def test_a_log_that_the_reader_refuses_is_said_and_the_others_go_on(
    opened: OpenCase, short_logs: list[Path], tmp_path: Path
) -> None:
    bad = tmp_path / "no_log.csv"
    bad.write_text("a,b\n1,2\n")
    opened.case.add_logs([*short_logs, bad])
    opened.case.set_vehicle("arpl_250g")
    _do(opened, "check")
    checked = opened.result(Checked, "check")
    assert checked is not None
    assert checked.flights[0].refused == ""
    assert "no_log.csv" in checked.flights[-1].refused
    assert checked.by_log[-1] is None
    assert checked.usable
    assert opened.status("compare") == "done"


def test_logs_that_cannot_answer_lock_what_follows(opened: OpenCase, tmp_path: Path) -> None:
    bad = tmp_path / "no_log.csv"
    bad.write_text("a,b\n1,2\n")
    opened.case.add_logs([bad])
    opened.case.set_vehicle("arpl_250g")
    _do(opened, "check")
    assert opened.lock_reason("compare") == "none of the logs can be used; the check says why."


def test_a_vehicle_of_another_size_is_refused_with_the_diagnosis_own_words(
    opened: OpenCase, short_logs: list[Path]
) -> None:
    opened.case.add_logs(short_logs)
    opened.case.set_vehicle("px4_sih")
    opened.start("check")
    opened.wait(TIMEOUT)
    refusal = opened.refusal("compare")
    assert refusal is not None
    assert refusal.exit_code in (2, 3)
    assert "vehicle" in refusal.message
    assert opened.status("compare") == "refused"


@pytest.mark.long("starts a working process, and a diagnosis twice")
def test_work_can_be_cancelled_and_begun_again(tmp_path: Path, short_logs: list[Path]) -> None:
    opened = OpenCase(Case.create(tmp_path / "case"), Worker)
    try:
        opened.case.add_logs(short_logs)
        opened.case.set_vehicle("arpl_250g")
        _do(opened, "check")
        _require_residual(opened)
        for _ in range(2):  # what was begun again goes on as it did
            opened.start("diagnose")
            while opened.job is not None and opened.job.share < 0.1:
                time.sleep(0.01)
            assert opened.job is not None
            opened.cancel()
            opened.wait(30.0)
            assert opened.failure == ""
            assert opened.status("diagnose") == "open"
            assert not list((opened.case.folder / "results").glob("diagnose*"))
        opened.case.set_vehicle("px4_sih")
        opened.start_if_open("compare")
        opened.wait(TIMEOUT)
        assert opened.status("compare") == "refused"  # the process still answers
    finally:
        opened.close()


def test_a_working_process_that_dies_is_replaced_and_said(tmp_path: Path, short_logs: list[Path]) -> None:
    worker = Worker()
    opened = OpenCase(Case.create(tmp_path / "case"), lambda: worker)
    try:
        opened.case.add_logs(short_logs)
        opened.start("check")
        threading.Timer(0.2, worker._process.kill).start()
        opened.wait(60.0)
        assert "died" in opened.failure
        _do(opened, "check")
        assert opened.result(Checked, "check") is not None
    finally:
        opened.close()


def test_a_log_that_needs_more_memory_than_there_is_ends_with_a_message(tmp_path: Path, short_logs: list[Path]) -> None:
    worker = Worker(memory=225 << 20)  # it begins with less, and needs more
    opened = OpenCase(Case.create(tmp_path / "case"), lambda: worker)
    try:
        opened.case.add_logs(short_logs)
        opened.case.set_vehicle("arpl_250g")
        opened.start("check")
        opened.wait(TIMEOUT)
        assert opened.failure
        assert "GB" in opened.failure
    finally:
        opened.close()
