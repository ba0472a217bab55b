"""Effects that would explain nearly as much as a chosen one in its place."""

from __future__ import annotations

from collections.abc import Sequence

from diagnosis.selection.candidates import Candidate
from diagnosis.selection.search import IMPOSSIBLE, Scored, Search, least_gain

CLOSE_SCORE, CLOSE_SHARE = 12.0, 0.01  # of the score, within which effects cannot be told apart
CLOSE_BY_COMMAND = 0.15  # of what an effect brings, where the rotors' speeds are only what commands would give


def rivals_of(search: Search, others: Sequence[Candidate], chosen: Candidate) -> list[Scored]:
    """The chosen effect first, then each other effect's best variant in its place, best first."""
    best: dict[str, Scored] = {}
    taken = {c.effect.name for c in others}
    for candidate in search.regression.candidates:
        name = candidate.effect.name
        if name in taken or name == chosen.effect.name:
            continue
        scored = search.score([*others, candidate])
        if scored.score > IMPOSSIBLE and (name not in best or scored.score > best[name].score):
            best[name] = scored
    return [search.score([*others, chosen]), *sorted(best.values(), key=lambda s: -s.score)[:7]]


def near_rivals(search: Search, others: Sequence[Candidate], rivals: Sequence[Scored]) -> list[Scored]:
    """Those of the rivals that the flights cannot tell from the first, by the linear regression."""
    own = rivals[0]
    margin = max(CLOSE_SCORE, CLOSE_SHARE * own.gain)
    if search.regression.segments[0].rotor_source == "command":
        margin = max(margin, CLOSE_BY_COMMAND * (own.score - search.score(others).score))
    return [s for s in rivals[1:] if s.score > least_gain(s.candidates) and s.score > own.score - margin]
