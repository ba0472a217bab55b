"""`alula sweep search`: trials are in Optuna's journal, open ones are resumed, and processes share a folder."""

from __future__ import annotations

import fcntl
import os
import subprocess
import sys
from pathlib import Path

import msgspec
import pytest

from dynamics.errors import RequestError
from studies.sweep.cell import CellResult, FailedCell
from studies.sweep.cell_work import CellWork
from studies.sweep.report import tables_of
from studies.sweep.run import SweepOptions, make_sweep
from studies.sweep.search import JOURNAL
from training.card import FlightError


def search_options(campaign: Path, out: Path, trials: int, **fields: object) -> SweepOptions:
    options = SweepOptions(
        study="search",
        logs=(campaign,),
        vehicle="arpl_250g",
        out=out,
        steps=20,
        batch=32,
        model="mse_tcn",
        over=("learning_rate=1e-4:1e-2",),
        trials=trials,
        jobs=1,
    )
    return msgspec.structs.replace(options, **fields)


def start_search(campaign: Path, out: Path, trials: int, steps: int) -> subprocess.Popen[bytes]:
    words = ["sweep", "search", str(campaign), "--vehicle", "arpl_250g", "--out", str(out), "--steps", str(steps)]
    words += ["--batch", "32", "--model", "mse_tcn", "--over", "learning_rate=1e-4:1e-2", "--trials", str(trials)]
    environment = {**os.environ, "PYTHONPATH": str(Path(__file__).parents[2]), "OMP_NUM_THREADS": "1"}
    return subprocess.Popen(
        [sys.executable, "-m", "alula", *words, "--jobs", "1"], env=environment, stdout=subprocess.DEVNULL
    )


@pytest.fixture
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    """Trials that take no time, and err by their learning rate."""

    def train(work: CellWork) -> CellResult:
        rate = float(work.cell.recipe["learning_rate"])
        error = FlightError("test/Lemniscate.parquet", 100, rate, rate, rate, 1.0)
        return CellResult(work.cell, work.fingerprint, (error,), (), rate, 20, 0.1, 1e-4, "here")

    monkeypatch.setattr("studies.sweep.execution.train_cell", train)


@pytest.mark.usefixtures("quick")
def test_a_search_continues_with_its_earlier_trials(campaign: Path, tmp_path: Path) -> None:
    early = dict(make_sweep(search_options(campaign, tmp_path / "out", 2)).outcomes())
    sweep = make_sweep(search_options(campaign, tmp_path / "out", 4))
    late = dict(sweep.outcomes())
    assert {place: late[place] for place in early} == early
    rates = [late[place].cell.recipe["learning_rate"] for place in range(4)]
    assert len(set(rates)) == 4
    assert all(1e-4 <= rate <= 1e-2 for rate in rates)
    (table,) = tables_of(sweep, [late[place] for place in range(4)])
    assert [row[2] for row in table.rows] == sorted(result.validation for result in late.values())


def test_a_search_tries_failed_trials_again_as_they_were(campaign: Path, tmp_path: Path) -> None:
    options = search_options(campaign, tmp_path, 2, steps=5, over=("learning_rate=1e29:1e30",))
    first = dict(make_sweep(options).outcomes())
    assert all(isinstance(outcome, FailedCell) for outcome in first.values())
    sweep = make_sweep(options)
    again = dict(sweep.outcomes())
    assert {place: outcome.cell for place, outcome in again.items()} == {
        place: outcome.cell for place, outcome in first.items()
    }
    (table,) = tables_of(sweep, list(again.values()))
    assert [row[-2:] for row in table.rows] == [(None, None)] * 2
    ours = make_sweep(msgspec.structs.replace(options, over=("learning_rate=1e-4:1e-2",), trials=1))
    assert isinstance(dict(ours.outcomes())[0], CellResult)
    other = make_sweep(msgspec.structs.replace(options, over=("learning_rate=1e-4:1e-2",), trials=1, steps=6))
    with pytest.raises(RequestError, match="is of another search"):
        dict(other.outcomes())


def test_an_interrupted_search_resumes_its_open_trial(
    campaign: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    tried = []

    def interrupted(work: CellWork) -> CellResult:
        tried.append(work.cell)
        raise KeyboardInterrupt

    with monkeypatch.context() as patched:
        patched.setattr("studies.sweep.execution.train_cell", interrupted)
        with pytest.raises(KeyboardInterrupt):
            dict(make_sweep(search_options(campaign, tmp_path, 1)).outcomes())
    outcomes = dict(make_sweep(search_options(campaign, tmp_path, 1)).outcomes())
    assert [outcome.cell for outcome in outcomes.values()] == tried
    assert isinstance(outcomes[0], CellResult)
    for path in tmp_path.glob("trial_*.lock"):
        with path.open() as file:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)  # raises BlockingIOError where a trial is still held


def test_two_processes_share_a_search(campaign: Path, tmp_path: Path) -> None:
    processes = [start_search(campaign, tmp_path / "out", 4, 20) for _ in range(2)]
    assert [process.wait() for process in processes] == [0, 0]
    results = dict(make_sweep(search_options(campaign, tmp_path / "out", 4)).finished())
    assert sorted(results) == [0, 1, 2, 3]
    assert len({result.cell.recipe["learning_rate"] for result in results.values()}) == 4


@pytest.mark.usefixtures("quick")
def test_a_folder_from_before_the_journal_is_read(campaign: Path, tmp_path: Path) -> None:
    early = dict(make_sweep(search_options(campaign, tmp_path, 2)).outcomes())
    (tmp_path / JOURNAL).unlink()
    late = dict(make_sweep(search_options(campaign, tmp_path, 3)).outcomes())
    assert {place: late[place] for place in early} == early
    assert len({outcome.cell.recipe["learning_rate"] for outcome in late.values()}) == 3
