"""Discrepancies beside a set of effects: models that no effect is, in the race with the catalogue's.

A force or torque that is a function of the state, the place or the time, or a line in the spectrum, by its marginal
likelihood. It is asked of all of the likelihood, not of a share: what is wrong in the model is what is sought here.
What counts is its size: it must be likelier than one as small as every model leaves.
"""

from __future__ import annotations

import itertools
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from diagnosis.likelihood import priors
from diagnosis.likelihood.evidence import Kind, Search, integrated
from diagnosis.likelihood.features import Discrepancy, Line, smooth
from diagnosis.likelihood.flight_rows import FlightRows
from diagnosis.likelihood.identify import Identified
from diagnosis.likelihood.lines import CHANNELS, strongest_lines
from diagnosis.likelihood.noise_fit import NoiseFit, refit_disturbances
from diagnosis.likelihood.rigid_body import Along
from diagnosis.selection.candidates import Identity
from dynamics.arrays import Floats

FORMS = ("state", "velocity", "time")  # on which what an effect makes may depend


@dataclass(frozen=True, eq=False)
class Left:
    """A discrepancy that is there.

    log_odds: against none, or one as slight as every model leaves. channel: of specific force or angular acceleration,
    body axes, in which it is largest. parts: (N,) there of each part of a flight, and rows: these.
    """

    discrepancy: Discrepancy
    log_odds: float
    channel: int
    rows: tuple[FlightRows, ...]
    parts: tuple[Floats, ...]

    @property
    def rms(self) -> float:
        """Of it in its channel, m/s^2 or rad/s^2."""
        return float(np.sqrt(np.mean(np.concatenate(self.parts) ** 2)))


@dataclass(frozen=True, eq=False)
class LeftOver:
    """Discrepancies beside the best set, the surest first.

    noise: of each kind of logs beside it: where something is left, with all that might be. odds: log of those of each
    member beside it. shares: of smooth functions that are left, over what the members make
    where each of them acts: a form that stands in for another one leaves much of it.
    """

    noise: tuple[NoiseFit, ...]
    left: tuple[Left, ...] = ()
    odds: Mapping[int, float] = field(default_factory=dict)
    shares: Mapping[int, float] = field(default_factory=dict)


def left_over(result: Identified, refuted: Collection[Identity] = ()) -> LeftOver:
    """Discrepancies beside the best set. refuted: effects that are none of it, by name and rotor.

    Turbulence that is fitted without a discrepancy takes it for its own. So it is fitted with all of them free; those
    that are likely then, with turbulence beside them, must be likelier than turbulence alone.
    """
    flights = [(rows, one.along(place)) for one in result.problems for place, rows in enumerate(one.flights)]
    usual, members = _usual([along for _, along in flights]), list(result.best.members)
    required = result.search.problem.thresholds.named
    every = [*_smooth(flights, usual), *_lines(result, usual)]
    first = _race(result, members, every, all_effects=True)
    effects, winners = first.run(members, required, refuted)
    if not winners:
        return LeftOver(result.noise)
    few = [replace(every[n], deviation=every[n].deviation * size) for n, size in winners.items()]
    joint, alone = _race(result, effects, few), _race(result, effects, ())
    together = joint.evidence(effects, range(len(few)))
    if together - alone.evidence(effects, ()) < required:
        return LeftOver(result.noise)
    left = [_shown(joint, effects, number, flights) for number in range(len(few))]
    left.sort(key=lambda one: -one.log_odds)
    odds = {i: together - joint.evidence([n for n in effects if n != i], range(len(few))) for i in members}
    left = [one for one in left if one is left[0] or one.log_odds >= required]
    return LeftOver(first.noise, tuple(left), odds, _shares(result, left, usual))


