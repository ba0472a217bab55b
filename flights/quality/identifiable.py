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
    have: Collection[str], measured: Mapping[str, float], catalogue: Mapping[str, Effect] = CATALOGUE
) -> tuple[EffectAnswer, ...]:
    """Whether each effect of the catalogue that names its excitation can be identified.

    have: usable quantities.
    measured: by `excitation.measures`.
    """
    return tuple(
        _answer(effect, effect.excitation, have, measured)
        for effect in catalogue.values()
        if effect.excitation is not None
    )


def _answer(effect: Effect, need: Excitation, have: Collection[str], measured: Mapping[str, float]) -> EffectAnswer:
    def answer(possible: Identifiability, why: str) -> EffectAnswer:
        return EffectAnswer(effect.name, possible, why, ", ".join(effect.confounded_with))

    lacking = [group for group in need.channels if not set(group) & set(have)]
    if lacking:
        return answer("no", "needs " + " and ".join(map(_named, lacking)))
    if need.unlogged:
        return answer("weakly", f"the log does not say {need.unlogged}; {need.flight}")
    size = measured.get(need.measure)
    if size is None:
        return answer("no", f"{need.measure} cannot be computed from this log")
    measure = f"{need.measure.replace('_', ' ')} {size:.3g} {MEASURES[need.measure]}".removesuffix(" 1")
    if size >= need.enough:
        return answer("yes", measure)
    return answer("weakly" if size >= need.weak else "no", f"{measure}, wanted {need.enough:g}; fly {need.flight}")


def _named(group: tuple[str, ...]) -> str:
    return WORDS.get(group, " or ".join(name.replace("_", " ") for name in group))
