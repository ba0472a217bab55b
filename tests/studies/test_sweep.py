"""`alula sweep`: a finished cell is a file, stopped ones continue, and a dead worker costs nothing but time."""

from __future__ import annotations

import json
import os
import signal
from collections.abc import Callable, Iterator
from pathlib import Path

import msgspec
import pytest

from dynamics.errors import RequestError
from dynamics.vehicle import Vehicle
from dynamics.vehicle_file import vehicle_toml
from fixtures.dask_cluster import Cluster, dask_cluster
from studies.sweep.catalogue import FACTORS, STUDIES
from studies.sweep.cell import Cell, CellResult, FailedCell, Outcome, StudyOptions, with_factors
from studies.sweep.cell_work import CellWork, failure, finished
from studies.sweep.execution import run_cell, run_cells
from studies.sweep.figures import heatmaps
from studies.sweep.report import draw, tables_of
from studies.sweep.run import Sweep, SweepOptions, make_sweep
from studies.sweep.search import Range
from tests.support.command_line import Run, command_line
from training.card import FlightError

MakeWork = Callable[..., CellWork]


@pytest.fixture
def run(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Run:
    return command_line(monkeypatch, capsys)


@pytest.fixture
def work(campaign: Path, arpl_250g: Vehicle, tmp_path: Path) -> MakeWork:
    """A small cell's work in this test's folder."""

    def make(name: str, *, steps: int = 20, **fields: object) -> CellWork:
        cell = Cell(name, {"name": name}, "pi_mlp", 0, recipe={"steps": steps, "batch": 32, "physics_weight": 0.0})
        cell = msgspec.structs.replace(cell, **fields)
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
    outcomes = dict(run_cells(works, jobs=1, scheduler=None))
    assert outcomes[0] == first
    assert works[0].result_file.stat().st_mtime_ns == stamp
    assert outcomes[1].cell.seed == 1
    assert outcomes[1].best_known[0].flight == "Lemniscate.parquet"
    assert outcomes[1].validation > 0
    assert {path.suffix for path in tmp_path.iterdir()} == {".json", ".pt"}


def test_a_folder_of_another_sweep_is_refused(work: MakeWork) -> None:
    run_cell(work("a"))
    with pytest.raises(RequestError, match=r"a\.json is of another sweep"):
        finished(work("a", steps=21))
    work("a").result_file.write_text("{")
    with pytest.raises(RequestError, match=r"a\.json is no cell of a sweep"):
        finished(work("a"))


def test_one_training_under_two_names_is_one(work: MakeWork) -> None:
    first, second = work("a"), work("b", at={"other": 1.0})
    assert first.fingerprint == second.fingerprint
    run_cell(first)
    second.result_file.write_bytes(first.result_file.read_bytes())
    outcomes = finished(second)
    assert outcomes is not None
    assert outcomes.cell == second.cell
    for other in (work("a", seed=1), work("a", steps=21), work("a", hide_motors=True), work("a", prior={"Jxx": 1.2})):
        assert other.fingerprint != first.fingerprint


def test_flights_that_were_flown_again_are_another_sweep(work: MakeWork, tmp_path: Path) -> None:
    log = tmp_path / "log.csv"
    log.write_text("before")
    changed = msgspec.structs.replace(work("a"), logs=(log,))
    before = changed.fingerprint
    log.write_text("after it")
    assert changed.fingerprint != before
    log.unlink()
    with pytest.raises(RequestError, match=r"cannot read .*log\.csv"):
        changed.fingerprint  # noqa: B018


def test_a_cell_that_cannot_be_trained_gives_its_reason_and_the_others_continue(work: MakeWork) -> None:
    recipe = {"steps": 20, "batch": 32, "physics_weight": 0.0}
    works = [work("diverges", recipe={**recipe, "learning_rate": 1e30}), work("other"), work("none", flights="none*")]
    outcomes = dict(run_cells(works, jobs=1, scheduler=None))
    diverged, other, none = (outcomes[place] for place in range(3))
    assert isinstance(diverged, FailedCell)
    assert "is not finite" in diverged.message
    assert isinstance(other, CellResult)
    assert isinstance(none, FailedCell)
    assert "no training flight is called 'none*'" in none.message
    assert failure(works[0]) == diverged
    assert not works[0].state_file.exists()
    failures = [outcome for outcome in outcomes.values() if isinstance(outcome, FailedCell)]
    (table,) = tables_of(bare_sweep("grid", ("name",)), [diverged, other, none])
    assert [row[table.headings.index("failed")] for row in table.rows] == [1, 0, 1]
    assert "2 of 3 trainings failed" in table.note
    assert all(not failed.traceback for failed in failures)


def test_a_failed_cell_is_tried_again(work: MakeWork, monkeypatch: pytest.MonkeyPatch) -> None:
    def out_of_memory(_: CellWork) -> CellResult:
        raise RuntimeError("not enough memory")

    with monkeypatch.context() as patched:
        patched.setattr("studies.sweep.execution.train_cell", out_of_memory)
        first = dict(run_cells([work("a")], jobs=1, scheduler=None))[0]
    assert isinstance(first, FailedCell)
    assert first.message == "RuntimeError: not enough memory"
    assert "out_of_memory" in first.traceback
    assert isinstance(dict(run_cells([work("a")], jobs=1, scheduler=None))[0], CellResult)
    assert failure(work("a")) is None


def test_a_starred_cell_learns_from_the_simulation_alone(work: MakeWork, campaign: Path) -> None:
    real = work("real")
    starred = msgspec.structs.replace(work("starred", simulated=True), simulated=real.logs[:1])
    assert starred.learned == real.logs[:1]
    first, second = run_cell(real), run_cell(starred)
    assert isinstance(first, CellResult)
    assert isinstance(second, CellResult)
    assert first.label[0].nominal == second.label[0].nominal  # judged on the same flights
    assert first.label[0].combined != second.label[0].combined
    options = SweepOptions(study="starred", logs=(campaign,), vehicle="arpl_250g", out=real.folder / "s")
    with pytest.raises(RequestError, match="it needs it: give the folder"):
        make_sweep(options)
    made = make_sweep(msgspec.structs.replace(options, simulated=(campaign / "train",), seeds=1))
    assert [work.cell.at["model"] for work in made.works] == ["pi_mlp*", "pi_mlp", "pi_tcn*", "pi_tcn"]


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


@pytest.fixture
def cluster(tmp_path: Path) -> Iterator[Cluster]:
    """Address of a scheduler, and two workers in processes of their own."""
    with dask_cluster(tmp_path) as made:
        yield made


@pytest.mark.realtime(repeats_only=True)  # repeated where it was starved; it bears company
def test_a_worker_killed_on_the_way_loses_nothing_and_repeats_nothing(work: MakeWork, cluster: Cluster) -> None:
    address, workers = cluster
    works = [work(f"cell_{i}", seed=i, steps=40) for i in range(4)]
    results = run_cells(works, jobs=None, scheduler=address)
    place, first = next(results)
    stamp = works[place].result_file.stat().st_mtime_ns
    killed = next(worker for worker in workers if worker.pid == int(first.worker.split()[-1]))
    os.kill(killed.pid, signal.SIGKILL)
    outcomes = {place: first} | dict(results)
    assert sorted(outcomes) == list(range(4))
    assert [outcomes[i].cell.name for i in range(4)] == [f"cell_{i}" for i in range(4)]
    written = {work.cell.name: work.result_file.stat().st_mtime_ns for work in works}
    assert written[works[place].cell.name] == stamp
    assert dict(run_cells(works, jobs=None, scheduler=address)) == outcomes
    assert {work.cell.name: work.result_file.stat().st_mtime_ns for work in works} == written
    alone = run_cell(msgspec.structs.replace(works[3], folder=works[3].folder / "0"))
    assert alone.label == outcomes[3].label  # whichever process trains it


def test_studies_vary_what_they_say() -> None:
    cells = {name: study.cells(StudyOptions((0, 1), {"steps": 10})) for name, study in STUDIES.items()}
    assert {name: len(outcomes) for name, outcomes in cells.items()} == {
        "kinds": 10,
        "ablation": 8,
        "history": 10,
        "inertia": 100,
        "rotors": 100,
        "lambda": 18,
        "motors": 8,
        "regimes": 12,
        "starred": 8,
    }
    for name, outcomes in cells.items():
        assert len({cell.name for cell in outcomes}) == len(outcomes)
        assert all(cell.recipe["steps"] == 10 for cell in outcomes)
        assert all(set(STUDIES[name].along) <= set(cell.at) for cell in outcomes)


def planted(cell: Cell, value: float) -> CellResult:
    """What a cell would be with this error."""
    error = FlightError("Lemniscate.parquet", 10, value, value, value, 2 * value)
    return CellResult(cell, "", (error,), (), 0.1, 10, 1.0, 1e-4, "here")


def bare_sweep(study: str, along: tuple[str, ...] | None = None) -> Sweep:
    """A sweep whose outcomes come from elsewhere."""
    return Sweep(study, along or STUDIES[study].along, 0, lambda: iter(()), lambda: iter(()), {})


def test_heatmaps_put_cells_where_they_belong(tmp_path: Path) -> None:
    cells = STUDIES["inertia"].cells(StudyOptions((0,)))[:-1]
    results = [planted(cell, float(cell.at["Jxx"]) + 10 * float(cell.at["Jzz"])) for cell in cells]
    grids = heatmaps("inertia", results)
    assert grids["RES-TCN"][1, 0] == pytest.approx(FACTORS[0] + 10 * FACTORS[1])
    assert grids["NOM"][0, 4] == pytest.approx(2 * (FACTORS[4] + 10 * FACTORS[0]))
    assert grids["PI-TCN"][4, 4] != grids["PI-TCN"][4, 4]  # not finished
    assert {path.suffix for path in draw(bare_sweep("inertia"), results, tmp_path)} == {".png", ".pdf"}


@pytest.mark.parametrize("study", ["lambda", "history"])
def test_studies_along_a_number_are_curves(study: str, tmp_path: Path) -> None:
    cells = STUDIES[study].cells(StudyOptions((0, 1)))
    results: list[Outcome] = [planted(cell, 1.0 + 0.1 * cell.seed) for cell in cells]
    drawn = draw(bare_sweep(study), results, tmp_path)
    assert {path.name for path in drawn} >= {f"{study}.png", f"{study}.pdf", f"{study}_flights.png"}
    (table,) = tables_of(bare_sweep(study), results)
    assert [row[table.headings.index("RMSE")] for row in table.rows] == pytest.approx([1.05] * len(table.rows))
    assert draw(bare_sweep(study), [FailedCell(cells[0], "none", "here")], tmp_path) == []


def test_models_of_table_one_are_compared_with_the_papers_by_flight() -> None:
    cells = STUDIES["starred"].cells(StudyOptions((0,)))
    table = tables_of(bare_sweep("starred"), [planted(cell, 1.0) for cell in cells])[1]
    assert table.headings == (
        "flight",
        "pi_mlp* / NOM",
        "paper's",
        "pi_mlp / NOM",
        "paper's",
        "pi_tcn* / NOM",
        "paper's",
        "pi_tcn / NOM",
        "paper's",
    )
    assert table.rows[0][:3] == ("Lemniscate", 0.5, pytest.approx(9.19 / 9.16))


def test_a_grid_from_the_command_line(run: Run, campaign: Path, tmp_path: Path) -> None:
    words = ("sweep", "grid", campaign, "--vehicle", "arpl_250g", "--out", tmp_path / "out", "--model", "window_mlp",
             "--grid", "history=2,4", "--steps", 20, "--batch", 32, "--seeds", 1, "--jobs", 1)  # fmt: skip
    code, out, wrong = run(*words, "--csv", tmp_path / "csv", "--pictures", tmp_path / "p", "--json", tmp_path / "j")
    assert (code, wrong) == (0, "")
    assert "Study: grid" in out
    assert len(json.loads((tmp_path / "j").read_text())["cells"]) == 2
    assert (tmp_path / "csv" / "grid.csv").read_text().startswith("history,RMSE")
    assert (tmp_path / "p" / "grid.png").stat().st_size > 1000


def test_what_is_on_or_off_may_be_a_grids_value_and_its_cells_are_read_again(
    run: Run, campaign: Path, tmp_path: Path
) -> None:
    words = ("sweep", "grid", campaign, "--vehicle", "arpl_250g", "--out", tmp_path / "out", "--model", "pi_mlp",
             "--grid", "annealed=false,true", "--steps", 20, "--batch", 32, "--seeds", 1, "--jobs", 1)  # fmt: skip
    for _ in range(2):  # the second time from files
        code, out, _ = run(*words)
        assert code == 0
        assert {"yes", "no"} <= set(out.replace("│", " ").split())


def test_a_failed_training_shows_in_table_page_and_exit_code(run: Run, campaign: Path, tmp_path: Path) -> None:
    words = ("sweep", "grid", campaign, "--vehicle", "arpl_250g", "--out", tmp_path / "out", "--model", "window_mlp",
             "--grid", "learning_rate=1e-3,1e30", "--steps", 20, "--batch", 32, "--seeds", 1, "--jobs", 1)  # fmt: skip
    page, answer = tmp_path / "page.html", tmp_path / "answer.json"
    code, out, wrong = run(*words, "--html", page, "--json", answer)
    assert code == 3
    assert "1 of 2 trainings failed" in wrong
    assert "1 of 2 trainings are done." in out
    assert "failed: window_mlp_learning_rate_1e+30_seed0: the loss of batch" in out
    written = json.loads(answer.read_text())
    assert [len(written["cells"]), len(written["failed"])] == [1, 1]
    text = page.read_text()
    assert "1 of 2 trainings failed" in text
    assert "data:image/png;base64," in text
    assert "train/circle_xy_60.parquet" in text


def test_what_cannot_be_swept_is_refused(run: Run, campaign: Path, tmp_path: Path) -> None:
    common = ("--vehicle", "arpl_250g", "--out", tmp_path / "out")
    test, train = campaign / "test" / "Lemniscate.parquet", campaign / "train"
    for arguments, words in (
        (("planets", campaign), "unknown study 'planets'"),
        (("grid", campaign), "a grid needs something to vary"),
        (("grid", campaign, "--grid", "colour=1,2"), "a recipe has no 'colour'"),
        (("grid", campaign, "--grid", "learning_rate=1e-3,-1"), "learning_rate = -1: expected `float` > 0"),
        (("search", campaign, "--over", "physics_weight=1:0"), "is no range"),
        (("kinds", campaign, "--simulated", train), "--simulated is for the study 'starred'"),
        (("kinds", train), "no flight to judge on was given"),
        (("kinds", train, "--test", train), "is among both training and test flights"),
        (("kinds", test, "--test", test), "is among both training and test flights"),
        (("kinds", campaign, "--recipe", "best"), "unknown recipe"),
    ):
        code, _, wrong = run("sweep", *arguments, *common)
        assert code == 2
        assert words in wrong
        assert not (tmp_path / "out").exists(), words
    assert Range.parse("rate=1e-4:1") == Range("rate", 1e-4, 1.0)
