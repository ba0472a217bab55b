"""Which effects explain what the model misses: forward search with pairs, cross-validated by leaving flights out.

Scores are twice the log-likelihood gained less a penalty for each coefficient, each point of a grid that was tried and
each effect of the catalogue (extended Bayesian information criterion). Coefficients must lie within physical bounds.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

from diagnosis.selection.candidates import Candidate
from diagnosis.selection.gust import Gust, gust_beside
from diagnosis.selection.regression import Regression
from diagnosis.thresholds import DEFAULT, SearchThresholds
from dynamics.arrays import Floats
from dynamics.vehicle import Vehicle

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


def min_score(candidates: Sequence[Candidate], thresholds: SearchThresholds = DEFAULT.search) -> float:
    """Score below which candidates are not claimed."""
    faults = all(c.effect.sensor_prior is not None for c in candidates)
    return thresholds.min_fault_gain if faults else thresholds.min_gain


@dataclass(frozen=True, eq=False)
class Selection:
    """What a search has selected.

    chosen: the effects, the most important first.
    singles: each effect alone at its best grid point, best first.
    gust_before, gust: random air motion before and after the effects.
    gust_detected: whether a gust is among what is missing.
    """

    chosen: Scored
    singles: tuple[Scored, ...]
    gust_before: Gust
    gust: Gust
    gust_detected: bool


class Search:
    """The search over one regression."""

    def __init__(self, regression: Regression) -> None:
        self.regression = regression
        self.thresholds = regression.thresholds.search
        self._grid_sizes = Counter(c.effect.name for c in regression.candidates)
        self._size = math.log(regression.independent)

    def penalty(self, candidate: Candidate) -> float:
        """The criterion's penalty of a candidate."""
        tried = 2 * math.log(self._grid_sizes[candidate.effect.name]) + 2 * math.log(len(self._grid_sizes) + 1)
        return len(candidate.columns) * self._size + tried

    def score(self, candidates: Sequence[Candidate]) -> Scored:
        """The score of a set of effects, -inf where a coefficient is physically impossible."""
        columns = [i for c in candidates for i in c.columns]
        theta, gain = self.regression.solve(columns)
        start = 0
        for candidate in candidates:
            part = theta[start : start + len(candidate.columns)]
            start += len(part)
            if not possible(candidate, part, self.regression.vehicle, self.thresholds):
                return Scored(tuple(candidates), IMPOSSIBLE, 0.0)
        return Scored(tuple(candidates), gain - sum(self.penalty(c) for c in candidates), gain)

    def singles(self) -> tuple[Scored, ...]:
        """Each effect alone at its best grid point, best first."""
        best: dict[str, Scored] = {}
        for candidate in self.regression.candidates:
            scored = self.score([candidate])
            name = candidate.effect.name
            if name not in best or scored.score > best[name].score:
                best[name] = scored
        return tuple(sorted(best.values(), key=lambda s: -s.score))

    def first(self, singles: Sequence[Scored]) -> Scored:
        """The best single effect: cross-validated among those of similar score; the simpler one of equal gain."""
        top, thresholds = singles[0], self.thresholds
        if top.score > thresholds.min_gain:
            near = [
                s for s in singles[: thresholds.max_contenders] if s.score > thresholds.min_contender_share * top.score
            ]
            top = max(near, key=lambda s: self.regression.cross_validated_gain(s.columns) - (s.gain - s.score))
        for other in singles:
            simpler = len(other.columns) < len(top.columns) and other.score > IMPOSSIBLE
            if simpler and other.gain >= thresholds.parsimony * top.gain:
                top = other
        return top

    def grow(self, start: Scored, singles: Sequence[Scored]) -> Scored:
        """Add effects, or exchange the first for a better pair, while cross-validation confirms the improvement."""
        chosen, thresholds = start, self.thresholds
        required = max(thresholds.min_gain, thresholds.min_share * start.gain)
        for step in range(thresholds.max_effects - 1):
            trials = [self.score([*chosen.candidates, c]) for c in self._others(chosen)]
            if step == 0:
                trials += self._pairs(singles)
            better = self._confirmed(chosen, trials, required)
            if better is None:
                break
            chosen = self._ordered(better)
        return self._on_best_grid_points(chosen)

    def _confirmed(self, chosen: Scored, trials: Sequence[Scored], required: float) -> Scored | None:
        """The best of the trials whose improvement on the chosen set is confirmed by cross-validation."""
        before = self.regression.cross_validated_gain(chosen.columns)
        for trial in sorted(trials, key=lambda s: -s.score)[: self.thresholds.max_trials]:
            improvement = trial.score - chosen.score
            if improvement <= required:
                return None
            shown = self.regression.cross_validated_gain(trial.columns) - before
            if shown > self.thresholds.min_cross_validated * improvement:
                return trial
        return None

    def _others(self, chosen: Scored) -> list[Candidate]:
        return [c for c in self.regression.candidates if c.effect.name not in chosen.names]

    def _pairs(self, singles: Sequence[Scored]) -> list[Scored]:
        first = singles[: self.thresholds.max_paired]
        return [self.score([*s.candidates, other]) for s in first for other in self._others(s)]

    def _ordered(self, chosen: Scored) -> Scored:
        """The same set, ordered by how much gain is lost without an effect, most first."""
        if len(chosen.candidates) < 2:
            return chosen
        rest = {c.key: self.score([o for o in chosen.candidates if o is not c]).gain for c in chosen.candidates}
        return Scored(tuple(sorted(chosen.candidates, key=lambda c: rest[c.key])), chosen.score, chosen.gain)

    def _on_best_grid_points(self, chosen: Scored) -> Scored:
        """The same effects, each at the grid point that scores best beside the others."""
        for index, candidate in enumerate(chosen.candidates):
            rest = list(chosen.candidates)
            for other in self.regression.candidates:
                if other.effect.name == candidate.effect.name:
                    trial = self.score([*rest[:index], other, *rest[index + 1 :]])
                    chosen = trial if trial.score > chosen.score else chosen
        return chosen


