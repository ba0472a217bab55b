"""What can be identified from a flight, effect by effect: the channels each needs, and the motion that shows it.

The thresholds are where the effect of usual size on a quadrotor stands out of its sensors' noise: half a newton per
kilogram of drag at 1 m/s, an angular acceleration of 2 rad/s^2. They say what to expect; whether an effect is really
told apart is measured by the diagnosis itself.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Literal

import msgspec

Answer = Literal["yes", "weakly", "no"]

FORCE = ("specific_force", "velocity", "acceleration")
DRIVE = ("rotor_speed", "rotor_speed_command", "rotor_thrust_command", "rotor_command")
WRENCH = (*DRIVE, "collective_thrust_command")
COMMAND = ("rotor_speed_command", "rotor_thrust_command", "rotor_command")
POSE = (("velocity",), ("attitude",))
WORDS = {
    FORCE: "an accelerometer or velocity",
    DRIVE: "rotor speeds or commands, fast enough",
    WRENCH: "rotor speeds or commands, fast enough",
    COMMAND: "rotor commands, fast enough",
}

# What the same data cannot tell apart, from the collinearity of their signals.
AMBIGUOUS: Mapping[str, str] = {
    "thrust_constant": "mass", "mass": "thrust_constant", "torque_constant": "inertia", "weak_rotor": "centre_of_mass",
    "centre_of_mass": "weak_rotor", "slung_load": "mass", "battery_sag": "thrust_constant",
}  # fmt: skip


@dataclass(frozen=True)
class Need:
    """What an effect needs. channels: of each group at least one. measure: of `excitation`, weakly and well enough.

    flight: what to fly when it is not excited.
    """

    channels: tuple[tuple[str, ...], ...]
    measure: str
    weak: float
    enough: float
    flight: str


class EffectAnswer(msgspec.Struct, frozen=True):
    """Whether an effect can be identified, and why not. ambiguous_with: what no data of this kind separates it from."""

    name: str
    answer: Answer
    why: str
    ambiguous_with: str = ""


_SPINS = "yaw spins while flying sideways, fast circles"
_TURNS = "quick rolls and pitches: Lemniscate, ExtendedLemniscate"
NEEDS: Mapping[str, Need] = {
    "rotor_drag": Need((FORCE, *POSE, DRIVE), "lateral_speed", 0.3, 1.0, _SPINS),
    "linear_drag": Need((FORCE, *POSE), "lateral_speed", 0.3, 1.0, "straight lines and circles"),
    "parasitic_drag": Need((FORCE, *POSE), "speed", 2.0, 4.0, "straight accelerations to full speed: line:size=2"),
    "rotational_damping": Need((("rate",), DRIVE), "tilting_rate", 0.3, 1.0, _TURNS),
    "wind": Need((FORCE, *POSE), "duration", 20.0, 60.0, "hover and slow circles for a minute"),
    "gust": Need((FORCE,), "duration", 20.0, 60.0, "a minute of any flight"),
    "ground_effect": Need((("position",), FORCE, WRENCH), "low_flight", 2.0, 10.0, "low_flight"),
    "wall_effect": Need((("position",), FORCE), "low_flight", float("inf"), float("inf"), "slow passes along the wall"),
    "translational_lift": Need((FORCE, *POSE, WRENCH), "lateral_speed", 1.0, 2.0, "fast level flight: circle, line"),
    "axial_inflow": Need((FORCE, *POSE, WRENCH), "climb_speed", 0.3, 0.8, "climbs and descents: bob, Parabola"),
    "blade_flapping": Need((("rate",), *POSE, DRIVE), "lateral_speed", 0.5, 1.5, "aggressive level flight: Lemniscate"),
    "rotor_gyroscopic": Need((("rate",), DRIVE), "tilting_rate", 0.8, 2.0, "quick rolls while yawing"),
    "motor_lag": Need((("rate", "specific_force"), COMMAND), "tilting_acceleration", 2.0, 8.0, _TURNS),
    "battery_sag": Need((("battery_voltage",), COMMAND, FORCE), "voltage_drop", 0.03, 0.08, "a full battery until low"),
    "weak_rotor": Need((("rate",), DRIVE), "duration", 5.0, 15.0, "hover"),
    "rotor_cant": Need((("rate",), DRIVE), "thrust_range", 0.05, 0.15, "climbs and descents: bob"),
    "thrust_constant": Need((FORCE, WRENCH), "duration", 5.0, 15.0, "hover"),
    "torque_constant": Need((("rate",), DRIVE), "yaw_acceleration", 0.3, 1.0, "yaw_spin with quick starts"),
    "inertia": Need((("rate",), (*DRIVE, "torque_command")), "tilting_acceleration", 2.0, 8.0, _TURNS),
    "mass": Need((FORCE, WRENCH), "duration", 5.0, 15.0, "hover"),
    "centre_of_mass": Need((("rate",), DRIVE), "thrust_range", 0.05, 0.15, "climbs and descents: bob"),
    "slung_load": Need((FORCE, ("attitude",)), "acceleration", 0.5, 1.5, "stops and starts: line"),
    "imu_bias": Need((("specific_force",), *POSE), "tilt", 0.05, 0.2, "tilted flight in several headings: circle"),
    "gyro_bias": Need((("rate",), ("attitude",)), "duration", 5.0, 15.0, "any flight"),
    "time_delay": Need((("rate",), ("attitude",)), "tilting_rate", 0.2, 0.6, _TURNS),
    "rotor_speed_fault": Need((("rotor_speed",), ("rate", *COMMAND)), "duration", 5.0, 15.0, "hover"),
}


def answers(have: Collection[str], measured: Mapping[str, float], units: Mapping[str, str]) -> tuple[EffectAnswer, ...]:
    """For every effect of the catalogue whether it can be identified.

    have: quantities that can be used. measured: of `excitation.measures`. units: theirs.
    """
    return tuple(_answer(name, need, have, measured, units) for name, need in NEEDS.items())


def _answer(
    name: str, need: Need, have: Collection[str], measured: Mapping[str, float], units: Mapping[str, str]
) -> EffectAnswer:
    also = AMBIGUOUS.get(name, "")
    lacking = [group for group in need.channels if not set(group) & set(have)]
    if lacking:
        return EffectAnswer(name, "no", "needs " + " and ".join(map(_named, lacking)), also)
    if name == "wall_effect":
        return EffectAnswer(name, "weakly", "the log does not say where walls are; " + need.flight, also)
    value, unit = measured.get(need.measure), units.get(need.measure, "")
    if value is None:
        return EffectAnswer(name, "no", f"{need.measure} cannot be told from this log", also)
    told = f"{need.measure.replace('_', ' ')} {value:.3g} {unit}".removesuffix(" 1")
    if value >= need.enough:
        return EffectAnswer(name, "yes", told, also)
    answer: Answer = "weakly" if value >= need.weak else "no"
    return EffectAnswer(name, answer, f"{told}, wanted {need.enough:g}; fly {need.flight}", also)


def _named(group: tuple[str, ...]) -> str:
    return WORDS.get(group, " or ".join(name.replace("_", " ") for name in group))
