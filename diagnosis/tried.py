"""Every effect that flights could show, with its score: what a ranking lists."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from diagnosis.likelihood.evidence import IMPOSSIBLE, Search
from diagnosis.selection.candidates import Candidate
from diagnosis.selection.search import Scored


@dataclass(frozen=True, eq=False)
class Tried:
    """An effect at the point that fits best.

    number: among the likelihood's candidates; None by the regression. columns: places among the columns of its method.
    score: by the likelihood the log of the odds of the named effects with it against those without it; by the
        regression twice the log-likelihood that it gains alone less the criterion's penalty. None where the values that
        fit best are physically impossible.
    """

    candidate: Candidate
    score: float | None
    columns: tuple[int, ...]
    number: int | None = None


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


def tried_alone(singles: Sequence[Scored]) -> tuple[Tried, ...]:
    """Each effect alone, as the regression scores it. singles: the best first."""
    return tuple(Tried(s.candidates[0], _or_none(s.score), tuple(s.columns)) for s in singles)


def _value(one: Tried) -> float:
    return IMPOSSIBLE if one.score is None else one.score


def _or_none(score: float) -> float | None:
    return score if score > IMPOSSIBLE else None
