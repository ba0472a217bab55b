"""The effects that an answer names: of the best set those that are surely there, each with what may be in its place."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from diagnosis.likelihood.identify import Identified
from diagnosis.likelihood.problem import Problem
from diagnosis.selection.candidates import Candidate


@dataclass(frozen=True, eq=False)
class Named:
    """An effect of the best set.

    values, std: of its free parameters. log_odds: of the set against that without it.
    rivals: names of effects in whose place the set is nearly as likely.
    """

    candidate: Candidate
    values: Mapping[str, float]
    std: Mapping[str, float]
    log_odds: float
    rivals: tuple[str, ...]

    @property
    def probability(self) -> float:
        """That it is there, beside the others of its set."""
        return float(1 / (1 + np.exp(-self.log_odds)))


def named_effects(problem: Problem, result: Identified) -> tuple[Named, ...]:
    """The effects of the best set but those that are not surely there, or too small to be claimed."""
    search, best, required, first = result.search, result.best, problem.thresholds.named, 0
    made, values = [], search.named_values(best)
    for number in best.members:
        candidate, own = problem.what.all[number], values[number]
        deviations = result.std[first : first + len(own)]
        first += len(own)
        log_odds = best.evidence - search.score([i for i in best.members if i != number]).evidence
        present = candidate.present or {p.name: p.neutral for p in candidate.effect.parameters}
        size = max(abs(value - present[name]) for name, value in own.items())
        if log_odds < required or size < candidate.effect.min_detectable:
            continue
        rivals = {problem.what.all[i].effect.name for i in search.rivals(best, number, required)}
        made.append(
            Named(
                candidate=candidate,
                values=own,
                std=dict(zip(own, map(float, deviations), strict=True)),
                log_odds=log_odds,
                rivals=tuple(sorted(rivals - {candidate.effect.name})),
            )
        )
    return tuple(sorted(made, key=lambda one: -one.log_odds))
