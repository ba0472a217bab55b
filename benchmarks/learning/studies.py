"""The paper's studies on the campaign with hidden effects: many short trainings.

Needs `alula campaign --out build/campaign_learning` and `alula campaign --no-effects --out build/campaign_nominal`.
Killed, the same command resumes; `--only-finished` trains nothing and writes what is there.

    python -m benchmarks learning studies [NAME ..]
"""

from __future__ import annotations

import dataclasses
import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase

import msgspec
import numpy as np

from benchmarks.measurement import ROOT, Page, options_of
from studies.sweep.catalogue import STARRED
from studies.sweep.cell import CellResult, Outcome, trained
from studies.sweep.cell_work import finished_cells
from studies.sweep.execution import run_cells
from studies.sweep.figures import HEATMAPS
from studies.sweep.report import draw, require_all_trained, tables_of
from studies.sweep.run import Sweep, SweepOptions, make_sweep
from studies.tables import Table, markdown
from training import checkpoint
from training.recipe import PAPER

CAMPAIGN, SIMULATED = ROOT / "build" / "campaign_learning", ROOT / "build" / "campaign_nominal"
CELLS, PICTURES = ROOT / "build" / "learning", ROOT / "docs" / "pictures"
BATCH = 256


@dataclass(frozen=True)
class Plan:
    """How long a study's trainings are, and with how many seeds.

    study: where it is not the plan's own name. only: patterns of the cells that are trained. grid: for that study.
    """

    steps: int
    seeds: int
    study: str = ""
    only: tuple[str, ...] = ("*",)
    recipe: str = "fast"
    grid: tuple[str, ...] = ()


# In the order in which they are worth their time. Heatmaps have one seed: all their cells begin with the same weights
# and see the same batches, so that what differs is the prior.
PLANS = {
    "kinds": Plan(6000, 2),
    "ablation": Plan(6000, 2),
    "history": Plan(6000, 2),
    "regimes": Plan(6000, 2),
    "lambda": Plan(2000, 2),
    "annealed": Plan(3000, 2, study="grid", grid=("annealed=false,true",)),
    "motors": Plan(3000, 2),
    STARRED: Plan(3000, 2),
    "inertia": Plan(2000, 1),
    "rotors": Plan(1000, 1),
    "inertia_longer": Plan(6000, 1, study="inertia", only=("*_Jxx_0.6_Jzz_0.6_*", "*_Jxx_1_Jzz_1_*")),
    "paper": Plan(1000, 1, study="grid", recipe="paper", grid=("history=20",)),
}


def sweep_of(name: str) -> Sweep:
    """A study that may begin, with the cells that the plan wants of it."""
    plan = PLANS[name]
    sweep = make_sweep(
        SweepOptions(
            study=plan.study or name,
            logs=(CAMPAIGN,),
            vehicle="arpl_250g",
            out=CELLS / name,
            simulated=(SIMULATED,) if name == STARRED else (),
            seeds=plan.seeds,
            steps=plan.steps,
            batch=PAPER.batch if plan.recipe == "paper" else BATCH,
            recipe=plan.recipe,
            grid=plan.grid,
            jobs=1,
        )
    )
    works = tuple(work for work in sweep.works if any(fnmatchcase(work.cell.name, pattern) for pattern in plan.only))
    return dataclasses.replace(sweep, count=len(works), works=works)


def share(sweep: Sweep) -> None:
    """Take over trainings that another study has done: the same one is a cell of several."""
    done = {}
    for path in CELLS.glob("*/*.json"):
        done[msgspec.json.decode(path.read_bytes(), type=CellResult).fingerprint] = path
    for work in sweep.works:
        path = done.get(work.fingerprint)
        if path is not None and not work.result_file.exists():
            if (model := path.with_suffix(".pt")).exists():
                shutil.copyfile(model, work.model_file)
            shutil.copyfile(path, work.result_file)


