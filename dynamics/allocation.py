"""Thrusts and torques of a vehicle's rotors, and PX4's mixer from normalised torques to them.

Source: PX4-Autopilot, ControlAllocationPseudoInverse.cpp (normalisation). All in FLU axes.
"""

from __future__ import annotations

import numpy as np

from dynamics.arrays import Floats
from dynamics.vehicle import Vehicle


def effectiveness(vehicle: Vehicle) -> Floats:
    """Torque x, y, z about the centre of mass, N m, and thrust, N, of each rotor at full speed. Returns (4, rotors)."""
    rotors, centre = vehicle.rotors, vehicle.body.centre_of_mass
    thrust, roll, pitch, yaw = rotors.allocation * rotors.speed_max**2
    return np.stack([roll - centre[1] * thrust, pitch + centre[0] * thrust, yaw, thrust])


def mixer(vehicle: Vehicle) -> Floats:
    """Matrix from (torque x, y, z, thrust), normalised as PX4 does, to motor thrusts of 0..1. Returns (rotors, 4).

    Roll and pitch share one scale; a unit yaw torque is a full motor; a unit thrust is full thrust.
    """
    mix = np.linalg.pinv(effectiveness(vehicle))
    mix[np.abs(mix) < 1e-9 * np.abs(mix).max(axis=0)] = 0.0
    tilt_scale = max(np.sqrt(2 * np.sum(mix[:, axis] ** 2) / np.count_nonzero(mix[:, axis])) for axis in (0, 1))
    yaw_scale = np.max(mix[:, 2]) if vehicle.rotors.torque_constant > 0 else 1.0
    return np.asarray(mix / [tilt_scale, tilt_scale, yaw_scale, np.mean(np.abs(mix[:, 3]))])


def torque_authority(vehicle: Vehicle) -> Floats:
    """Torque about body x, y, z of a unit of normalised torque, N m. Returns (3,)."""
    return np.asarray(np.diag(effectiveness(vehicle)[0:3] @ mixer(vehicle)[:, 0:3]))
