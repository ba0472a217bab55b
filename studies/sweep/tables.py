"""Tables of a study, with the paper's own figures where it has them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from studies import paper
from studies.sweep.cell import CellResult, Outcome, grouped, trained
from studies.tables import Table, TableCell
from training.prediction import pooled

BY_FLIGHT = ("kinds", "starred")  # studies that are columns of the paper's Table I
PAPER_HEADINGS = {
    "ablation": ("paper RMSE", "paper ±"),
    "history": ("paper RMSE", "paper ±", "paper ms"),
}


def study_tables(study: str, along: Sequence[str], outcomes: Sequence[Outcome]) -> tuple[Table, ...]:
    """The study's table, and for columns of the paper's Table I their ratio to NOM by flight."""
    tables = [study_table(study, along, outcomes)]
    if study in BY_FLIGHT and trained(outcomes):
        tables.append(_flights_table(study, trained(outcomes)))
    return tuple(tables)


def study_table(study: str, along: Sequence[str], outcomes: Sequence[Outcome]) -> Table:
    """A row for each place of the study: RMSE of the seeds, mean and deviation, and the paper's figure."""
    results, failed = trained(outcomes), len(outcomes) - len(trained(outcomes))
    rows = []
    for place, members in grouped(outcomes, *along).items():
        trained_members = trained(members)
        counts = (len(trained_members), len(members) - len(trained_members)) if failed else (len(trained_members),)
        rows.append((*place, *_numbers(trained_members), *counts, *_papers(study, place)))
    truth = "the truth" if results and results[0].true else "labels"
    headings = (
        *along, "RMSE", "± seeds", "m/s²", "rad/s²", "against labels", "/ NOM", "± flights", "inference ms",
        "steps", "training s", "seeds", *(("failed",) if failed else ()), *PAPER_HEADINGS.get(study, ()),
    )  # fmt: skip
    note = f"RMSE on the test flights against {truth}, linear and angular alike, all flights as one."
    if failed:
        note += f" {failed} of {len(outcomes)} trainings failed: the same command tries them again."
    return Table(study, f"Study: {study}", headings, tuple(rows), note)


def _numbers(results: Sequence[CellResult]) -> tuple[TableCell, ...]:
    """Means over the seeds of a place, from RMSE to seconds."""
    if not results:
        return (None,) * 10
    best = [pooled(result.best_known) for result in results]
    both = np.array([error.combined for error in best])
    flights = np.mean([[e.combined for e in result.best_known] for result in results], axis=0)
    return (
        float(both.mean()),
        float(both.std(ddof=1)) if len(both) > 1 else None,
        float(np.mean([error.linear for error in best])),
        float(np.mean([error.angular for error in best])),
        float(np.mean([pooled(result.label).combined for result in results])),
        float(np.mean([error.combined / error.nominal for error in best])),
        float(flights.std()),
        float(1000 * np.median([result.inference for result in results])),
        max(result.steps for result in results),
        float(np.mean([result.seconds for result in results])),
    )


def _papers(study: str, place: tuple[float | str, ...]) -> tuple[TableCell, ...]:
    if study == "ablation":
        return paper.ABLATION[place[0] == "yes", place[1] == "yes"]
    if study == "history":
        milliseconds, rmse, deviation = paper.HISTORY[int(place[0])]
        return rmse, deviation, milliseconds
    return ()


def _flights_table(study: str, results: Sequence[CellResult]) -> Table:
    """RMSE over NOM's by test flight and model, against labels like the paper's, each with the paper's."""
    models = grouped(results, "model")
    published = {kind for row in paper.PREDICTION.values() for kind in row}
    headings = ["flight"]
    for (model,) in models:
        headings += [f"{model} / NOM"] + (["paper's"] if model in published else [])
    rows = []
    for place, error in enumerate(results[0].label):
        cells: list[TableCell] = [error.flight.split(".")[0]]
        for (model,), members in models.items():
            errors = [result.label[place] for result in members]
            cells.append(float(np.mean([e.combined / e.nominal for e in errors])))
            if model in published:
                cells.append(paper.prediction_ratio(error.flight, str(model)))
        rows.append(tuple(cells))
    note = "Against labels, mean of the seeds. A star: trained in a simulation without effects alone."
    return Table(f"{study}_flights", f"Study: {study}, RMSE over NOM's by flight", tuple(headings), tuple(rows), note)


def search_table(names: Sequence[str], outcomes: Sequence[Outcome]) -> Table:
    """Trials, the best on the validation flights first, those that failed last."""
    ordered = sorted(trained(outcomes), key=lambda result: result.validation)
    rows: list[tuple[TableCell, ...]] = [
        (
            result.cell.name,
            *(result.cell.at[name] for name in names),
            result.validation,
            pooled(result.best_known).combined,
        )
        for result in ordered
    ]
    rows += [
        (outcome.cell.name, *(outcome.cell.at[name] for name in names), None, None)
        for outcome in outcomes
        if outcome not in ordered
    ]
    note = "Ordered by the error on the validation flights, by which the best is chosen."
    return Table("search", "Search", ("trial", *names, "validation", "test RMSE"), tuple(rows), note)
