"""The paper's studies on a simulated copy of its data, with short trainings: which of its claims hold.

Every training is a cell of `alula sweep` in build/learning; interrupted, the script goes on and trains nothing twice.
First fly the campaign: alula campaign --out build/campaign_learning. Then: python benchmarks/learning.py [STUDY...].
"""

from __future__ import annotations

import argparse
from pathlib import Path

from provenance import write_result

from alula.evaluation_run import run as evaluate
from alula.sweep_run import SweepOptions, make_sweep, table_of
from alula.tables import Table, markdown
from training.evaluation import PLANT

ROOT = Path(__file__).resolve().parents[1]
CAMPAIGN, CELLS = ROOT / "build" / "campaign_learning", ROOT / "build" / "learning"
STEPS, BATCH = 2000, 256
USUAL = ("kinds", "motors", "history", "ablation")


def study(name: str, *, seeds: int, only: bool) -> Table:
    """The table of a study. only: of the cells that are finished already."""
    options = SweepOptions(
        study=name,
        logs=(CAMPAIGN,),
        vehicle="arpl_250g",
        out=CELLS / name,
        seeds=seeds,
        steps=STEPS,
        batch=BATCH,
        jobs=1,
    )
    sweep = make_sweep(options)
    results = []
    for place, result in sweep.finished() if only else sweep.results():
        results.append(result)
        print(f"{name} {place + 1}/{sweep.count} {result.cell.name} {result.seconds:.0f} s", flush=True)
    return table_of(sweep, results)


def shipped() -> list[Table]:
    """The models beside the vehicle files, if there are any, against NOM and the plant."""
    models = sorted((ROOT / "vehicles").glob("*.pt"))
    if not models:
        return []
    return list(evaluate([*models, CAMPAIGN], None, mapping=None, timed=True, done=print).tables)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("studies", nargs="*", default=USUAL)
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--only-finished", action="store_true", help="train nothing, write what is there")
    given = parser.parse_args()
    tables = [study(name, seeds=given.seeds, only=given.only_finished) for name in given.studies]
    tables = [table for table in tables if table.rows] + shipped()
    head = (
        "Campaign with hidden effects (68 flights), trained on its 60, judged on its 8 test flights. The studies: "
        f"{STEPS} steps of {BATCH} windows, a fifteenth of the default recipe, so that they compare cells with each "
        f"other, not with a model that is trained to its end. {PLANT}: the model with the hidden effects themselves, "
        "moving air left out."
    )
    write_result("learning", "Learning: the paper's studies", "\n\n".join([head, *map(markdown, tables)]))


if __name__ == "__main__":
    main()
