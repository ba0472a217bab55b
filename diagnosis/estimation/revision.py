"""Revision of the named effects by the residuals that they leave: which of them have no one value."""

from __future__ import annotations

from collections.abc import Sequence

from diagnosis.estimation.acceptance import refused_of
from diagnosis.estimation.consistency import drifts
from diagnosis.estimation.fitted import Fit
from diagnosis.estimation.refusal import Refused
from diagnosis.selection.regression import Regression
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
