"""The score of a set of effects: its marginal likelihood (MacKay, Bayesian interpolation, Neural Computation 4, 1992).

log p(set | data) = log p(none | data) + g' (M + P)^-1 g / 2 - log det(1 + M / P) / 2 + log p(set), with the
information M and score g of its columns and the precision P of the catalogue's priors; nuisances are marginalised.

Every model is wrong by a little, which any number of seconds makes certain. The likelihood in a set's evidence is
therefore that of `trusted` seconds: a coarsened posterior, which holds for data that are near to the model's, and not
its own (Miller and Dunson, Robust Bayesian inference via coarsening, Journal of the American Statistical Association,
2019). Priors are not coarsened, those of nuisances neither. Values are those of all of the likelihood.
"""

from __future__ import annotations

import itertools
from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np

from diagnosis.likelihood.columns import Candidates
from diagnosis.likelihood.gain import NoiseSlopes
from diagnosis.likelihood.problem import Information, Problem
from diagnosis.models.command_effects import prior_deviation
from diagnosis.selection.candidates import Candidate
from diagnosis.thresholds import DEFAULT
from dynamics.arrays import Floats
from dynamics.vehicle import Vehicle

IMPOSSIBLE = -np.inf


@dataclass(frozen=True, eq=False)
class Sums:
    """Information of all candidates' columns with the nuisances marginalised, counted from the vehicle file.

    M: (k, k), g: (k,). blocks: (b, k, k) and (b, k) of each block of time. now: (k,) values about which it is linear.
    Where discrepancies race, their columns are the last ones. base: log-evidence of the vehicle file, but for a
    constant.
    """

    M: Floats
    g: Floats
    M_blocks: Floats
    g_blocks: Floats
    now: Floats
    shared: tuple[Floats, Floats, Floats]
    base: float

    def of_commands(self, places: Sequence[int], values: Floats, count: int) -> Floats:
        """(count,) changes of what lies between command and thrust beside a set's values."""
        inverse, across, score = self.shared
        change = -self.now.copy()
        change[list(places)] += values
        return np.asarray((inverse @ (score - across @ change))[:count])

    def information(self, places: Sequence[int], count: int) -> Floats:
        """(c + count, c + count) of a set's columns and of what lies between command and thrust, beside them."""
        inverse, across, _ = self.shared
        rest, own = list(places), slice(0, count)
        slope = inverse @ across[:, rest]
        inner = np.linalg.inv(inverse[own, own]) if count else np.zeros((0, 0))
        mixed = inner @ slope[own]
        return np.block([[self.M[np.ix_(rest, rest)] + slope[own].T @ mixed, mixed.T], [mixed, inner]])


@dataclass(frozen=True, eq=False)
class Kind:
    """Flights of one kind of logs with their sums. noise: of these logs; its hyperparameters are the last columns."""

    problem: Problem
    information: Sequence[Information]
    noise: NoiseSlopes


def sums(kinds: Sequence[Kind], *, settled: bool, share: float = 1.0, raced: bool = False) -> Sums:
    """Marginalise discrepancies of each block, then hidden states' starts of each part of a flight, sensors of each
    flight, and what all flights of a kind share, with the noise's hyperparameters among it: under feedback they are not
    independent of the vehicle's parameters; at last what lies between command and thrust.

    settled: whether the model is near its best, so that a step of the noise's values is one that its slopes allow.
    share: power of the likelihood. raced: whether discrepancies are candidates, too: they are nuisances otherwise, and
    a part of a flight is one block then.
    """
    problem = kinds[0].problem
    present_values, own = present(problem), problem.what.of_commands
    parts = [_of_kind(kind, settled=settled, share=share, raced=raced) for kind in kinds]
    M, g = np.concatenate([M for M, _, _ in parts]), np.concatenate([g for _, g, _ in parts])
    effects = [problem.what.all[problem.what.columns[place].candidate].effect for place in own]
    precision = np.array([1 / prior_deviation(effect, DEFAULT.command_curve) ** 2 for effect in effects])
    rest = [i for i in range(M.shape[1]) if i not in own]
    M_blocks, g_blocks, shared, gained = _shared(M, g, own, rest, precision, -precision * present_values[own])
    now = np.concatenate([present_values, np.zeros(M.shape[1] - len(present_values))])[rest]
    M = M_blocks.sum(0)
    M = (M + M.T) / 2
    score = g_blocks.sum(0)
    base = sum(base for _, _, base in parts) + gained - score @ now - now @ M @ now / 2
    return Sums(M, score + M @ now, M_blocks, g_blocks + M_blocks @ now, now, shared, float(base))