def possible(
    candidate: Candidate, theta: Floats, vehicle: Vehicle, thresholds: SearchThresholds = DEFAULT.search
) -> bool:
    """Whether coefficients lie within the physical bounds of their parameters, with a slack for noise."""
    if candidate.fixed_shape:
        size, (low, high) = abs(next(iter(candidate.sizes.values()))), thresholds.amplitude
        if candidate.present is not None:  # a correction may be small
            low = 0.0
        values = candidate.scaled(float(theta[0]))
        within = all(p.lower <= values[p.name] <= p.upper for p in candidate.effect.parameters)
        return bool(within and low < theta[0] < high and theta[0] * size >= candidate.effect.min_detectable)
    slack = {p.name: thresholds.bound_slack * p.prior(vehicle).std for p in candidate.effect.parameters}
    bounds = {p.name: (p.lower - slack[p.name], p.upper + slack[p.name]) for p in candidate.effect.parameters}
    return all(
        bounds[name][0] <= candidate.at[name] + float(value) <= bounds[name][1]
        for name, value in zip(candidate.free, theta, strict=True)
    )


def select(regression: Regression) -> Selection:
    """The effects that are missing, none where no score reaches its minimum."""
    search, thresholds = Search(regression), regression.thresholds.search
    singles = search.singles()
    before = gust_beside(regression, [])
    top = search.first(singles)
    gust_first = before.score > max(top.score, thresholds.min_gain)
    nothing = top.score < min_score(top.candidates, thresholds) and before.score < thresholds.min_gain
    if nothing or (gust_first and top.score < thresholds.min_share_beside_gust * before.score):
        return Selection(Scored((), 0.0, 0.0), singles, before, before, gust_first)
    chosen = search.grow(top, singles)
    after = gust_beside(regression, chosen.columns)
    gust_detected = after.score > max(thresholds.min_gain, thresholds.min_gust_share * chosen.gain)
    return Selection(chosen, singles, before, after, gust_detected)
