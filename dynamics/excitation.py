"""Excitation of an effect: the logged quantities and the motion that show it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

Group = tuple[str, ...]

# Groups of logged quantities that serve the same purpose: one of a group is enough.
FORCE: Group = ("specific_force", "velocity", "acceleration")
DRIVE: Group = ("rotor_speed", "rotor_speed_command", "rotor_thrust_command", "rotor_command")
WRENCH: Group = (*DRIVE, "collective_thrust_command")
COMMAND: Group = ("rotor_speed_command", "rotor_thrust_command", "rotor_command")
POSE: tuple[Group, ...] = (("velocity",), ("attitude",))

# Measures of motion and their units; `flights.quality.excitation.measures` takes them from a flight.
MEASURES: Mapping[str, str] = {
    "duration": "s", "speed": "m/s", "forward_speed": "m/s", "sideways_speed": "m/s", "lateral_speed": "m/s",
    "climb_speed": "m/s", "roll_rate": "rad/s", "pitch_rate": "rad/s", "yaw_rate": "rad/s", "tilting_rate": "rad/s",
    "roll_acceleration": "rad/s^2", "pitch_acceleration": "rad/s^2", "yaw_acceleration": "rad/s^2",
    "tilting_acceleration": "rad/s^2", "acceleration": "m/s^2", "thrust_range": "1", "tilt": "rad",
    "low_flight": "s", "headings": "rad", "voltage_drop": "1",
}  # fmt: skip

QUICK_TURNS = "quick rolls and pitches: Lemniscate, ExtendedLemniscate"


@dataclass(frozen=True)
class Excitation:
    """Excitation that shows an effect of usual size above the sensors' noise.

    channels: groups of logged quantities, of each group at least one.
    measure: the motion that shows it, one of MEASURES.
    weak: size of the measure from which the effect shows weakly.
    enough: size from which it shows well.
    flight: what to fly where the measure is too small.
    manoeuvre: what separates it from other effects.
    unlogged: what it depends on and no log contains, such as "where walls are"; no measure is needed then.
    """

    channels: tuple[Group, ...]
    measure: str = ""
    weak: float = 0.0
    enough: float = 0.0
    flight: str = "more aggressive flight"
    manoeuvre: str = "more aggressive flight"
    unlogged: str = ""

    @property
    def unit(self) -> str:
        """Of the measure; 1 for a ratio or none."""
        return MEASURES.get(self.measure, "1")

    def __post_init__(self) -> None:
        if bool(self.measure) == bool(self.unlogged):
            raise ValueError("Excitation: give either a measure that shows the effect or what is unlogged.")
        if self.measure and self.measure not in MEASURES:
            raise ValueError(f"Excitation: unknown measure {self.measure!r}; known: {', '.join(MEASURES)}.")
        if not 0.0 <= self.weak <= self.enough:
            raise ValueError(f"Excitation: 0 <= weak <= enough is required, not {self.weak} and {self.enough}.")
