"""Revision of the accepted effects by the residuals that they leave: what is no effect, and what mattered after all."""

from __future__ import annotations

from collections.abc import Sequence

from diagnosis.data.dataset import Dataset
from diagnosis.estimation.acceptance import Accepted, judged_fit, refused_of
from diagnosis.estimation.consistency import drifts
from diagnosis.estimation.fitted import Fit
from diagnosis.estimation.late_signals import late_signal
from diagnosis.estimation.refusal import TOO_SMALL, Refused
from diagnosis.selection.candidates import Candidate
from diagnosis.selection.regression import Regression
from diagnosis.thresholds import ConsistencyThresholds
from dynamics.arrays import Floats


def drifting_effects(
    regression: Regression, fitted: Fit, rows: Sequence[Floats], *, rejected: bool
) -> tuple[Refused, ...]:
    """Effects of a fit that have no one value: their form stands in for another one.

    rows: (m, 12) its residuals. rejected: whether a test of these rejects; where none does, the difference of the
    values must be beyond doubt.
    """
    limits, by_key = regression.thresholds.consistency, drifts(regression, fitted, rows)
    return tuple(
        refused_of(fitted, candidate, "drifts", share=drift.share, deviations=drift.deviations)
        for candidate in fitted.candidates
        if (drift := by_key[candidate.key]).refutes(limits) or (rejected and drift.matters(limits))
    )


def overshadowed_effects(accepted: Accepted, limits: ConsistencyThresholds) -> tuple[Refused, ...]:
    """Effects that explain next to nothing of what is still missing: some form explains a little of anything.

    In the kind of channel whose error falls most, over all its axes, or on the axis that falls most.
    """
    refused = []
    for candidate in accepted.fit.candidates:
        kind, change = max(accepted.relevance[candidate.key].items(), key=lambda item: item[1].fall)
        on_axis = change.share_of_axis >= limits.min_share_of_axis and change.share_of_left >= limits.min_share_at_all
        if change.share_of_left < limits.min_share_of_left and not on_axis:
            refused.append(refused_of(accepted.fit, candidate, "overshadowed", kind, share=change.share_of_left))
    return tuple(refused)


def effects_of_late_signal(regression: Regression, fitted: Fit, rows: Sequence[Floats]) -> tuple[Refused, ...]:
    """Effects of a fit that a signal which was logged late explains as well. rows: (m, 12) its residuals."""
    late = late_signal(regression, fitted, rows)
    if late is None:
        return ()
    return tuple(
        refused_of(fitted, c, "late_signal", late.signal, delay=late.delay, gain=late.gain, of_effects=late.of_effects)
        for c in fitted.candidates
        if c.key in late.keys
    )


def without(regression: Regression, accepted: Accepted, refused: Sequence[Refused], dataset: Dataset) -> Accepted:
    """Accepted set without effects that are refused afterwards, all others judged again."""
    left_out = {(one.name, one.rotor) for one in refused}
    rest = [c for c in accepted.fit.candidates if c.identity not in left_out]
    return judged_fit(regression, rest, dataset, regression.vehicle, refused=(*accepted.refused, *refused))


def with_small(
    regression: Regression, accepted: Accepted, chosen: Sequence[Candidate], dataset: Dataset
) -> Accepted | None:
    """Accepted set with those effects that were too small on what is held out, where the fitted flights show
    that they matter; None without any.

    Seconds that are held out may lack their motion. They are not to make any error there worse.
    """
    small = {(one.name, one.rotor) for one in accepted.refused if one.reason in TOO_SMALL}
    again = [c for c in chosen if c.identity in small]
    if not again:
        return None
    others = [one for one in accepted.refused if (one.name, one.rotor) not in {c.identity for c in again}]
    together, keys = [*accepted.fit.candidates, *again], {c.key for c in again}
    trial = judged_fit(regression, together, dataset, regression.vehicle, refused=others, small=keys)
    return trial if keys & set(trial.fit.keys) else None