def _of_kind(kind: Kind, *, settled: bool, share: float, raced: bool) -> tuple[Floats, Floats, float]:
    """(b, k, k) and (b, k) of the blocks of one kind of logs, of the columns of candidates and of what races; and the
    log-evidence where all of these are as they are."""
    what, noise = kind.problem.what, kind.noise
    K = len(what.columns)
    lasting = ("block", "part", "flight", "always")
    places = {name: [K + i for i, one in enumerate(what.nuisances) if one.lasts == name] for name in lasting}
    others = what.of_discrepancies
    deviations = [n.std for n in what.nuisances] + [each for one in what.discrepancies for each in one.deviations]
    precision = np.concatenate([np.zeros(K), np.array(deviations) ** -2.0, noise.precision])
    pull = np.concatenate([np.zeros(what.width), -noise.precision * noise.away])
    base = share * sum(part.log_likelihood for part in kind.information) - noise.precision @ noise.away**2 / 2
    if settled:
        places["always"] += range(what.width, len(precision))
    places["always"] += [] if raced else others
    columns = [*range(K), *(others if raced else ()), *places["part"], *places["flight"], *places["always"]]
    M_all, g_all, groups, ids_of_parts = [], [], [], []
    for place, part in enumerate(kind.information):
        M, g, gained = _marginal(share * part.M, share * part.g, places["block"], columns, precision)
        base += gained
        if raced:
            M, g = M.sum(0, keepdims=True), g.sum(0, keepdims=True)
        M_all.append(M)
        g_all.append(g)
        groups += [part.group] * len(M)
        ids_of_parts += [place] * len(M)
    M, g, group = np.concatenate(M_all), np.concatenate(g_all), np.array(groups)
    for lasts, ids in (("part", np.array(ids_of_parts)), ("flight", group), ("always", np.zeros(len(group), int))):
        if lasts == "part" and not places[lasts]:
            continue
        at = {c: i for i, c in enumerate(columns)}
        out, staying = places[lasts], [c for c in columns if c not in places[lasts]]
        own, rest = [at[c] for c in out], [at[c] for c in staying]
        M_next, g_next = np.empty((len(group), len(rest), len(rest))), np.empty((len(group), len(rest)))
        for one in np.unique(ids):
            here = ids == one
            prior = pull[out]
            if lasts == "part":
                begun = kind.problem.starts.get(int(one), {})
                prior = -precision[out] * [begun.get(what.nuisances[c - K].of, 0.0) for c in out]
            M_next[here], g_next[here], _, gained = _shared(M[here], g[here], own, rest, precision[out], prior)
            base += gained
        M, g, columns = M_next, g_next, staying
    return M, g, float(base)


def _shared(
    M: Floats, g: Floats, own: Sequence[int], rest: Sequence[int], precision: Floats, pull: Floats
) -> tuple[Floats, Floats, tuple[Floats, Floats, Floats], float]:
    """(b, r, r) and (b, r) of blocks without columns that are one in all of them; the inverse of these columns'
    information, that across to the rest, and their score; and the log-evidence that they gain.

    pull: (c,) slope of their log-prior at the present values.
    """
    total, score = M.sum(0), g.sum(0)
    inverse = np.linalg.inv(total[np.ix_(own, own)] + np.diag(precision)) if len(own) else np.zeros((0, 0))
    # each block's share: of a quadratic form that is linear in the block once the nuisances' fit is fixed
    T = np.zeros((len(rest), M.shape[1]))
    T[np.arange(len(rest)), rest] = 1.0
    T[:, own] = -(inverse @ total[np.ix_(own, rest)]).T
    offset = -total[np.ix_(rest, own)] @ inverse @ pull
    M_rest, g_rest = np.einsum("ij,bjk->bik", T, M)[:, :, rest], g @ T.T + offset / len(M)
    pulled = score[own] + pull
    gained = (pulled @ inverse @ pulled + np.linalg.slogdet(inverse * precision)[1]) / 2
    return M_rest, g_rest, (inverse, total[np.ix_(own, rest)], pulled), float(gained)


