"""Significant part of an effect, where parameters that may be neutral gain more than chance beside it.

Turbulence turns a vehicle and its controller answers, which looks like an inertia. The fit has widened the intervals of
what follows from that; the columns, which say that no effect of fewer parameters explains as much, know nothing of it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from diagnosis.estimation.fitted import Fit, neutral_values
from diagnosis.selection.candidates import Candidate, scales_rotors
from diagnosis.selection.rivals import declared_alike
from diagnosis.selection.search import Search
from dynamics.vehicle import Vehicle


def sure_part(search: Search, fitted: Fit, candidate: Candidate, vehicle: Vehicle) -> Candidate | None:
    """Candidate with those parameters alone that differ from neutral.

    None where all of them do, or none, where the others gain no more than chance, and for what does not scale the
    forces of all rotors, to which the answer is. vehicle: that lacks the effect.
    """
    if candidate.rotor is not None or not scales_rotors(candidate):
        return None
    limits, estimates = search.regression.thresholds, list(fitted.estimates.items())
    neutral = neutral_values(fitted, candidate, vehicle)
    sure = {
        name
        for (_, name), estimate, value in ((*estimates[place], value) for place, value in neutral.items())
        if abs(estimate.value - value) >= limits.relevance.deviations * estimate.std
    }
    if not sure or sure >= set(candidate.free):
        return None
    places = [(name, column) for name, column in zip(candidate.free, candidate.columns, strict=True) if name in sure]
    part = replace(candidate, free=tuple(name for name, _ in places), columns=tuple(column for _, column in places))
    others = [c for c in fitted.candidates if c is not candidate]
    unsure_gain = search.score([*others, candidate]).gain - search.score([*others, part]).gain
    return part if unsure_gain > limits.rivals.score_margin else None


def as_good_as(search: Search, others: Sequence[Candidate], part: Candidate) -> Candidate | None:
    """Of the effects that the catalogue declares to look alike the best one that explains as much with no more.

    others: beside which it stands. None where there is none.
    """
    taken = {c.effect.name for c in others}
    alike = [
        c
        for c in search.regression.candidates
        if declared_alike(c, part) and c.effect.name not in taken and len(c.columns) <= len(part.columns)
    ]
    limits, gain = search.regression.thresholds.rivals, search.score([*others, part]).gain
    level = gain - max(limits.score_margin, limits.gain_share * gain)
    best = max(search.scores([(*others, c) for c in alike]), key=lambda scored: scored.score, default=None)
    return None if best is None or best.gain < level else best.candidates[-1]
