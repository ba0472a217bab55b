"""Which effects explain what the model misses: forward search with pairs, kept honest by leaving flights out.

Scores are twice the log-likelihood gained less a penalty for each coefficient, each variant that was tried and each
effect of the catalogue (extended Bayesian information criterion). Coefficients must lie within physical bounds.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from diagnosis.selection.candidates import Candidate
from diagnosis.selection.gust import Gust, gust_gain
from diagnosis.selection.regression import Regression
from dynamics.arrays import Floats
from dynamics.vehicle import Vehicle

MIN_GAIN = 40.0  # of score, below which nothing is claimed; feedback makes inertia reach 29 where nothing is hidden
MIN_FAULT = 15.0  # the same for what a sensor has beyond its specification, which feedback does not imitate
MIN_SHARE = 0.003  # of the first effect's gain that a further one must bring
PARSIMONY = 0.985  # share of the gain at which the effect with fewer coefficients is preferred
CROSSED = 0.3  # share of an improvement that must also show on flights left out
MOST = 3  # effects found in one go
CLOSE = 8  # effects with which pairs are searched
BOUND_SLACK = 0.02  # of a parameter's usual deviation by which noise may push it over its bound
WHOLE = (0.4, 1.9)  # amplitude of an effect regressed as a whole
IMPOSSIBLE = -math.inf


@dataclass(frozen=True, eq=False)
class Scored:
    """A set of candidates with its score and gain."""

    candidates: tuple[Candidate, ...]
    score: float
    gain: float

    @property
    def columns(self) -> list[int]:
        """Its columns in the regression."""
        return [i for c in self.candidates for i in c.columns]

    @property
    def names(self) -> set[str]:
        """Its effects."""
        return {c.effect.name for c in self.candidates}


def least_gain(candidates: Sequence[Candidate]) -> float:
    """Score below which these are not claimed."""
    faults = all(c.effect.sensor_prior is not None for c in candidates)
    return MIN_FAULT if faults else MIN_GAIN


@dataclass(frozen=True, eq=False)
class Selection:
    """chosen: the effects found, the most important first. singles: each effect's best variant alone, best first.

    gust, gust_before: random air motion after and before them. blows: whether a gust is among what was found.
    """

    chosen: Scored
    singles: tuple[Scored, ...]
    gust_before: Gust
    gust: Gust
    blows: bool


class Search:
    """The search over one regression."""

    def __init__(self, regression: Regression) -> None:
        self.regression = regression
        self._variants: dict[str, int] = {}
        for candidate in regression.candidates:
            self._variants[candidate.effect.name] = self._variants.get(candidate.effect.name, 0) + 1
        self._size = math.log(regression.total / 4)

    def penalty(self, candidate: Candidate) -> float:
        """What a candidate must gain to be worth its coefficients."""
        tried = 2 * math.log(self._variants[candidate.effect.name]) + 2 * math.log(len(self._variants) + 1)
        return len(candidate.columns) * self._size + tried

    def score(self, candidates: Sequence[Candidate]) -> Scored:
        """The score of a set of effects, -inf where a coefficient cannot be."""
        columns = [i for c in candidates for i in c.columns]
        theta, gain = self.regression.solve(columns)
        start = 0
        for candidate in candidates:
            part = theta[start : start + len(candidate.columns)]
            start += len(part)
            if not possible(candidate, part, self.regression.vehicle):
                return Scored(tuple(candidates), IMPOSSIBLE, 0.0)
        return Scored(tuple(candidates), gain - sum(self.penalty(c) for c in candidates), gain)

    def singles(self) -> tuple[Scored, ...]:
        """Each effect's best variant alone, best first."""
        best: dict[str, Scored] = {}
        for candidate in self.regression.candidates:
            scored = self.score([candidate])
            name = candidate.effect.name
            if name not in best or scored.score > best[name].score:
                best[name] = scored
        return tuple(sorted(best.values(), key=lambda s: -s.score))

    def first(self, singles: Sequence[Scored]) -> Scored:
        """The best single effect, by flights left out among those that come close, the simpler one when equal."""
        top = singles[0]
        if top.score > MIN_GAIN:
            near = [s for s in singles[:5] if s.score > 0.5 * top.score]
            top = max(near, key=lambda s: self.regression.crossed_gain(s.columns) - (s.gain - s.score))
        for other in singles:
            simpler = len(other.columns) < len(top.columns) and other.score > IMPOSSIBLE
            if simpler and other.gain >= PARSIMONY * top.gain:
                top = other
        return top

    def grow(self, start: Scored, singles: Sequence[Scored]) -> Scored:
        """Add effects, or exchange for a better pair, while flights left out agree."""
        found, first_gain = start, start.gain
        for step in range(MOST - 1):
            trials = [self.score([*found.candidates, c]) for c in self._others(found)]
            if step == 0:
                trials += self._pairs(singles)
            need = max(MIN_GAIN, MIN_SHARE * first_gain)
            crossed = self.regression.crossed_gain(found.columns)
            better = None
            for trial in sorted(trials, key=lambda s: -s.score)[:12]:
                improvement = trial.score - found.score
                if improvement <= need:
                    break
                if self.regression.crossed_gain(trial.columns) - crossed > CROSSED * improvement:
                    better = trial
                    break
            if better is None:
                break
            found = self._ordered(better)
        return self._best_variants(found)

    def _others(self, found: Scored) -> list[Candidate]:
        return [c for c in self.regression.candidates if c.effect.name not in found.names]

    def _pairs(self, singles: Sequence[Scored]) -> list[Scored]:
        return [self.score([*s.candidates, other]) for s in singles[:CLOSE] for other in self._others(s)]

    def _ordered(self, found: Scored) -> Scored:
        """The same with the effect first whose loss would cost most."""
        if len(found.candidates) < 2:
            return found
        rest = {c.key: self.score([o for o in found.candidates if o is not c]).gain for c in found.candidates}
        return Scored(tuple(sorted(found.candidates, key=lambda c: rest[c.key])), found.score, found.gain)

    def _best_variants(self, found: Scored) -> Scored:
        for index, candidate in enumerate(found.candidates):
            rest = list(found.candidates)
            for other in self.regression.candidates:
                if other.effect.name == candidate.effect.name:
                    trial = self.score([*rest[:index], other, *rest[index + 1 :]])
                    found = trial if trial.score > found.score else found
        return found


