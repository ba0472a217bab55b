"""A hypothesis about what a log's columns really are, with its evidence and the lines that repair it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import msgspec
import numpy as np

from flights.log import Stream
from flights.stream_repair import TIME, StreamRepair, apply, toml_value

Streams = Mapping[str, Stream]  # by quantity
CLEARER = 0.5  # in Fisher's z, by which another reading exceeds the declared one: errors of an estimator favour some
_ALMOST = 1 - 1e-9


@dataclass(frozen=True)
class Hypothesis:
    """An explanation of a log's columns, other than the declared one, by how well physics closes.

    name: for programs.
    text: what they are.
    evidence: what closes by it, and how far.
    repairs: what makes the columns those of a flight; empty where none does.
    """

    name: str
    text: str
    evidence: str
    repairs: tuple[StreamRepair, ...]

    @property
    def lines(self) -> str:
        """The repairs as one line of a mapping file."""
        tables = (msgspec.to_builtins(repair) for repair in self.repairs)
        inline = ", ".join("{" + ", ".join(f"{k} = {toml_value(v)}" for k, v in t.items()) + "}" for t in tables)
        return f"repairs = [{inline}]"

    @property
    def advice(self) -> str:
        """Advice about it, for people."""
        if not self.repairs:
            return "convert it, or give a column mapping"
        return f"repair: {self.lines} on top of a mapping file, which `alula inspect LOG --repair FILE` writes"

    def __str__(self) -> str:
        """Statement, evidence and advice, for people."""
        return in_words([self])


def in_words(hypotheses: Sequence[Hypothesis]) -> str:
    """All that a log's columns are, and one line that repairs it, for people."""
    texts = [f"{one.text} ({one.evidence})" if one.evidence else one.text for one in hypotheses]
    repairs = tuple(repair for one in hypotheses for repair in one.repairs)
    if not repairs:
        return " ".join(texts)
    return f"{'; '.join(texts)}. Wanted SI units, ENU and FLU, by one clock; {Hypothesis('', '', '', repairs).advice}."


def rise(follows: float, without: float) -> float:
    """Rise of a correlation in Fisher's z, which chance moves alike whatever the correlation is (Fisher, 1921)."""
    return float(np.arctanh(min(follows, _ALMOST)) - np.arctanh(np.clip(without, -_ALMOST, _ALMOST)))


def is_better(share: float, declared: float) -> bool:
    """Whether a share of a signal that another reading explains is clearly more than the declared one does."""
    return share >= better_than(declared)


def better_than(declared: float) -> float:
    """The share that is clearly more than a declared one: shares are squared correlations."""
    correlation = np.sqrt(np.clip(declared, 0.0, _ALMOST))
    return float(np.tanh(np.arctanh(correlation) + CLEARER) ** 2)


def after(streams: Streams, hypothesis: Hypothesis) -> dict[str, Stream]:
    """The streams as a hypothesis repairs them."""
    repaired = dict(streams)
    for repair in hypothesis.repairs:
        concerned = [name for name in repaired if repair.quantity in (TIME, name)]
        repaired |= {name: apply(repaired[name], repair) for name in concerned}
    return repaired
