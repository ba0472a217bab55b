"""Which effects explain what the model misses: forward, swap and backward steps, cross-validated over flights.

Scores are twice the log-likelihood gained less a penalty for each coefficient, each point of a grid that was tried and
each effect of the catalogue (extended Bayesian information criterion). Coefficients must lie within physical bounds.
Every step raises the set's worth, its score less what each of its effects must gain at least, so that the search ends.
"""

from __future__ import annotations

import itertools
import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from diagnosis.selection.candidates import Candidate
from diagnosis.selection.coefficients import coefficient_bounds
from diagnosis.selection.regression import Regression, solved
from diagnosis.thresholds import DEFAULT, SearchThresholds
from dynamics.arrays import Floats
from dynamics.vehicle import Vehicle

IMPOSSIBLE = -math.inf
Set = tuple[Candidate, ...]


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


@dataclass(frozen=True, eq=False)
class _Solutions:
    """Solutions of n sets.

    gains, scores, worths: (n,) of each, as in `Search`; where a coefficient is physically impossible 0 and -inf.
    fits: of each impossible set by its number, column by column whether the coefficient is possible.
    """

    sets: Sequence[Set]
    gains: Floats
    scores: Floats
    worths: Floats
    fits: Mapping[int, Sequence[bool]]

    def scored(self, number: int) -> Scored:
        """A set."""
        return Scored(self.sets[number], float(self.scores[number]), float(self.gains[number]))

    def fitting(self, number: int) -> Set:
        """Effects of a set whose coefficients are possible in it."""
        fits, fitting, start = self.fits[number], [], 0
        for candidate in self.sets[number]:
            stop = start + len(candidate.columns)
            if all(fits[start:stop]):
                fitting.append(candidate)
            start = stop
        return tuple(fitting)


def _distance_of_assumed(candidate: Candidate, vehicle: Vehicle) -> float:
    """Squared deviations of a grid point from the prior of the parameters that flights hardly show."""
    priors = {p.name: p.prior(vehicle) for p in candidate.effect.parameters if p.name in candidate.effect.assumed}
    return sum(((candidate.at[name] - prior.mean) / prior.std) ** 2 for name, prior in priors.items())


def min_score(candidates: Sequence[Candidate], thresholds: SearchThresholds = DEFAULT.search) -> float:
    """Score below which candidates are not claimed."""
    faults = all(c.effect.sensor_prior is not None for c in candidates)
    return thresholds.min_fault_gain if faults else thresholds.min_gain


