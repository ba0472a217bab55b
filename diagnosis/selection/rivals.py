"""Effects that would explain nearly as much as a chosen one in its place."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from diagnosis.selection.candidates import Candidate
from diagnosis.selection.search import IMPOSSIBLE, Scored, Search, min_score

SEED = 0  # of the resamples, so that the same flights have the same answer


def rivals_of(search: Search, others: Sequence[Candidate], chosen: Candidate) -> list[Scored]:
    """The chosen effect first, then each other effect in its place at its best grid point, best first.

    Of the others the best ones, and of what is akin to the chosen one all.
    """
    best: dict[str, Scored] = {}
    max_rivals = search.regression.thresholds.rivals.max_rivals
    taken = {chosen.effect.name, *(c.effect.name for c in others)}
    free = [c for c in search.regression.candidates if c.effect.name not in taken]
    for scored in search.scores([(*others, c) for c in free]):
        name = scored.candidates[-1].effect.name
        if scored.score > IMPOSSIBLE and (name not in best or scored.score > best[name].score):
            best[name] = scored
    ranked = sorted(best.values(), key=lambda s: -s.score)
    rivals = [s for i, s in enumerate(ranked) if i < max_rivals or akin(s.candidates[-1], chosen)]
    return [search.score([*others, chosen]), *rivals]


def alone(search: Search, others: Sequence[Candidate]) -> Scored:
    """Effects without any other, but for those whose coefficients are impossible then."""
    return max(search.possible_scores([tuple(others)]), key=lambda scored: scored.score)


def near_rivals(search: Search, others: Sequence[Candidate], rivals: Sequence[Scored]) -> list[Scored]:
    """Rivals that the columns, which err by a share of the whole gain, do not tell from the first."""
    own, thresholds = rivals[0], search.regression.thresholds.rivals
    margin = max(thresholds.score_margin, thresholds.gain_share * own.gain)
    if search.regression.segments[0].rotor_source == "command":
        margin = max(margin, thresholds.added_share * (own.score - alone(search, others).score))
    return [
        s for s in rivals[1:] if s.score > min_score(s.candidates, search.thresholds) and s.score > own.score - margin
    ]


def to_fit(near: Sequence[Scored], chosen: Candidate, count: int) -> list[Scored]:
    """Of the near rivals those that the full model should decide about: the nearest ones, and the nearest akin.

    The columns of what acts on much else, a drag at the rotors beside a centre of mass that is off, err by more than
    what tells it from its kin; anything may be nearer then.
    """
    return [*near[:count], *[s for s in near[count:] if akin(s.candidates[-1], chosen)][:count]]


def akin(one: Candidate, other: Candidate) -> bool:
    """Whether the catalogue declares that two effects look alike, or both are drags."""
    return declared_alike(one, other) or (one.effect.resists_air and other.effect.resists_air)


def declared_alike(one: Candidate, other: Candidate) -> bool:
    """Whether the catalogue declares that two effects look alike."""
    return one.effect.name in other.effect.confounded_with or other.effect.name in one.effect.confounded_with


def look_alikes(search: Search, others: Sequence[Candidate], rivals: Sequence[Scored]) -> list[Scored]:
    """Near rivals that leave little of what the first one adds to the others.

    Beside much else the columns' error alone would make every rival of a small effect one.
    """
    own, thresholds = rivals[0], search.regression.thresholds.rivals
    margin = max(thresholds.score_margin, thresholds.added_share * (own.score - alone(search, others).score))
    return [s for s in near_rivals(search, others, rivals) if s.score > own.score - margin]


def resample_share(
    search: Search, others: Sequence[Candidate], rivals: Sequence[Scored], near: Sequence[Scored]
) -> float:
    """Share of flight resamples in which the first of the rivals or a near one wins.

    To win is to score higher than each rival in its place, and than the others without any.
    """
    regression, random = search.regression, np.random.default_rng(SEED)
    alike, without = [rivals[0], *near], search.score(others)
    entries = [*alike, *(s for s in rivals if all(s is not one for one in alike)), without]
    count = len(regression.flights)
    drawn = [random.choice(count, count) for _ in range(regression.thresholds.verdict.resamples)]
    weights = np.array([np.bincount(flights, minlength=count) for flights in drawn], dtype=float)
    scores = [regression.gains(s.columns, weights) - sum(search.penalty(c) for c in s.candidates) for s in entries]
    return float(np.mean(np.argmax(scores, axis=0) < len(alike)))
