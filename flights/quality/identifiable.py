"""Which effects a flight identifies: the channels that each needs, and the motion that excites it.

The thresholds are where the effect of usual size on a quadrotor stands out of its sensors' noise: half a newton per
kilogram of drag at 1 m/s, an angular acceleration of 2 rad/s^2. They are an expectation; whether an effect is separable
is measured by the diagnosis itself.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Literal

import msgspec

from dynamics.effect import Effect
from dynamics.effects import CATALOGUE
from dynamics.excitation import COMMAND, DRIVE, FORCE, MEASURES, WRENCH, Excitation

Identifiability = Literal["yes", "weakly", "no"]

WORDS = {
    FORCE: "an accelerometer or velocity",
    DRIVE: "rotor speeds or commands, fast enough",
    WRENCH: "rotor speeds or commands, fast enough",
    COMMAND: "rotor commands, fast enough",
}
NONE: Mapping[str, str] = {}
# What an unknown gain or lag of motor commands takes up: `Effect.acts_on`.
NEEDS_SPEEDS = ("command_gain", "rotor_speed_reading", "rotor_clock")


class EffectAnswer(msgspec.Struct, frozen=True):
    """Whether an effect can be identified.

    why: the measure or channel that decides.
    ambiguous_with: effects with nearly the same signal in most flights, separated by commas; empty for none.
    """

    name: str
    answer: Identifiability
    why: str
    ambiguous_with: str = ""


def answers(
    have: Collection[str],
    measured: Mapping[str, float],
    catalogue: Mapping[str, Effect] = CATALOGUE,
    *,
    untrusted: Mapping[str, str] = NONE,
) -> tuple[EffectAnswer, ...]:
    """Whether each effect of the catalogue that names its excitation can be identified.

    have: usable quantities.
    measured: by `excitation.measures`.
    untrusted: why quantities that are logged are not usable, by quantity.
    """
    return tuple(
        _answer(effect, effect.excitation, have, measured, untrusted)
        for effect in catalogue.values()
        if effect.excitation is not None
    )


def _answer(
    effect: Effect,
    need: Excitation,
    have: Collection[str],
    measured: Mapping[str, float],
    untrusted: Mapping[str, str],
) -> EffectAnswer:
    def answer(possible: Identifiability, why: str) -> EffectAnswer:
        return EffectAnswer(effect.name, possible, why, ", ".join(effect.confounded_with))

    lacking = [group for group in need.channels if not set(group) & set(have)]
    if lacking:
        return answer("no", "needs " + " and ".join(_named(group, untrusted) for group in lacking))
    if "rotor_speed" not in have and effect.acts_on in NEEDS_SPEEDS:
        return answer("no", "needs measured rotor speeds: what commands do takes it up in every fit")
    if "rotor_speed" not in have and effect.acts_on == "weight":
        return answer("weakly", "without measured rotor speeds only the vehicle's drag tells it from the motors' gain")
    if need.unlogged:
        return answer("weakly", f"the log does not say {need.unlogged}; {need.flight}")
    size = measured.get(need.measure)
    if size is None:
        return answer("no", f"{need.measure} cannot be computed from this log")
    measure = f"{need.measure.replace('_', ' ')} {size:.3g} {MEASURES[need.measure]}".removesuffix(" 1")
    if size >= need.enough:
        return answer("yes", measure)
    return answer("weakly" if size >= need.weak else "no", f"{measure}, wanted {need.enough:g}; fly {need.flight}")


def _named(group: tuple[str, ...], untrusted: Mapping[str, str]) -> str:
    """A group of quantities in words, with why one that is logged does not count."""
    text = WORDS.get(group, " or ".join(name.replace("_", " ") for name in group))
    reason = next((untrusted[name] for name in group if name in untrusted), "")
    return f"{text}, {reason}" if reason else text