class Search:
    """The search over one regression, in the gust that is marginalised there.

    required: score by which an effect must raise that of the others.
    """

    def __init__(self, regression: Regression, required: float | None = None) -> None:
        self.regression = regression
        self.thresholds = regression.thresholds.search
        self.required = self.thresholds.min_gain if required is None else required
        self._gram, self._product = regression.summed()
        grid_sizes = Counter(c.effect.name for c in regression.candidates)
        of_catalogue = 2 * math.log(len(grid_sizes) + 1)
        self._points = {name: 2 * math.log(size) + of_catalogue for name, size in grid_sizes.items()}
        self._size = math.log(regression.independent)
        self._assumed = {c.columns: _distance_of_assumed(c, regression.vehicle) for c in regression.candidates}
        self._low, self._high = self._bounds()
        self._first, self._move, self._penalties = (np.zeros(len(self._product)) for _ in range(3))
        for candidate in regression.candidates:
            place = candidate.columns[0]
            self._first[place], self._move[place] = 1.0, candidate.effect.sensor_prior is None
            self._penalties[place] = self.penalty(candidate)

    def _bounds(self) -> tuple[Floats, Floats]:
        """(k,) coefficients' bounds, column by column."""
        low, high = np.zeros(len(self._product)), np.zeros(len(self._product))
        for candidate in self.regression.candidates:
            columns = list(candidate.columns)
            low[columns], high[columns] = coefficient_bounds(candidate, self.regression.vehicle, self.thresholds)
        return low, high

    def penalty(self, candidate: Candidate) -> float:
        """The criterion's penalty of a candidate."""
        assumed = self._assumed.get(candidate.columns, 0.0)
        return len(candidate.columns) * self._size + self._points[candidate.effect.name] + assumed

    def score(self, candidates: Sequence[Candidate]) -> Scored:
        """The score of a set of effects, -inf where a coefficient is physically impossible."""
        return self.scores([tuple(candidates)])[0]

    def scores(self, sets: Sequence[Set]) -> list[Scored]:
        """The score of each set, those of equal width at once."""
        solutions = self._solved(sets)
        return [solutions.scored(number) for number in range(len(sets))]

    def _solved(self, sets: Sequence[Set]) -> _Solutions:
        """The solution of each set, those of equal width at once."""
        places = [[place for c in one for place in c.columns] for one in sets]
        by_width: dict[int, list[int]] = {}
        for number, columns in enumerate(places):
            by_width.setdefault(len(columns), []).append(number)
        gains, scores, worths = (np.zeros(len(sets)) for _ in range(3))
        fits: dict[int, list[bool]] = {}
        for width, numbers in by_width.items():
            where = np.array([places[n] for n in numbers], dtype=int).reshape(len(numbers), width)
            theta, gain = solved(self._gram[where[:, :, None], where[:, None, :]], self._product[where])
            inside = (theta >= self._low[where]) & (theta <= self._high[where])
            possible = inside.all(axis=1)
            gains[numbers] = np.where(possible, gain, 0.0)
            scores[numbers] = np.where(possible, gain - self._penalties[where].sum(axis=1), IMPOSSIBLE)
            moves = self._move[where].sum(axis=1) > 0
            required = np.where(moves, self.required, self.thresholds.min_fault_gain)
            worths[numbers] = scores[numbers] - required * self._first[where].sum(axis=1)
            misses = np.flatnonzero(~possible)
            fits |= zip([numbers[n] for n in misses.tolist()], inside[misses].tolist(), strict=True)
        return _Solutions(sets, gains, scores, worths, fits)

    def possible_scores(self, sets: Sequence[Set], above: float = IMPOSSIBLE) -> list[Scored]:
        """The score of each set without the effects that would be impossible in it, no set twice.

        above: what those that are listed are worth at least.
        """
        waiting, results = list(sets), dict[frozenset[Candidate], Scored]()
        while waiting:
            solutions = self._solved(waiting)
            scored = map(solutions.scored, np.flatnonzero(solutions.worths > above).tolist())
            named = {frozenset(one.candidates): one for one in scored}
            results |= {identity: one for identity, one in named.items() if identity not in results}
            rests = map(solutions.fitting, solutions.fits)
            waiting = list({frozenset(rest): rest for rest in rests if frozenset(rest) not in results}.values())
        return list(results.values())

    def worth(self, scored: Scored) -> float:
        """Objective of the search: the score less what each effect must gain at least."""
        faults = all(c.effect.sensor_prior is not None for c in scored.candidates)
        required = self.thresholds.min_fault_gain if faults else self.required
        return scored.score - required * len(scored.candidates)

    def singles(self) -> tuple[Scored, ...]:
        """Each effect alone at its best grid point, best first."""
        best: dict[str, Scored] = {}
        for scored in self.scores([(candidate,) for candidate in self.regression.candidates]):
            name = scored.candidates[0].effect.name
            if name not in best or scored.score > best[name].score:
                best[name] = scored
        return tuple(sorted(best.values(), key=lambda s: -s.score))

    def first(self, singles: Sequence[Scored]) -> Scored:
        """The best single effect: cross-validated among those of similar score; the simpler one of equal gain."""
        top, thresholds = singles[0], self.thresholds
        if top.score > thresholds.min_gain:
            required = thresholds.min_contender_share * top.score
            near = [s for s in singles[: thresholds.max_contenders] if s.score >= required]
            top = max(near, key=lambda s: self.regression.cross_validated_gain(s.columns) - (s.gain - s.score))
        for other in singles:
            simpler = len(other.columns) < len(top.columns) and other.score > IMPOSSIBLE
            if simpler and other.gain >= thresholds.parsimony * top.gain:
                top = other
        return top

    def better(self, chosen: Scored) -> Scored | None:
        """A set that is worth more: one effect fewer, more or exchanged; if none is, one for two or two for one."""
        near = [*self._fewer(chosen), *self._more(chosen), *self._exchanged(chosen)]
        return self._confirmed(chosen, near) or self._confirmed(chosen, [*self._merged(chosen), *self._pairs(chosen)])

    def near(self, chosen: Set) -> list[Scored]:
        """Sets that are worth more with one effect more, or one or two exchanged, the best first."""
        own = self.score(chosen)
        return self._worth_more(own, [*self._more(own), *self._exchanged(own), *self._pairs_exchanged(own)])

    def merged(self, chosen: Set) -> list[Scored]:
        """Sets that are worth more with one effect in place of two, the best first."""
        own = self.score(chosen)
        return self._worth_more(own, self._merged(own))

    def _worth_more(self, own: Scored, trials: Sequence[Set]) -> list[Scored]:
        worth_more = self.possible_scores(trials, self.worth(own))
        return sorted(filter(self._allowed, worth_more), key=lambda scored: -self.worth(scored))

    def _confirmed(self, chosen: Scored, trials: Sequence[Set]) -> Scored | None:
        """The trial worth most, if cross-validation shows enough of what it improves."""
        required = self.worth(chosen) + self.thresholds.min_improvement
        worth_more = [s for s in self.possible_scores(trials, required) if self._allowed(s)]
        if not worth_more:
            return None
        before = self.regression.cross_validated_gain(chosen.columns)
        for trial in sorted(worth_more, key=lambda s: -self.worth(s))[: self.thresholds.max_trials]:
            improvement = min(trial.score - chosen.score, trial.gain - chosen.gain)
            if improvement <= 0:  # fewer effects, for next to no loss
                return trial
            shown = self.regression.cross_validated_gain(trial.columns) - before
            if shown > self.thresholds.min_cross_validated * improvement:
                return trial
        return None

    def _allowed(self, scored: Scored) -> bool:
        return len(scored.candidates) <= self.thresholds.max_effects

    def _others(self, chosen: Set) -> list[Candidate]:
        names = {c.effect.name for c in chosen}
        return [c for c in self.regression.candidates if c.effect.name not in names]

    def _fewer(self, chosen: Scored) -> list[Set]:
        return [_without(chosen.candidates, c) for c in chosen.candidates]

    def _more(self, chosen: Scored) -> list[Set]:
        return [(*chosen.candidates, c) for c in self._others(chosen.candidates)]

    def _exchanged(self, chosen: Scored) -> list[Set]:
        """Each effect at another point of its grid, on another rotor, or replaced by another effect."""
        sets = []
        for one in chosen.candidates:
            rest = _without(chosen.candidates, one)
            sets += [(*rest, c) for c in self._others(rest) if c is not one]
        return sets

    def _merged(self, chosen: Scored) -> list[Set]:
        """Two effects replaced by one."""
        sets = []
        for one, other in itertools.combinations(chosen.candidates, 2):
            rest = _without(_without(chosen.candidates, one), other)
            sets += [(*rest, c) for c in self._others(rest) if c is not one and c is not other]
        return sets

    def _pairs(self, chosen: Scored) -> list[Set]:
        """Two effects more, or in place of one."""
        return [pair for rest in (chosen.candidates, *self._fewer(chosen)) for pair in self._two_more(rest)]

    def _pairs_exchanged(self, chosen: Scored) -> list[Set]:
        """Two effects in place of two."""
        pairs = itertools.combinations(chosen.candidates, 2)
        rests = (_without(_without(chosen.candidates, one), other) for one, other in pairs)
        return [pair for rest in rests for pair in self._two_more(rest)]

    def _two_more(self, rest: Set) -> list[Set]:
        """Two effects more, one of them among the best single additions."""
        additions = self.scores([(*rest, c) for c in self._others(rest)])
        best = sorted(additions, key=lambda s: -s.score)[: self.thresholds.max_paired]
        return [(*addition.candidates, c) for addition in best for c in self._others(addition.candidates)]

    def simplified(self, chosen: Scored) -> Scored:
        """The set with effects exchanged for others of fewer coefficients that gain nearly as much in their place.

        What is lost must be less than what an effect must gain: an inertia about z is mostly a torque constant, and
        the rest of it, about x and y, is little beside that and matters.
        """
        for one in chosen.candidates:
            rest = _without(chosen.candidates, one)
            base = self.score(rest).gain
            simpler = [(*rest, c) for c in self._others(rest) if len(c.columns) < len(one.columns)]
            required = base + self.thresholds.parsimony * (chosen.gain - base)
            scored = [s for s in self.scores(simpler) if s.gain >= required]
            enough = [s for s in scored if s.score > max(chosen.score - self.required, IMPOSSIBLE)]
            if enough:
                return self.simplified(max(enough, key=lambda s: s.score))
        return chosen

    def ordered(self, chosen: Scored) -> Scored:
        """Set ordered by how much gain is lost without an effect, most first."""
        if len(chosen.candidates) < 2:
            return chosen
        rest = {c.key: self.score(_without(chosen.candidates, c)).gain for c in chosen.candidates}
        return Scored(tuple(sorted(chosen.candidates, key=lambda c: rest[c.key])), chosen.score, chosen.gain)


def _without(chosen: Set, one: Candidate) -> Set:
    return tuple(c for c in chosen if c is not one)
