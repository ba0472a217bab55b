"""A vehicle's constants by rule of thumb, from what is written on its parts: for a first model, before any flight.

thrust_constant    C_T rho D^4 / (4 pi^2) with a static thrust coefficient C_T
torque_constant    C_P rho D^5 / (8 pi^3) with a static power coefficient C_P
speed_max          kV times the pack's nominal voltage, less what the load takes
inertia            of a body whose radius of gyration is a share of its arm

The spread of each rule is that of the vehicles and propellers behind it, and is stated with the number.
Sources: Brandt, Selig, "Propeller Performance Data at Low Reynolds Numbers", AIAA 2011-1255, and the UIUC Propeller
Data Site (static coefficients of two-bladed propellers of 4 to 11 inches); models of Crazyflie 2, PI-TCN's 250 g
quadrotor, Hummingbird, Iris, x500, Pelican (inertia).
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from dynamics.autopilot_frames import FRAMES
from dynamics.errors import RequestError
from dynamics.spelling import nearest
from dynamics.vehicle import GRAVITY
from dynamics.vehicle_draft import Draft, Entry
from dynamics.vehicle_plausibility import AIR_DENSITY, require_in_range

INCH = 0.0254  # m
THRUST_COEFFICIENT, THRUST_SPREAD = 0.11, 0.35  # C_T of two blades, half of the interval of 95 % over the value
POWER_COEFFICIENT, POWER_SPREAD = 0.045, 0.5  # C_P
BLADE_GAIN = 0.4  # more thrust and power for each blade beyond two, of that of two
CELL_VOLTAGE = 3.7  # V
LOADED_SPEED, SPEED_SPREAD = 0.75, 0.15  # full-throttle speed over kV times voltage
TILT_INERTIA, TILT_SPREAD = 0.27, 0.45  # inertia about body x and y over mass times arm^2
YAW_INERTIA, YAW_SPREAD = 0.88, 0.2  # inertia about body z over the sum of those about x and y
MIN_MARGIN, MAX_MARGIN = 1.5, 12.0  # thrust over weight beyond which a number is probably wrong


def size_vehicle(
    *,
    name: str,
    mass: float,
    arm: float,
    propeller: float,
    kv: float,
    cells: int,
    frame: str = "quad_x",
    blades: int = 2,
    command: str = "",
) -> Draft:
    """A draft of a vehicle by these rules.

    mass: kg, ready to fly. arm: from the centre to a motor's axis, m. propeller: diameter, m. kv: of the motors,
    rpm/V. cells: of the battery, in series. frame: name in `FRAMES`. blades: of a propeller.

    Raises RequestError for numbers that make no vehicle.
    """
    _require(mass, arm, propeller, kv, cells, frame, blades)
    layout = FRAMES[frame]
    more = 1 + BLADE_GAIN * (blades - 2)
    thrust_constant = more * THRUST_COEFFICIENT * AIR_DENSITY * propeller**4 / (4 * math.pi**2)
    torque_constant = more * POWER_COEFFICIENT * AIR_DENSITY * propeller**5 / (8 * math.pi**3)
    speed = LOADED_SPEED * kv * CELL_VOLTAGE * cells * 2 * math.pi / 60
    entries = (
        Entry("body.mass", mass, "kg", "given", "weighed to 2 %", (0.02 * mass,)),
        inertia_entry(mass, arm),
        Entry("rotors.position", [list(p) for p in _scaled(layout.direction, arm)], "m, body FLU", "given",
              f"{frame.replace('_', ' ')}, {arm:g} m from the centre to the motors"),
        Entry("rotors.spin", list(layout.spin), "sign of the reaction torque about body z", "rule",
              f"as PX4 and ArduPilot turn the motors of a {frame.replace('_', ' ')}: check each"),
        Entry("rotors.motor", list(layout.motor), "the autopilot's motor numbers", "rule", "of the same frame"),
        Entry("rotors.thrust_constant", thrust_constant, "N s^2/rad^2", "rule",
              f"C_T = {more * THRUST_COEFFICIENT:.3g} of {blades} blades of {propeller:g} m",
              (THRUST_SPREAD * thrust_constant,)),
        Entry("rotors.torque_constant", torque_constant, "N m s^2/rad^2", "rule",
              f"C_P = {more * POWER_COEFFICIENT:.3g} of the same", (POWER_SPREAD * torque_constant,)),
        Entry("rotors.speed_max", speed, "rad/s", "rule",
              f"{LOADED_SPEED:g} of kV {kv:g} at {cells} cells of {CELL_VOLTAGE:g} V", (SPEED_SPREAD * speed,)),
        Entry("rotors.radius", propeller / 2, "m", "given", "half of the diameter given"),
    )  # fmt: skip
    return Draft(name, entries, _open(), tuple(_doubts(mass, layout_thrust(thrust_constant, speed, frame))), command)


def inertia_by_rule(mass: float, arm: float) -> tuple[float, float, float]:
    """The moments of inertia by rule, kg m^2. mass: kg. arm: m."""
    tilt = TILT_INERTIA * mass * arm**2
    return tilt, tilt, YAW_INERTIA * 2 * tilt


def inertia_entry(mass: float, arm: float) -> Entry:
    """The moments of inertia by rule, with their intervals. mass: kg. arm: m."""
    tilt, _, yaw = inertia_by_rule(mass, arm)
    return Entry(
        "body.inertia",
        [tilt, tilt, yaw],
        "kg m^2, diagonal",
        "rule",
        f"{TILT_INERTIA:g} of mass times arm squared, about z {YAW_INERTIA:g} of the sum of the others",
        (TILT_SPREAD * tilt, TILT_SPREAD * tilt, (TILT_SPREAD + YAW_SPREAD) * yaw),
    )


def layout_thrust(thrust_constant: float, speed: float, frame: str) -> float:
    """Thrust of all rotors at full speed, N."""
    return len(FRAMES[frame].angle) * thrust_constant * speed**2


def _scaled(directions: Sequence[tuple[float, float, float]], arm: float) -> list[tuple[float, ...]]:
    return [tuple(arm * value for value in direction) for direction in directions]


def _open() -> tuple[str, ...]:
    return (
        "everything by rule is a first guess: `alula vehicle from-log` estimates it from flights",
        "the motors' lag: flights with quick rolls show it",
    )


def _doubts(mass: float, thrust: float) -> list[str]:
    margin = thrust / (mass * GRAVITY)
    if MIN_MARGIN <= margin <= MAX_MARGIN:
        return []
    return [
        f"full thrust would be {margin:.1f} times the weight; usual are {MIN_MARGIN:g} to {MAX_MARGIN:g}. Check mass "
        "(kg), propeller diameter, kV and cells"
    ]


def _require(mass: float, arm: float, propeller: float, kv: float, cells: int, frame: str, blades: int) -> None:
    if frame not in FRAMES:
        raise RequestError(f"unknown frame {frame!r}{nearest(frame, FRAMES)}. Known: {', '.join(FRAMES)}.")
    require_in_range(mass=mass, arm=arm, propeller=propeller)
    ranges = {
        "kv": (kv, 20.0, 30000.0, "rpm/V"),
        "cells": (cells, 1, 24, "in series"),
        "blades": (blades, 2, 6, ""),
    }
    for name, (value, low, high, unit) in ranges.items():
        if not low <= value <= high:
            raise RequestError(f"{name} = {value:g}: give {low:g} to {high:g} {unit}.".replace(" .", "."))
    neighbours = _smallest_gap(frame) * arm
    if frame != "octaquad_x" and propeller > neighbours:
        raise RequestError(
            f"propellers of {propeller:g} m would touch: motors of a {frame.replace('_', ' ')} with arms of {arm:g} m "
            f"are {neighbours:.3g} m apart. Check the arm (m, centre to motor) and the diameter (m)."
        )


def _smallest_gap(frame: str) -> float:
    """Smallest distance of two rotors that are not on one axis, over the arm."""
    directions = FRAMES[frame].direction
    gaps = [math.dist(a, b) for i, a in enumerate(directions) for b in directions[:i]]
    return min(gap for gap in gaps if gap > 1e-6)
