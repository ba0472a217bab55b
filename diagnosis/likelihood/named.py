"""The effects that an answer names: of the best set those that are surely there, each with what may be in its place."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from diagnosis.likelihood.evidence import IMPOSSIBLE
from diagnosis.likelihood.identify import Identified
from diagnosis.selection.candidates import Candidate


@dataclass(frozen=True, eq=False)
class Named:
    """An effect of the best set.

    number: among the candidates. log_odds: of the set against that without it. rivals: names of effects in whose place
    the set is nearly as likely.
    """

    number: int
    candidate: Candidate
    log_odds: float
    rivals: tuple[str, ...]

    @property
    def probability(self) -> float:
        """That it is there, beside the others of its set."""
        return float(1 / (1 + np.exp(-self.log_odds)))


@dataclass(frozen=True, eq=False)
class Doubted:
    """An effect of the best set that is not named.

    values: of its parameters. odds: of the set against that without it; where these are enough, it is too small: of its
    size, in its parameter's unit, the effect's min_detectable is required.
    """

    candidate: Candidate
    values: dict[str, float]
    odds: float
    size: float


def named_effects(result: Identified) -> tuple[tuple[Named, ...], tuple[Doubted, ...]]:
    """The effects of the best set, the surest first; and those of it that are not surely there, or too small."""
    search, best, made, doubted = result.search, result.best, [], []
    required = search.problem.thresholds.named
    for number, own in search.named_values(best).items():
        candidate = search.what.all[number]
        log_odds = best.evidence - search.score([i for i in best.members if i != number]).evidence
        present = candidate.present or {p.name: p.neutral for p in candidate.effect.parameters}
        size = max(abs(value - present[name]) for name, value in own.items())
        if log_odds < required or size < candidate.effect.min_detectable:
            doubted.append(Doubted(candidate, own, float(np.exp(log_odds)), size))
            continue
        rivals = {search.what.all[i].effect.name for i in search.rivals(best, number, required)}
        made.append(Named(number, candidate, log_odds, tuple(sorted(rivals - {candidate.effect.name}))))
    made.sort(key=lambda one: -one.log_odds)
    while made and search.score([one.number for one in made]).evidence == IMPOSSIBLE:
        made.pop()
    return tuple(made), tuple(doubted)
