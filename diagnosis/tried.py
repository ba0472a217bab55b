"""Every effect that flights could show, with its score: what a ranking lists."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from diagnosis.likelihood.evidence import IMPOSSIBLE, Search
from diagnosis.models.command_effects import COMMAND_EFFECTS
from diagnosis.selection.candidates import Candidate
from dynamics.effect import Parameter
from dynamics.vehicle import Vehicle


@dataclass(frozen=True, eq=False)
class Tried:
    """An effect at the point that fits best.

    number: among the likelihood's candidates. columns: its places there.
    score: log of the odds of the named effects with it against those without it; None where the values that fit best
        are physically impossible.
    """

    candidate: Candidate
    score: float | None
    columns: tuple[int, ...]
    number: int


def tried_by_likelihood(search: Search, members: Sequence[int]) -> tuple[Tried, ...]:
    """Each effect beside the others of a set, the best first. members: numbers of the set's candidates."""
    best, inside = dict[str, Tried](), search.score(members).evidence
    of_set = {search.what.all[i].identity for i in members}
    for number in search.able:
        candidate = search.what.all[number]
        if number in members:
            score = inside - search.score([i for i in members if i != number]).evidence
        elif candidate.identity in of_set:
            continue
        else:
            score = search.score([*members, number]).evidence - inside
        name, possible = candidate.effect.name, score != IMPOSSIBLE
        one = Tried(candidate, float(score) if possible else None, tuple(search.columns[number]), number)
        if name not in best or _value(one) > _value(best[name]):
            best[name] = one
    return tuple(sorted(best.values(), key=_value, reverse=True))


def not_excited(search: Search, members: Sequence[int]) -> tuple[str, ...]:
    """Effects that would not be named at their usual size: these flights neither confirm nor exclude them.

    Errors that every log has are none of them. members: numbers of the named set's candidates.
    """
    taken, shown = {search.what.all[i].effect.name for i in members}, dict[str, bool]()
    for number, candidate in enumerate(search.what.all):
        name = candidate.effect.name
        of_logs = candidate.effect.sensor_prior is not None or name in COMMAND_EFFECTS
        if name in taken or shown.get(name) or of_logs or not _is_usual(search, candidate):
            continue
        required = search.problem.thresholds.named - search.log_prior[number]
        shown[name] = number in search.able and _usual_evidence(search, number, members) >= required
    return tuple(name for name, is_shown in shown.items() if not is_shown)


def _is_usual(search: Search, candidate: Candidate) -> bool:
    """Whether a candidate is at the grid point of the effect's usual values, or no grid point is."""
    usual = candidate.effect.defaults(search.problem.vehicle)

    def matches(other: Candidate) -> bool:
        return all(np.isclose(v, usual[n]) for n, v in other.at.items() if n not in other.free)

    family = [c for c in search.what.all if c.effect is candidate.effect and not c.fixed_shape]
    return matches(candidate) or not any(map(matches, family))


def _usual_evidence(search: Search, number: int, members: Sequence[int]) -> float:
    """Expected log-evidence, without the set's prior, of an effect of its usual size beside a set."""
    candidate, own = search.what.all[number], search.columns[number]
    rest = [place for i in members for place in search.columns[i]]
    M, std = search.coarse.M, search.std
    inner = M[np.ix_(rest, rest)] + np.diag(std[rest] ** -2.0)
    beyond = M[np.ix_(own, own)] - M[np.ix_(own, rest)] @ np.linalg.solve(inner, M[np.ix_(rest, own)])
    parameters = {p.name: p for p in candidate.effect.parameters}
    usual = np.array([_usual(parameters[n], search.problem.vehicle) for n in candidate.free] or [1.0])
    score, total = beyond @ usual, beyond + np.diag(std[own] ** -2.0)
    gain = score @ np.linalg.solve(total, score) / 2
    return float(gain - np.linalg.slogdet(total * std[own] * std[own][:, None])[1] / 2)


def _usual(parameter: Parameter, vehicle: Vehicle) -> float:
    """The parameter's usual distance from where its effect vanishes."""
    prior = parameter.prior(vehicle)
    return prior.mean - parameter.neutral or prior.std


def _value(one: Tried) -> float:
    return IMPOSSIBLE if one.score is None else one.score
