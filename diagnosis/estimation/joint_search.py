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
from diagnosis.selection.search import Search, Selection, select, select_from


def search_jointly(regression: Regression) -> tuple[Regression, Selection]:
    """What is missing, and the regression about it: linear about the joint fit, in the gust that was detected."""
    thresholds, own, nuisances = regression.thresholds.search, regression.candidates, regression.nuisances
    selection = select(regression)
    for number in range(thresholds.max_rounds - 1):
        chosen = selection.chosen.candidates
        if not chosen:
            break
        fitted = fit(regression, chosen)
        is_explained = fitted.chi_square < thresholds.explained
        if number == 0 and not is_explained:
            pairs = (fit(regression, pair) for pair in _drags_in_wind(regression, selection))
            fitted = next((f for f in pairs if f.chi_square < thresholds.max_pair_share * fitted.chi_square), fitted)
        # about another fit, a gust beside one that explains the flights is what its columns leave
        is_done = is_explained and (number == 0 or not selection.gust_detected)
        if fitted.unsettled or is_done:
            break
        values = fitted.values
        held = about_values(own, fitted.candidates, values)
        again = about_fit(regression, held, about_values(nuisances, nuisances, values))
        if again is None:
            break
        regression = again
        selection = select_from(regression, [c for c in held if c.fitted is not None], selection)
        if {c.key for c in selection.chosen.candidates} <= set(fitted.keys):
            break
    return regression.in_gust(selection.gust_variance), selection


def _drags_in_wind(regression: Regression, selection: Selection) -> list[tuple[Candidate, ...]]:
    """The drag that explains most together with a steady wind, where the air moves and the vehicle lacks a drag.

    Wind acts through drag, at the rotors or wherever the drag does: about a vehicle without one its columns miss the
    moments, and the search fills up with what resembles them, or takes the wind for a gust.
    """
    thresholds, drags = regression.thresholds.search, [c for c in regression.candidates if c.effect.resists_air]
    if selection.gust_before.score < thresholds.min_gain or any(c.present is not None for c in drags):
        return []
    winds = [c for c in regression.candidates if c.effect.wind is not None]
    pairs = [(drag, wind) for drag in drags for wind in winds]
    best = max(Search(regression).scores(pairs), key=lambda one: one.score, default=None)
    return [] if best is None or best.score < thresholds.min_gain else [best.candidates]


def about_values(
    own: Sequence[Candidate], fitted: Sequence[Candidate], values: Mapping[tuple[str, str], float]
) -> tuple[Candidate, ...]:
    """Candidates, those that were fitted about their values by (key, parameter). own: about the vehicle's own model."""
    places = {c.columns for c in fitted}
    return tuple(
        c.about({n: v for (key, n), v in values.items() if key == c.key}) if c.columns in places else c for c in own
    )
