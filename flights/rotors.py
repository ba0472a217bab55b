"""Rotor speeds of a flight: measured, or those that the commands give by the vehicle file."""

from __future__ import annotations

from typing import Literal

import numpy as np

from dynamics.allocation import effectiveness
from dynamics.arrays import Floats
from dynamics.errors import DataError
from dynamics.excitation import COMMAND, WRENCH
from dynamics.vehicle import Rotors, Vehicle
from flights.flight import Flight
from flights.quality.advice import faster_rotors, unused_rotors
from flights.quality.inspection import MIN_ROTOR_RATE

RotorSource = Literal["measured", "speed_command", "command"]  # commanded speeds are taken as reached
SOURCES: dict[str, RotorSource] = {"rotor_speed": "measured", "rotor_speed_command": "speed_command"}

QUANTITIES = ("rotor_speed", *COMMAND)


def rotor_speeds(
    flight: Flight, vehicle: Vehicle, *, prefer: Literal["measured", "command"] = "measured"
) -> tuple[Floats, RotorSource]:
    """(n, rotors) rad/s: measured, or else those that the commands give by the vehicle file.

    prefer: "command" takes commands first, for models whose inputs are commands.

    Raises DataError when there are neither, none is logged fast enough, or their number is not the vehicle file's.
    """
    name, count, slow = flight.provenance.path, vehicle.rotors.count, []
    for quantity in QUANTITIES if prefer == "measured" else (*COMMAND, "rotor_speed"):
        if not flight.has(quantity):
            continue
        origin = flight.origins.get(quantity)
        if origin is not None and origin.rate < MIN_ROTOR_RATE:
            slow.append(f"{quantity} at {origin.rate:.0f} Hz")
            continue
        values = flight[quantity]
        if values.shape[1] != count:
            raise DataError(f"{name} has {values.shape[1]} rotors, the vehicle file {count}. Give its own file.")
        return _speeds(quantity, values, vehicle.rotors), SOURCES.get(quantity, "command")
    if flight.has("collective_thrust_command", "torque_command"):
        return _allocated(flight, vehicle), "command"
    if slow:
        advice = faster_rotors(flight.provenance.format, flight.parameters)
        if "SDLOG_PROFILE" not in advice:  # a table may have been a PX4 log
            advice += f"; with PX4, {faster_rotors('PX4 ULog', {})}"
        raise DataError(
            f"{name} has {', '.join(slow)}. Wanted {MIN_ROTOR_RATE:.0f} Hz or more, for rotors answer within tens of "
            f"milliseconds: {advice}. Then fly again."
        )
    raise DataError(
        f"{name} has {', '.join(flight.quantities)}. Wanted rotor speeds, motor commands, or commanded thrust and "
        f"torque; {instead_of_missing(flight)}."
    )


def instead_of_missing(flight: Flight) -> str:
    """Advice on rotors that a flight lacks: to name those that its log holds unnamed, or to log them."""
    candidates = flight.provenance.candidates(WRENCH)
    if not candidates:
        return "log them"
    listed = "; ".join(map(str, candidates))
    return f"the log may hold them unnamed: {listed}. To use them, {unused_rotors(flight.provenance.format)}"


def _speeds(quantity: str, values: Floats, rotors: Rotors) -> Floats:
    """Rotor speeds of a quantity's values (n, rotors)."""
    if quantity == "rotor_thrust_command":
        return np.asarray(np.sqrt(np.maximum(values, 0.0) / rotors.thrust_constant))
    if quantity == "rotor_command":
        curve = rotors.thrust_curve
        return np.asarray(rotors.speed_max * np.sqrt(np.maximum(curve * values**2 + (1 - curve) * values, 0.0)))
    return values


def _allocated(flight: Flight, vehicle: Vehicle) -> Floats:
    """(n, rotors) rad/s of commanded thrust and of torque about the centre of mass, for logs without rotors."""
    thrust = flight["collective_thrust_command"].reshape(-1, 1)
    torque_and_thrust = np.hstack([flight["torque_command"], thrust])
    at_full_speed = torque_and_thrust @ np.linalg.pinv(effectiveness(vehicle)).T
    return np.asarray(vehicle.rotors.speed_max * np.sqrt(np.maximum(at_full_speed, 0.0)))
