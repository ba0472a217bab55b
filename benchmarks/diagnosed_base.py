"""A grey box on the effects that `alula diagnose` names, beside one on the effects that the campaign truly hides.

Needs `alula campaign --out build/campaign_learning`. Trains through `alula train`, four members each with the same
seeds; interrupted, it resumes. The vehicle file knows none of the effects.
"""

from __future__ import annotations

import argparse

from benchmarks.learning_goals import CAMPAIGN, GREY_STEPS, NAMED, judged, trained
from benchmarks.provenance import write_result
from studies.tables import Table, TableCell, markdown
from training.ground_truth import true_label
from training.prediction import flight_errors, pooled, predict

MEMBERS = 4
BASES = {"true effects, fitted": NAMED, "diagnosed effects": ("--effect", "diagnosed")}


def table() -> Table:
    """RMSE of both against the truth on the campaign's eight test flights."""
    rows: list[tuple[TableCell, ...]] = []
    first = 0.0
    for name, effects in BASES.items():
        file = f"base_{effects[-1]}"
        members = ("--ensemble", str(MEMBERS), "--steps", str(GREY_STEPS))
        model = trained(file, [CAMPAIGN], "--model", "grey_box", *members, *effects)
        data = judged(model)
        truth = true_label(data, CAMPAIGN, dt=model.config.dt)
        both = pooled(flight_errors(data, predict(model, data).body, truth))
        assert data.base is not None
        base = pooled(flight_errors(data, data.base[data.ends], truth))
        first = first or both.combined
        named = ", ".join(use.label for use in model.vehicle.effects)
        rows.append((name, named, base.combined, both.linear, both.angular, both.combined, both.combined / first))
    headings = ("base", "effects", "base alone", "linear, m/s²", "angular, rad/s²", "both", "both / true effects")
    note = f"{MEMBERS} members of {GREY_STEPS:,} steps each; all test flights as one. Goal: at most 1.05."
    return Table("diagnosed_base", "RMSE against the truth", headings, tuple(rows), note)


def main() -> None:
    argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter).parse_args()
    write_result("diagnosed_base", "A grey box on diagnosed effects", markdown(table()))


if __name__ == "__main__":
    main()