def _marginal(
    M: Floats, g: Floats, out: Sequence[int], rest: Sequence[int], precision: Floats
) -> tuple[Floats, Floats, float]:
    """(b, r, r) and (b, r) with some columns marginalised in each block, and the log-evidence that these gain."""
    if not out:
        return M, g, 0.0
    inner = M[:, out][:, :, out] + np.diag(precision[out])
    across = M[:, out][:, :, rest]
    solved = np.linalg.solve(inner, np.concatenate([across, g[:, out][:, :, None]], axis=2))
    M_rest = M[:, rest][:, :, rest] - across.transpose(0, 2, 1) @ solved[:, :, :-1]
    g_rest = g[:, rest] - np.einsum("bij,bi->bj", across, solved[:, :, -1])
    gained = np.sum(g[:, out] * solved[:, :, -1]) - np.sum(np.linalg.slogdet(inner / precision[out])[1])
    return M_rest, g_rest, float(gained / 2)


def integrated(M: Floats, g: Floats, std: Floats, at: Floats | float = 0.0) -> tuple[float, float, Floats]:
    """Columns (k,) with information M and score g that are integrated out: by how much they lower the sum of squares,
    the log of the determinant by which that widens, and their most probable change (k,).

    std: (k,) of their priors about zero. at: their present values.
    """
    cholesky = np.linalg.cholesky(M * std * std[:, None] + np.eye(len(std)))
    half = np.linalg.solve(cholesky, g * std - at / std)
    quadratic = half @ half - np.sum((at / std) ** 2)
    change = np.asarray(np.linalg.solve(cholesky.T, half) * std)
    return float(quadratic), float(2 * np.log(np.diag(cholesky)).sum()), change


def present(problem: Problem) -> Floats:
    """(k,) coefficients of the columns in the model about which all is linear, counted from each candidate's own."""
    now = np.zeros(len(problem.what.columns))
    for number, values in problem.fitted.items():
        candidate = problem.what.all[number]
        for place, name in zip(problem.what.places(number), candidate.free or ("",), strict=True):
            if name:
                now[place] = values.get(name, candidate.at[name]) - candidate.at[name]
            else:  # a fixed shape that is fitted counts from where it vanishes, in its own parameter
                now[place] = values[candidate.effect.time_constants[0]]
    return now


def prior_stds(what: Candidates, vehicle: Vehicle, fitted: Sequence[int]) -> Floats:
    """(k,) of the columns about the vehicle file's values."""
    made = []
    for column in what.columns:
        candidate = what.all[column.candidate]
        effect = candidate.effect
        if not column.name:
            parameter = next(p for p in effect.parameters if p.name == effect.time_constants[0])
            prior = parameter.prior(vehicle)
            size = np.hypot(prior.std, prior.mean - parameter.neutral)
            made.append(size if column.candidate in fitted else 1.0)
            continue
        parameter = next(p for p in effect.parameters if p.name == column.name)
        prior = parameter.prior(vehicle)
        usual = prior.mean if candidate.present is None else candidate.at[column.name]
        made.append(float(np.hypot(prior.std, usual - parameter.neutral)))
    return np.array(made)


@dataclass(frozen=True, eq=False)
class Scored:
    """A set of candidates. evidence: log of its odds against the vehicle file. fit: of this what the log-likelihood
    gains. values: (c,) of its columns. covariance: (c, c)."""

    members: tuple[int, ...]
    evidence: float
    fit: float
    values: Floats
    covariance: Floats