def outcomes_of(name: str, sweep: Sweep, *, only: bool) -> tuple[Outcome, ...]:
    """Outcomes of a study's cells. only: those that are finished already."""
    share(sweep)
    finished: dict[int, Outcome] = {}
    for place, outcome in finished_cells(sweep.works) if only else run_cells(sweep.works, jobs=1, scheduler=None):
        finished[place] = outcome
        print(f"{name} {len(finished)}/{sweep.count} {outcome.cell.name}", flush=True)
    return tuple(finished[place] for place in sorted(finished))


def times(studies: dict[str, tuple[Sweep, tuple[Outcome, ...]]]) -> Table:
    """Processor seconds by study: of a cell, and of all cells one after the other."""
    rows = []
    for name, (sweep, outcomes) in studies.items():
        one = float(np.mean([result.processor for result in trained(outcomes)]))
        rows.append((name, PLANS[name].steps, len(trained(outcomes)), sweep.count, one, one * sweep.count / 60))
    headings = ("study", "steps", "trainings done", "of", "processor s a training", "minutes for all, one core")
    note = "All of a training counts: labels, points, steps, errors on the test flights; a training that several "
    note += "studies have in common counts in each, and is done once. NOM needs none."
    return Table("times", "Time of the studies", headings, tuple(rows), note)


def paper_recipe(result: CellResult) -> Table:
    """How far the paper's recipe got, and what all of it would take. Half of the steps are with lambda, as in all."""
    rows = checkpoint.load(CELLS / "paper" / f"{result.cell.name}.pt").card.rows
    steps = -(-rows // PAPER.batch)  # of an epoch
    epoch = result.processor / result.steps * steps
    assert PAPER.epochs is not None
    headings = (
        "windows",
        "steps an epoch",
        "steps done",
        "epochs done",
        "processor s an epoch",
        "days of 10,000 epochs",
    )
    row = (rows, steps, result.steps, result.steps / steps, epoch, epoch * PAPER.epochs / 86400)
    return Table("paper_recipe", "The paper's recipe: its time on one core", headings, (row,))


def studies(words: Sequence[str]) -> Page:
    """The measurement's page."""
    parser = options_of(__doc__)
    parser.add_argument("studies", nargs="*", default=list(PLANS), help="By default all of them.")
    parser.add_argument("--only-finished", action="store_true", help="train nothing, write what is there")
    arguments = parser.parse_args(words)
    finished: dict[str, tuple[Sweep, tuple[Outcome, ...]]] = {}
    for name in arguments.studies:
        sweep = sweep_of(name)
        outcomes = outcomes_of(name, sweep, only=arguments.only_finished)
        require_all_trained(outcomes)
        if outcomes:
            finished[name] = sweep, outcomes
    return page_of(finished, pictures=not (arguments.no_page or arguments.quick))


def page_of(finished: dict[str, tuple[Sweep, tuple[Outcome, ...]]], *, pictures: bool) -> Page:
    """The page of tables; the documentation's pictures are drawn anew with `pictures`."""
    tables: list[Table] = [times(finished)]
    for name, (sweep, outcomes) in finished.items():
        tables += with_title(name, tables_of(sweep, outcomes))
        if pictures and name in (*HEATMAPS, "lambda", "history", STARRED):
            draw(sweep, outcomes, CELLS / "pictures")
            shutil.copyfile(CELLS / "pictures" / f"{name}.png", PICTURES / f"study_{name}.png")
    if "paper" in finished:
        tables.append(paper_recipe(trained(finished["paper"][1])[0]))
    head = (
        "Campaign with hidden effects (68 flights), trained on its 60, judged on its 8 test flights. The studies train "
        f"with {BATCH} windows a step for as many steps as their titles say; the default recipe's are 10,000."
    )
    return Page("learning", "Learning: the paper's studies", "\n\n".join([head, *map(markdown, tables)]))


def with_title(name: str, tables: Sequence[Table]) -> list[Table]:
    """The tables under the name that the study has here, and how long it trains."""
    study, steps = PLANS[name].study or name, PLANS[name].steps
    return [
        msgspec.structs.replace(table, title=table.title.replace(study, f"{name}, {steps:,} steps", 1))
        for table in tables
    ]
