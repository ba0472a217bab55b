"""A hypothesis about what a log's columns really are, with its evidence and the lines that repair it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import msgspec

from flights.log import Stream
from flights.stream_repair import TIME, StreamRepair, apply, toml_value

Streams = Mapping[str, Stream]  # by quantity
_BETTER = 1 / 3  # share of what is open as declared


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


def is_better(share: float, declared: float) -> bool:
    """Whether a share of a signal that another reading explains is clearly more than the declared one does: of what
    that leaves open, one of many readings explains a little by chance, the more the larger an estimator's error is."""
    return share >= better_than(declared)


def better_than(declared: float) -> float:
    """The share that is clearly more than a declared one."""
    return declared + _BETTER * (1 - declared)


def after(streams: Streams, hypothesis: Hypothesis) -> dict[str, Stream]:
    """The streams as a hypothesis repairs them."""
    repaired = dict(streams)
    for repair in hypothesis.repairs:
        concerned = [name for name in repaired if repair.quantity in (TIME, name)]
        repaired |= {name: apply(repaired[name], repair) for name in concerned}
    return repaired