def looks_like(one: Candidate, other: Candidate) -> bool:
    """Whether the catalogue says that two effects look alike, on one rotor where both are of one."""
    names = one.effect.name in other.effect.confounded_with or other.effect.name in one.effect.confounded_with
    return names and (one.rotor == other.rotor or None in (one.rotor, other.rotor))


class Search:
    """Sets of candidates by their evidence.

    kinds: flights of one kind of logs each. problem: of the first; candidates and their values are those of all.
    total, coarse: sums of the likelihood, and of its share that counts as evidence: of all of it where discrepancies
    are candidates, too. one_of: candidates of which one at most is there, beside corrections of the vehicle file's own
    effects; by default all may be.
    """

    def __init__(
        self, kinds: Sequence[Kind], *, settled: bool, one_of: Collection[int] | None = None, raced: bool = False
    ) -> None:
        problem = kinds[0].problem
        self._one_of = one_of
        own = {(use.name, use.rotor) for use in problem.vehicle.effects}
        seconds = sum(len(rows) * rows.period for kind in kinds for rows in kind.problem.flights)
        share = 1 / (1 + seconds / problem.thresholds.trusted)
        self.problem, self.what = problem, problem.what
        self.total = sums(kinds, settled=settled, raced=raced)
        self.coarse = self.total if raced else sums(kinds, settled=settled, share=share)
        self.std = prior_stds(self.what, problem.vehicle, list(problem.fitted))
        self.columns = [self.what.places(i) for i in range(len(self.what.all))]
        names = [c.effect.name for c in self.what.all]  # those of commands are none of the search's
        effects = len(set(names))
        self.log_prior = [-np.log(effects) - np.log(names.count(name)) for name in names]
        size = np.diag(self.total.M)
        self.of_effects = len(self.what.columns) - len(self.what.of_commands)
        lags = [i for i in problem.fitted if self.what.all[i].effect.rotor_speed is not None]
        self.able = [
            i
            for i, places in enumerate(self.columns)
            if (one_of is None or i in one_of or self.what.all[i].identity in own)
            and places[-1] < self.of_effects
            and np.all(size[places] > 0)
            and np.all(np.isfinite(size[places]))
            and not (lags and self.what.all[i].effect.rotor_speed is not None and i not in lags)
        ]
        self._scored: dict[tuple[int, ...], Scored] = {}

    def score(self, members: Sequence[int]) -> Scored:
        """A set's score; impossible where two of its members are one effect, or a value is far out of its bounds."""
        key = tuple(sorted(members))
        if key not in self._scored:
            self._scored[key] = self._score(key)
        return self._scored[key]

    def _score(self, members: tuple[int, ...]) -> Scored:
        if not members:
            return Scored((), 0.0, 0.0, np.zeros(0), np.zeros((0, 0)))
        c = [place for i in members for place in self.columns[i]]
        nothing = Scored(members, IMPOSSIBLE, IMPOSSIBLE, np.zeros(len(c)), np.zeros((len(c), len(c))))
        if len({self.what.all[i].identity for i in members}) < len(members):
            return nothing
        if self._one_of is not None and sum(i in self._one_of for i in members) > 1:
            return nothing
        std = self.std[c]
        M, coarse = (s.M[np.ix_(c, c)] * std * std[:, None] + np.eye(len(c)) for s in (self.total, self.coarse))
        try:
            covariance = np.linalg.inv(M)
            quadratic, log_determinant, _ = integrated(self.coarse.M[np.ix_(c, c)], self.coarse.g[c], std)
        except np.linalg.LinAlgError:
            return nothing
        values = covariance @ (self.total.g[c] * std) * std
        evidence = (quadratic - log_determinant) / 2 + sum(self.log_prior[i] for i in members)
        slack = np.sqrt(np.diag(np.linalg.inv(coarse))) * std * self.problem.thresholds.bound_slack
        possible = self.within(members, values, slack)
        if possible is None:
            return nothing
        return Scored(members, float(evidence), quadratic / 2, possible, covariance * std * std[:, None])

    def within(self, members: tuple[int, ...], values: Floats, slack: Floats) -> Floats | None:
        """Values (c,) within the parameters' bounds; None where one exceeds them, or a fixed shape is none.

        The vehicle file may name an effect that does not exist: one of its own, which noise carries over a bound by no
        more than its slack (c,), stays there.
        """
        within, first = values.copy(), 0
        for i in members:
            candidate = self.what.all[i]
            if not candidate.free:
                lag = next(p for p in candidate.effect.parameters if p.name == candidate.effect.time_constants[0])
                size = self.problem.thresholds.amplitude
                lowest, highest = (lag.lower, lag.upper) if i in self.problem.fitted else size
                if not lowest < values[first] < highest:
                    return None
                first += 1
                continue
            for name in candidate.free:
                parameter = next(p for p in candidate.effect.parameters if p.name == name)
                within[first] = np.clip(
                    values[first], parameter.lower - candidate.at[name], parameter.upper - candidate.at[name]
                )
                if abs(within[first] - values[first]) > 1e-12 + (0.0 if candidate.present is None else slack[first]):
                    return None
                first += 1
        return within

    def places(self, scored: Scored) -> list[int]:
        """Columns of a set's members, in their order."""
        return [place for i in scored.members for place in self.columns[i]]

    def best(self, begin: Sequence[int] = ()) -> Scored:
        """Climb from a set by one more, one less, one for another, and one for two."""
        required = self.problem.thresholds.min_improvement
        here = self.score([i for i in begin if i in self.able])
        if here.evidence == IMPOSSIBLE:
            here = self.score(())
        while True:
            near = max(self._near(here), key=lambda s: s.evidence, default=here)
            if near.evidence <= here.evidence + required:
                near = max(self._merged(here), key=lambda s: s.evidence, default=here)
                if near.evidence <= here.evidence + required:
                    return here
            here = near

    def rivals(self, scored: Scored, member: int, within: float) -> list[int]:
        """Candidates that, for a member, make a set whose log-evidence is less by no more than `within`.

        Of effects that look alike by the catalogue those that fit as well: the one with more parameters holds the other
        as a special case, and what is odd about that is their priors' widths alone. A candidate is linear about its
        neutral value, and errs by the square of its size.
        """
        rest = [i for i in scored.members if i != member]
        taken, one = {self.what.all[i].identity for i in scored.members}, self.what.all[member]
        others = [i for i in self.able if self.what.all[i].identity not in taken]
        sets = {i: self.score([*rest, i]) for i in others}
        gained = scored.fit - max(self.score(rest).fit, 0.0)  # what is impossible gains nothing
        lost = within + self.problem.thresholds.linear * gained
        return [
            i
            for i, each in sets.items()
            if each.evidence >= scored.evidence - within
            or (looks_like(one, self.what.all[i]) and each.fit >= scored.fit - lost)
        ]

    def _near(self, here: Scored) -> list[Scored]:
        members = here.members
        sets = [members[:j] + members[j + 1 :] for j in range(len(members))]
        rest = [i for i in self.able if i not in members]
        if len(members) < self.problem.thresholds.max_effects:
            sets += [(*members, i) for i in rest]
        sets += [(*members[:j], i, *members[j + 1 :]) for j in range(len(members)) for i in rest]
        return [self.score(one) for one in sets]

    def _merged(self, here: Scored) -> list[Scored]:
        members, rest = here.members, [i for i in self.able if i not in here.members]
        return [
            self.score([*(k for k in members if k not in pair), i])
            for pair in itertools.combinations(members, 2)
            for i in rest
        ]

    def named_values(self, scored: Scored) -> dict[int, dict[str, float]]:
        """Values of each member's parameters."""
        made, first = {}, 0
        for i in scored.members:
            candidate = self.what.all[i]
            if candidate.free:
                own = {name: candidate.at[name] + scored.values[first + k] for k, name in enumerate(candidate.free)}
                first += len(candidate.free)
            else:
                name, size = candidate.effect.time_constants[0], scored.values[first]
                own = {name: size if i in self.problem.fitted else candidate.at[name] * size}
                first += 1
            made[i] = {name: float(value) for name, value in own.items()}
        return made
