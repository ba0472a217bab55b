"""Search and fit in turns: what was selected is fitted jointly, all columns are made again about that fit, and the
search goes on, until it adds nothing.

Effects change each other's columns, so that the first linearisation, about the vehicle's own model, is wrong where
much is missing.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from diagnosis.estimation.equation_error import fit
from diagnosis.selection.candidates import Candidate
from diagnosis.selection.regression import Regression
from diagnosis.selection.regression_of_flights import about_fit
from diagnosis.selection.search import Selection, select, select_from


def search_jointly(regression: Regression) -> tuple[Regression, Selection]:
    """What is missing, and the regression about it: linear about the joint fit, in the gust that was detected."""
    thresholds, own, nuisances = regression.thresholds.search, regression.candidates, regression.nuisances
    selection = select(regression)
    for _ in range(thresholds.max_rounds - 1):
        chosen = selection.chosen.candidates
        if not chosen:
            break
        fitted = fit(regression, chosen)
        if fitted.unsettled or fitted.chi_square < thresholds.explained:
            break
        values = fitted.values
        held = about_values(own, fitted.candidates, values)
        again = about_fit(regression, held, about_values(nuisances, nuisances, values))
        if again is None:
            break
        regression = again
        selection = select_from(regression, [c for c in held if c.fitted is not None], selection)
        if {c.key for c in selection.chosen.candidates} <= {c.key for c in chosen}:
            break
    return regression.in_gust(selection.gust_variance), selection


def about_values(
    own: Sequence[Candidate], fitted: Sequence[Candidate], values: Mapping[tuple[str, str], float]
) -> tuple[Candidate, ...]:
    """Candidates, those that were fitted about their values by (key, parameter). own: about the vehicle's own model."""
    places = {c.columns for c in fitted}
    return tuple(
        c.about({n: v for (key, n), v in values.items() if key == c.key}) if c.columns in places else c for c in own
    )
