"""`alula sweep`: a finished cell is a file, what was stopped goes on, and a dead worker costs nothing but time."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import msgspec
import pytest
from dask import distributed

from alula.sweep_cells import CellWork, finished, run_cell, run_cells
from alula.sweep_run import SweepOptions, draw, make_sweep, table_of
from alula.sweep_search import Range
from dynamics.errors import RequestError
from dynamics.vehicle import Vehicle
from dynamics.vehicle_file import vehicle_toml
from tests.support.command_line import Run, command_line
from tests.support.small_campaign import fly_campaign
from training.studies import FACTORS, STUDIES
from training.studies.cell import Cell, CellResult, StudyOptions, with_factors

EFFECTS = ("motor_lag:time_constant=0.035", "rotor_drag:coefficient=6e-5")
FLIGHTS = {
    "test/Lemniscate": "Lemniscate:laps=1,ramp=1",
    "train/Parabola_xy_60": "Parabola:laps=2,ramp=1",
    "train/circle_xy_60": "circle:laps=1,ramp=1",
}
MakeWork = Callable[..., CellWork]


@pytest.fixture
def run(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Run:
    return command_line(monkeypatch, capsys)


@pytest.fixture(scope="module")
def campaign(tmp_path_factory: pytest.TempPathFactory, arpl_250g: Vehicle) -> Path:
    return fly_campaign(tmp_path_factory.mktemp("small") / "campaign", arpl_250g, EFFECTS, FLIGHTS)


@pytest.fixture
def work(campaign: Path, arpl_250g: Vehicle, tmp_path: Path) -> MakeWork:
    """A small cell's work in this test's folder."""

    def make(name: str, *, steps: int = 20, **changes: object) -> CellWork:
        cell = Cell(name, {"name": name}, "pi_mlp", 0, recipe={"steps": steps, "batch": 32, "physics_weight": 0.0})
        cell = msgspec.structs.replace(cell, **changes)
        logs, tests = (tuple(sorted((campaign / split).iterdir())) for split in ("train", "test"))
        return CellWork(cell, tmp_path, logs, tests, vehicle_toml(arpl_250g))

    return make


def test_a_finished_cell_is_never_trained_again(work: MakeWork, tmp_path: Path) -> None:
    works = [work("a"), work("b", seed=1)]
    results = run_cells(works, jobs=1, scheduler=None)
    place, first = next(results)
    results.close()  # stopped after one cell
    assert place == 0
    assert finished(works[1]) is None
    stamp = works[0].result_file.stat().st_mtime_ns
    found = dict(run_cells(works, jobs=1, scheduler=None))
    assert found[0] == first
    assert works[0].result_file.stat().st_mtime_ns == stamp
    assert found[1].cell.seed == 1
    assert found[1].best_known[0].flight == "Lemniscate.parquet"
    assert found[1].validation > 0
    assert {path.suffix for path in tmp_path.iterdir()} == {".json", ".pt"}


def test_a_folder_of_another_sweep_is_refused(work: MakeWork) -> None:
    run_cell(work("a"))
    with pytest.raises(RequestError, match=r"a\.json is of another sweep"):
        finished(work("a", steps=21))
    work("a").result_file.write_text("{")
    with pytest.raises(RequestError, match=r"a\.json is no cell of a sweep"):
        finished(work("a"))


def test_a_network_without_motors_and_a_wrong_prior_are_other_cells(work: MakeWork, arpl_250g: Vehicle) -> None:
    blind = run_cell(work("blind", hide_motors=True, steps=60))
    seeing = run_cell(work("seeing", steps=60))
    assert blind.label[0].nominal == seeing.label[0].nominal
    assert blind.label[0].combined != seeing.label[0].combined
    assert blind.label[0].combined < 5 * seeing.label[0].combined  # judged without motors as well
    wrong = run_cell(work("wrong", prior={"Jxx": 1.4, "k_tau": 0.6}))
    assert wrong.label[0].nominal != seeing.label[0].nominal
    vehicle = with_factors(arpl_250g, {"Jzz": 2.0, "k_f": 0.6})
    assert vehicle.body.inertia[2] == 2 * arpl_250g.body.inertia[2]
    assert vehicle.rotors.thrust_constant == 0.6 * arpl_250g.rotors.thrust_constant
    with pytest.raises(RequestError, match="unknown constant 'Jxy'"):
        with_factors(arpl_250g, {"Jxy": 1.0})


def dask_process(*arguments: str) -> subprocess.Popen[bytes]:
    environment = {**os.environ, "PYTHONPATH": str(Path(__file__).parents[2]), "OMP_NUM_THREADS": "1"}
    command = [sys.executable, "-W", "ignore", "-m", "distributed.cli." + arguments[0], *arguments[1:]]
    return subprocess.Popen(command, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)


@pytest.fixture
def cluster(tmp_path: Path) -> Iterator[tuple[str, list[subprocess.Popen[bytes]]]]:
    """Address of a scheduler, and two workers in processes of their own."""
    told = tmp_path / "scheduler.told"
    scheduler = dask_process(
        "dask_scheduler", "--host", "127.0.0.1", "--port", "0", "--no-dashboard", "--scheduler-file", str(told)
    )
    options = ("--scheduler-file", str(told), "--no-nanny", "--nthreads", "1", "--no-dashboard")
    workers = [dask_process("dask_worker", *options, "--local-directory", str(tmp_path / str(i))) for i in range(2)]
    try:
        client = distributed.Client(scheduler_file=str(told), timeout=60, set_as_default=False)
        client.wait_for_workers(2, timeout=60)
        client.close()
        yield json.loads(told.read_text())["address"], workers
    finally:
        for process in (*workers, scheduler):
            process.kill()
            process.wait()


def test_a_worker_killed_on_the_way_loses_nothing_and_repeats_nothing(
    work: MakeWork, cluster: tuple[str, list[subprocess.Popen[bytes]]]
) -> None:
    address, workers = cluster
    works = [work(f"cell_{i}", seed=i, steps=40) for i in range(4)]
    results = run_cells(works, jobs=None, scheduler=address)
    place, first = next(results)
    stamp = works[place].result_file.stat().st_mtime_ns
    killed = next(worker for worker in workers if worker.pid == int(first.worker.split()[-1]))
    os.kill(killed.pid, signal.SIGKILL)
    found = {place: first} | dict(results)
    assert sorted(found) == list(range(4))
    assert [found[i].cell.name for i in range(4)] == [f"cell_{i}" for i in range(4)]
    written = {work.cell.name: work.result_file.stat().st_mtime_ns for work in works}
    assert written[works[place].cell.name] == stamp
    assert dict(run_cells(works, jobs=None, scheduler=address)) == found
    assert {work.cell.name: work.result_file.stat().st_mtime_ns for work in works} == written
    alone = run_cell(msgspec.structs.replace(works[3], folder=works[3].folder / "0"))
    assert alone.label == found[3].label  # whichever process trains it


def test_a_search_goes_on_with_what_it_has_tried(campaign: Path, tmp_path: Path) -> None:
    def options(trials: int) -> SweepOptions:
        return SweepOptions(
            study="search", logs=(campaign,), vehicle="arpl_250g", out=tmp_path / "out", steps=20, batch=32,
            model="mse_tcn", over=("learning_rate=1e-4:1e-2",), trials=trials, jobs=1,
        )  # fmt: skip

    early = dict(make_sweep(options(2)).results())
    sweep = make_sweep(options(4))
    late = dict(sweep.results())
    assert {place: late[place] for place in early} == early
    rates = [late[place].cell.recipe["learning_rate"] for place in range(4)]
    assert len(set(rates)) == 4
    assert all(1e-4 <= rate <= 1e-2 for rate in rates)
    table = table_of(sweep, [late[place] for place in range(4)])
    assert [row[2] for row in table.rows] == sorted(result.validation for result in late.values())


def test_studies_vary_what_they_say() -> None:
    cells = {name: study.cells(StudyOptions((0, 1), {"steps": 10})) for name, study in STUDIES.items()}
    assert {name: len(found) for name, found in cells.items()} == {
        "kinds": 10, "ablation": 8, "history": 10, "inertia": 100, "rotors": 100, "lambda": 18, "motors": 8,
        "regimes": 12,
    }  # fmt: skip
    for name, found in cells.items():
        assert len({cell.name for cell in found}) == len(found)
        assert all(cell.recipe["steps"] == 10 for cell in found)
        assert all(set(STUDIES[name].along) <= set(cell.at) for cell in found)


def heatmap_result(cell: Cell) -> CellResult:
    """What a cell would be whose errors are its factors."""
    from training.card import FlightError

    value = float(cell.at["Jxx"]) + 10 * float(cell.at["Jzz"])
    error = FlightError("Lemniscate.parquet", 10, value, value, value, 2 * value)
    return CellResult(cell, "", (error,), (), 0.1, 10, 1.0, 1e-4, "here")


def test_heatmaps_put_cells_where_they_belong(tmp_path: Path) -> None:
    from alula.study_tables import heatmaps

    cells = STUDIES["inertia"].cells(StudyOptions((0,)))[:-1]
    results = [heatmap_result(cell) for cell in cells]
    grids = heatmaps("inertia", results)
    assert grids["RES-TCN"][1, 0] == pytest.approx(FACTORS[0] + 10 * FACTORS[1])
    assert grids["NOM"][0, 4] == pytest.approx(2 * (FACTORS[4] + 10 * FACTORS[0]))
    assert grids["PI-TCN"][4, 4] != grids["PI-TCN"][4, 4]  # not finished
    sweep = make_sweep_of("inertia")
    assert {path.suffix for path in draw(sweep, results, tmp_path)} == {".png", ".pdf"}


def make_sweep_of(study: str) -> object:
    from alula.sweep_run import Sweep

    return Sweep(study, STUDIES[study].along, 0, lambda: iter(()), lambda: iter(()))


def test_a_grid_from_the_command_line(run: Run, campaign: Path, tmp_path: Path) -> None:
    words = ("sweep", "grid", campaign, "--vehicle", "arpl_250g", "--out", tmp_path / "out", "--model", "window_mlp",
             "--grid", "history=2,4", "--steps", 20, "--batch", 32, "--seeds", 1, "--jobs", 1)  # fmt: skip
    code, out, wrong = run(*words, "--csv", tmp_path / "csv", "--pictures", tmp_path / "p", "--json", tmp_path / "j")
    assert (code, wrong) == (0, "")
    assert "Study: grid" in out
    assert len(json.loads((tmp_path / "j").read_text())["cells"]) == 2
    assert (tmp_path / "csv" / "grid.csv").read_text().startswith("history,RMSE")
    assert (tmp_path / "p" / "grid.png").stat().st_size > 1000


def test_what_cannot_be_swept_is_told(run: Run, campaign: Path, tmp_path: Path) -> None:
    common = ("--vehicle", "arpl_250g", "--out", tmp_path / "out")
    test, train = campaign / "test" / "Lemniscate.parquet", campaign / "train"
    for arguments, words in (
        (("planets", campaign), "unknown study 'planets'"),
        (("grid", campaign), "a grid needs something to vary"),
        (("grid", campaign, "--grid", "colour=1,2"), "a recipe has no 'colour'"),
        (("search", campaign, "--over", "physics_weight=1:0"), "is no range"),
        (("kinds", train), "no flight to judge on was given"),
        (("kinds", train, "--test", train), "is among both training and test flights"),
        (("kinds", test, "--test", test), "is among both training and test flights"),
        (("kinds", campaign, "--recipe", "best"), "unknown recipe"),
    ):
        code, _, wrong = run("sweep", *arguments, *common)
        assert code == 2
        assert words in wrong
    assert Range.parse("rate=1e-4:1") == Range("rate", 1e-4, 1.0)
