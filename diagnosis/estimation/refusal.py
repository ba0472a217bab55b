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
    "open_loop_alike",
    "redundant",
    "at_bound",
    "worse_than_rival",
    "contradicted",
    "not_converged",
    "drifts",
    "overshadowed",
    "predictable",
    "late_signal",
    "slight",
]
TOO_SMALL: tuple[Reason, ...] = ("too_small", "redundant")  # what is held out hardly shows it
HINTS = ("interval_holds_neutral", "few_resamples", "drifts", "overshadowed", "late_signal", "slight")


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
        """Whether it may be there: these flights are too few to say, or it changes next to nothing."""
        return self.reason in HINTS

    @property
    def is_open(self) -> bool:
        """Whether a further flight could say whether it is there, and it would matter."""
        return self.is_hint and self.reason != "slight"


def reason_of(refused: Refused) -> str:
    """Why an effect was refused, in words and numbers, after its name and a colon."""
    number = {name: f"{value:.4g}" for name, value in refused.detail.items()}
    match refused.reason:
        case "too_small" if "signal" in number:
            text = (
                f"it is too small to matter: it moves {refused.where} by {number['signal']} RMS, whose noise floor is "
                f"{number['floor']}"
            )
        case "too_small":
            text = (
                f"it is too small to matter: on the held-out flights the error of {refused.where} falls most, from "
                f"{number['before']} to {number['after']}, its noise floor is {number['floor']}"
            )
        case "slight":
            text = (
                f"it changes the motion that the model explains by {number['share']} of it at most, in "
                f"{refused.where}; below {number['required']} nothing that flies differs"
            )
        case "redundant":
            text = "the vehicle file's own effects, fitted again, explain as much"
        case "interval_holds_neutral":
            text = (
                f"its interval includes the neutral value: the fit is {number['deviations']} standard deviations "
                f"from it, {number['required']} are required"
            )
        case "channel_worse" | "contradicted":
            text = (
                f"on the held-out flights the error of {refused.where} rises from {number['before']} to "
                f"{number['after']}, beyond chance"
            )
        case "open_loop_worse":
            text = (
                f"on the held-out flights the {refused.where} predicted in open loop becomes worse, {number['before']} "
                f"before and {number['after']} after, of a motion of {number['motion']}"
            )
        case "open_loop_alike":
            text = (
                f"on the held-out flights the open loop is not better with it by more than chance: "
                f"{number['deviations']} standard deviations, {number['required']} are required"
            )
        case "at_bound":
            text = f"the value of {refused.where} that fits these flights best lies at its physical bound"
        case "not_converged":
            text = "its fit does not converge on these flights"
        case "few_resamples":
            text = f"only {number['share']} of the flight resamples agree"
        case "drifts":
            text = (
                "its value is not constant: between strong and weak, or early and late in a flight, the fits "
                f"differ by {number['share']} of it, {number['deviations']} standard deviations, while something else "
                "is missing"
            )
        case "overshadowed":
            text = (
                f"it explains {number['share']} of the squared error of {refused.where} that is still unexplained; "
                "any regressor would explain that little"
            )
        case "predictable" if refused.where == "line":
            text = f"air in motion has no line in its spectrum, but one has {number['share']} of the power of this one"
        case "predictable":
            text = (
                f"air in motion is no function of the {refused.where}, but that predicts {number['share']} of what it "
                f"explains, on flights left out"
            )
        case "late_signal":
            text = (
                f"a log whose {refused.where} is {delay_in_words(refused.detail['delay'])} explains as much, and the "
                "effect next to nothing beside that"
            )
        case "worse_than_rival":
            text = "another effect fits better in its place"
    return text


def delay_in_words(delay: float) -> str:
    """A delay, s, as "3.1 ms late" or "3.1 ms early"."""
    return f"{1e3 * abs(delay):.2g} ms {'late' if delay > 0 else 'early'}"
