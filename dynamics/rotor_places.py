"""Rotors by their place and by the autopilots' motor numbers, so that nobody exchanges the wrong propeller."""

from __future__ import annotations

import math
from collections.abc import Mapping

from dynamics.vehicle import Vehicle

DIRECTIONS = ("front", "front left", "left", "back left", "back", "back right", "right", "front right")  # each 45 deg
QUAD_X: Mapping[str, tuple[str, ...]] = {  # an autopilot's motors, the first one first
    "PX4 and ArduPilot motor ": ("front right", "back left", "front left", "back right"),
    "Crazyflie M": ("front right", "back right", "back left", "front left"),
}
HEXA_X: Mapping[str, tuple[str, ...]] = {
    "PX4 and ArduPilot motor ": ("right", "left", "front left", "back right", "front right", "back left"),
}


def rotor_places(vehicle: Vehicle) -> tuple[str, ...]:
    """Where each rotor is, seen from above, such as "back left"; empty texts where two would have the same place."""
    places = tuple(_direction(x, y) for x, y, _ in vehicle.rotors.position)
    return places if len(set(places)) == len(places) else ("",) * len(places)


def rotor_names(vehicle: Vehicle) -> tuple[str, ...]:
    """Each rotor for people: "rotor 1 (back left; PX4 and ArduPilot motor 2, Crazyflie M3)".

    The numbers are those that the vehicle file gives as `motor`, else those of the autopilots' usual frame of these
    places: quad X and hexa X. Other frames have their place alone.
    """
    places = rotor_places(vehicle)
    frames = {4: QUAD_X, 6: HEXA_X}.get(len(places), {})
    names = []
    for number, place in enumerate(places):
        usual = [f"{of}{order.index(place) + 1}" for of, order in frames.items() if sorted(order) == sorted(places)]
        motors = [f"motor {vehicle.rotors.motor[number]}"] if vehicle.rotors.motor else usual
        inside = "; ".join(filter(None, [place, ", ".join(motors)]))
        names.append(f"rotor {number} ({inside})" if inside else f"rotor {number}")
    return tuple(names)


def _direction(x: float, y: float) -> str:
    """The nearest of eight directions. x, y: forward and left of the body's origin, m."""
    if math.hypot(x, y) == 0.0:
        return "centre"
    return DIRECTIONS[round(math.atan2(y, x) / (math.pi / 4)) % len(DIRECTIONS)]
