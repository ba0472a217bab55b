"""Effects that were selected and are not named, each with its reason."""

from __future__ import annotations

from typing import Literal

import msgspec

Reason = Literal[
    "too_small",
    "interval_holds_neutral",
    "few_resamples",
    "channel_worse",
    "open_loop_worse",
    "redundant",
    "at_bound",
    "worse_than_rival",
    "contradicted",
    "not_converged",
]
HINTS = ("interval_holds_neutral", "few_resamples")


class Refused(msgspec.Struct, frozen=True):
    """An effect that was selected and is not named.

    name, rotor: of the catalogue, and the rotor that it acts on, if any.
    reason: the test that it failed first.
    detail: the numbers behind the reason, by name.
    where: kind of channel, or quantity of the open loop, that they are of; empty for none.
    parameters: fitted values.
    """

    name: str
    rotor: int | None
    reason: Reason
    detail: dict[str, float] = {}
    where: str = ""
    parameters: dict[str, float] = {}

    @property
    def is_hint(self) -> bool:
        """Whether it may be there: these flights are too few to say."""
        return self.reason in HINTS
