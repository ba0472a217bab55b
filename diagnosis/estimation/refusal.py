"""Effects that were selected and are not named, each with its reason."""

from __future__ import annotations

from typing import Literal

import msgspec

from diagnosis.models.channels import NAMES

Reason = Literal["too_small", "unsure", "held_out_worse", "open_loop_alike", "another_form"]
HINTS: tuple[Reason, ...] = ("unsure",)


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
        """Whether it may be there, and a further flight could say so."""
        return self.reason in HINTS


def reason_of(refused: Refused) -> str:
    """Why an effect was refused, in words and numbers, after its name and a colon."""
    number = {name: f"{value:.4g}" for name, value in refused.detail.items()}
    where = NAMES.get(refused.where, refused.where)
    match refused.reason:
        case "too_small" if "signal" in number:
            text = (
                f"it is too small to matter: it moves {where} by {number['signal']} RMS, whose noise floor is "
                f"{number['floor']}"
            )
        case "too_small":
            text = f"it is too small to matter: {number['size']} of it, below {number['required']} nothing differs"
        case "unsure":
            text = (
                f"it is {number['odds']} times as likely as not beside the others, and {number['required']} times are "
                "required"
            )
        case "held_out_worse":
            text = (
                f"with it an error of the held-out flights rises: {where} from {number['before']} to {number['after']}"
            )
        case "open_loop_alike":
            text = (
                f"on the held-out flights the open loop is not better with it by more than chance: "
                f"{number['deviations']} standard deviations, {number['required']} are required"
            )
        case "another_form":
            text = (
                "its form is another one's: functions of state, velocity or time that are left beside it have "
                f"{number['share']} of what it makes, and an imperfect form may leave {number['required']}"
            )
    return text