def possible(candidate: Candidate, theta: Floats, vehicle: Vehicle) -> bool:
    """Whether coefficients lie within the physical bounds of their parameters, but for a little noise."""
    if candidate.whole:
        size = next(iter(candidate.at.values()))
        return bool(WHOLE[0] < theta[0] < WHOLE[1] and theta[0] * size >= candidate.effect.min_detectable)
    slack = {p.name: BOUND_SLACK * p.prior(vehicle).std for p in candidate.effect.parameters}
    bounds = {p.name: (p.lower - slack[p.name], p.upper + slack[p.name]) for p in candidate.effect.parameters}
    return all(
        bounds[name][0] <= candidate.at[name] + float(value) <= bounds[name][1]
        for name, value in zip(candidate.free, theta, strict=True)
    )


def select(regression: Regression) -> Selection:
    """The effects that are missing, none if nothing is worth its coefficients."""
    search = Search(regression)
    singles = search.singles()
    before = gust_gain(regression, [])
    top = search.first(singles)
    blows_first = before.score > max(top.score, MIN_GAIN)
    nothing = Scored((), 0.0, 0.0)
    nothing_found = top.score < least_gain(top.candidates) and before.score < MIN_GAIN
    if nothing_found or (blows_first and top.score < 0.5 * before.score):
        return Selection(nothing, singles, before, before, blows_first)
    chosen = search.grow(top, singles)
    after = gust_gain(regression, chosen.columns)
    blows = after.score > max(MIN_GAIN, 0.10 * chosen.gain)
    return Selection(chosen, singles, before, after, blows)


def resampled(regression: Regression, singles: Sequence[Scored], *, count: int = 40, seed: int = 0) -> dict[str, float]:
    """Share of flight resamples in which each of the best effects comes first."""
    random = np.random.default_rng(seed)
    search = Search(regression)
    near = [s for s in singles[:8] if s.score > IMPOSSIBLE]
    wins: dict[str, float] = {}
    for _ in range(count):
        flights = random.choice(len(regression.flights), len(regression.flights)).tolist()
        scores = [regression.gain(s.columns, flights) - sum(search.penalty(c) for c in s.candidates) for s in near]
        name = near[int(np.argmax(scores))].candidates[0].effect.name
        wins[name] = wins.get(name, 0.0) + 1 / count
    return wins