def _shares(result: Identified, left: Sequence[Left], usual: Sequence[float]) -> dict[int, float]:
    """By member; 0 of those that act on no motion."""
    power = np.zeros(2)  # of force and of turning, that is left
    for one in left:
        if one.discrepancy.of.kind in FORMS:
            power[one.channel // 3] += one.rms**2
    if not power.any() or not result.best.members:
        return dict.fromkeys(result.best.members, 0.0)
    acting = _acting(result)
    together = np.concatenate([np.sum(parts, axis=0) for parts in zip(*acting.values(), strict=True)])
    size = np.sum(np.reshape(np.mean(together**2, axis=0), (2, 3)), axis=1)
    shares = {}
    for number, parts in acting.items():
        own = np.mean(np.concatenate(parts) ** 2, axis=0) / np.square(usual)
        place = int(np.argmax(own)) // 3
        shares[number] = float(np.sqrt(power[place] / size[place])) if own.any() else 0.0
    return shares


def _acting(result: Identified) -> dict[int, list[Floats]]:
    """(N, 6) specific force and angular acceleration that each member makes in each part of a flight."""
    members, values = list(result.best.members), result.search.named_values(result.best)
    made: dict[int, list[Floats]] = {number: [] for number in members}
    for problem in result.problems:
        for place, rows in enumerate(problem.flights):
            own = problem.inputs(place, problem.along(place), members)
            slopes = -np.concatenate([own.B[:, 0:3], own.B[:, 6:9]], axis=1) / rows.period
            for number in members:
                candidate = problem.what.all[number]
                present = candidate.present or {p.name: p.neutral for p in candidate.effect.parameters}
                change = [value - present[name] for name, value in values[number].items()]
                made[number].append(np.asarray(slopes[:, :, own.places(problem.what.places(number))] @ change))
    return made


def _race(
    result: Identified, effects: Sequence[int], discrepancies: Sequence[Discrepancy], *, all_effects: bool = False
) -> _Race:
    """Discrepancies beside some effects, with the turbulence that these leave.

    all_effects: whether others race, too.
    """
    kinds, noises = [], []
    for problem, noise in zip(result.problems, result.noise, strict=True):
        with_them, what = problem.with_discrepancies(discrepancies), problem.what
        free = [*effects, *(what.columns[place].candidate for place in what.of_commands)]
        fitted = refit_disturbances(with_them, noise, free)
        sums = with_them.information(fitted.gain, fitted.slopes, None if all_effects else free)
        kinds.append(Kind(with_them, sums, fitted.slopes))
        noises.append(fitted)
    return _Race(Search(kinds, settled=False, raced=True), discrepancies, tuple(noises))


def _usual(flights: Sequence[Along]) -> list[float]:
    """(6,) deviations of the model's own acceleration, in the world, and angular acceleration, as of one axis."""
    force = np.concatenate([np.einsum("tij,tj->ti", one.rotation, one.force) for one in flights])
    turning = np.concatenate([one.turning for one in flights])
    return [float(np.sqrt(np.mean((x - x.mean(0)) ** 2))) for x in (force, turning) for _ in range(3)]


def _smooth(flights: Sequence[tuple[FlightRows, Along]], usual: Sequence[float]) -> list[Discrepancy]:
    made = []
    for seed, (kind, (fineness, count)) in enumerate(priors.FUNCTIONS.items()):
        functions = smooth(kind, flights, fineness=fineness, count=count, seed=seed)
        if functions is not None:
            tried = CHANNELS * len(priors.FUNCTIONS) * len(priors.SIZES)
            made += [Discrepancy(functions, channel, usual[channel], tried) for channel in range(CHANNELS)]
    return made


def _lines(result: Identified, usual: Sequence[float]) -> list[Discrepancy]:
    made = []
    for problem, noise in zip(result.problems, result.noise, strict=True):
        groups = tuple(dict.fromkeys(rows.group for rows in problem.flights))
        lines = strongest_lines(problem, noise.gain, usual)
        made += [Discrepancy(Line(one.frequency, groups), one.channel, usual[one.channel], one.tried) for one in lines]
    return made


class _Race:
    """Effects and discrepancies by all of the likelihood.

    every: discrepancies, whose columns are the last ones. noise: with all of them free, of each kind of logs.
    """

    def __init__(self, search: Search, every: Sequence[Discrepancy], noise: tuple[NoiseFit, ...]) -> None:
        self._search, self.every, self.noise = search, every, noise
        ends = (search.of_effects + np.cumsum([0, *(len(one) for one in every)])).tolist()
        self._columns = [list(range(begin, end)) for begin, end in itertools.pairwise(ends)]

    def run(
        self, members: Sequence[int], required: float, refuted: Collection[Identity] = ()
    ) -> tuple[list[int], dict[int, float]]:
        """Effects, and sizes of discrepancies by number: each the likeliest beside those before it.

        members: with which it begins. required: log of the odds of a discrepancy. refuted: effects that do not race.
        """
        effects, winners = list(members), dict[int, float]()
        while len(winners) < self._search.problem.thresholds.max_left:
            M, g = self._beyond(effects, winners)
            tried: list[tuple[float, int, float | None]] = [
                (self._effect(i, M, g), i, None) for i in self._others(effects, refuted)
            ]
            by_size = {n: self.odds(n, M, g) for n in range(len(self.every)) if n not in winners}
            tried += [(odds, n, size) for n, (odds, size) in by_size.items() if odds >= required]
            gain, number, size = max(tried, key=lambda one: one[0], default=(-np.inf, 0, None))
            if gain <= self._search.problem.thresholds.min_improvement:
                break
            if size is None:
                effects.append(number)
            else:
                winners[number] = size
        return effects, winners

    def odds(self, number: int, M: Floats, g: Floats, sizes: Sequence[float] = priors.SIZES) -> tuple[float, float]:
        """Log of the odds of a discrepancy of its likeliest size, and that size, over its deviation.

        Against none, or one as slight as every model leaves.
        """
        c, one = self._columns[number], self.every[number]
        slight, *evidence = (_evidence(M, g, c, one.deviations * size)[0] for size in (priors.DISCREPANCY, *sizes))
        best = int(np.argmax(evidence))
        return float(evidence[best] - max(slight, 0.0)) + one.log_prior, sizes[best]

    def evidence(self, effects: Sequence[int], numbers: Sequence[int]) -> float:
        """Log-evidence of some effects and of discrepancies of their own size, but for a constant."""
        search, (c, std) = self._search, self._columns_of(effects, dict.fromkeys(numbers, 1.0))
        prior = sum(float(search.log_prior[i]) for i in effects) + sum(self.every[n].log_prior for n in numbers)
        return float(search.total.base) + _evidence(search.total.M, search.total.g, c, std)[0] + prior

    def alone(self, effects: Sequence[int], number: int) -> tuple[float, Floats]:
        """Log of the odds of one of all discrepancies, of their own size, beside the others; and its values (j,)."""
        M, g = self._beyond(effects, {n: 1.0 for n in range(len(self.every)) if n != number})
        odds, _ = self.odds(number, M, g, (1.0,))
        return odds, _evidence(M, g, self._columns[number], self.every[number].deviations)[1]

    def _others(self, effects: Sequence[int], refuted: Collection[Identity]) -> list[int]:
        every = self._search.what.all
        taken = {*refuted, *(every[i].identity for i in effects)}
        return [i for i in self._search.able if every[i].identity not in taken]

    def _effect(self, number: int, M: Floats, g: Floats) -> float:
        """Log-evidence of an effect; that of an impossible value is none."""
        c = self._search.columns[number]
        evidence, values = _evidence(M, g, c, self._search.std[c])
        possible = self._search.within((number,), values, np.zeros(len(c)))
        return -np.inf if possible is None else evidence + float(self._search.log_prior[number])

    def _beyond(self, effects: Sequence[int], winners: Mapping[int, float]) -> tuple[Floats, Floats]:
        """(k, k) and (k,) beside some effects and discrepancies, marginalised."""
        M, g = self._search.total.M, self._search.total.g
        c, std = self._columns_of(effects, winners)
        if not c:
            return M, g
        inner = M[np.ix_(c, c)] + np.diag(std**-2.0)
        solved = np.linalg.solve(inner, np.concatenate([M[c], g[c, None]], axis=1))
        return M - M[:, c] @ solved[:, :-1], g - M[:, c] @ solved[:, -1]

    def _columns_of(self, effects: Sequence[int], winners: Mapping[int, float]) -> tuple[list[int], Floats]:
        """Columns of some effects and discrepancies, and (c,) deviations of their priors."""
        search = self._search
        c = [i for number in effects for i in search.columns[number]]
        std = [search.std[c], *(self.every[n].deviations * size for n, size in winners.items())]
        return c + [i for n in winners for i in self._columns[n]], np.concatenate(std)


def _evidence(M: Floats, g: Floats, columns: Sequence[int], std: Floats) -> tuple[float, Floats]:
    """Log-evidence of some columns with their priors' deviations (c,), and their values (c,)."""
    c = list(columns)
    quadratic, log_determinant, values = integrated(M[np.ix_(c, c)], g[c], std)
    return (quadratic - log_determinant) / 2, values


def _shown(race: _Race, effects: Sequence[int], number: int, flights: Sequence[tuple[FlightRows, Along]]) -> Left:
    """A discrepancy beside all others, with its course."""
    one, (log_odds, values) = race.every[number], race.alone(effects, number)
    mine = [flight for flight in flights if not isinstance(one.of, Line) or flight[0].group in one.of.groups]
    courses = [np.zeros((len(rows), 6)) for rows, _ in mine]
    for course, flight in zip(courses, mine, strict=True):
        one.act(course[:, :, None], (one.of.along(*flight) @ values)[:, None], flight[1])
    channel = int(np.argmax(np.sum([np.sum(course**2, axis=0) for course in courses], axis=0)))
    rows = tuple(rows for rows, _ in mine)
    return Left(one, log_odds, channel, rows, tuple(course[:, channel] for course in courses))
