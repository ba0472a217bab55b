"""Rotor speeds of commanded thrust and torque are those that the vehicle file's rotors need for them."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest

from dynamics.vehicle import Vehicle
from flights import Flight
from flights.log import Provenance
from flights.rotors import rotor_speeds


@pytest.mark.parametrize("centre", [(0.0, 0.0, 0.0), (0.01, -0.006, 0.0)])
def test_commanded_torque_acts_about_the_centre_of_mass(arpl_250g: Vehicle, centre: tuple[float, float, float]) -> None:
    vehicle = msgspec.structs.replace(arpl_250g, body=msgspec.structs.replace(arpl_250g.body, centre_of_mass=centre))
    torque, thrust = np.array([0.004, -0.003, 0.001]), 2.6
    columns = {"collective_thrust_command": np.full(5, thrust)}
    columns |= {f"torque_command_{axis}": np.full(5, value) for axis, value in zip("xyz", torque, strict=True)}
    speed, source = rotor_speeds(Flight(np.arange(5) / 100.0, columns, Provenance("planted", "", "", "")), vehicle)
    assert source == "command"
    force, yaw = vehicle.rotors.thrust_constant * speed[0] ** 2, vehicle.rotors.torque_constant * speed[0] ** 2
    arm = np.array(vehicle.rotors.position) - np.array(centre)
    moment = np.sum(np.cross(arm, np.outer(force, [0.0, 0.0, 1.0])), axis=0)
    moment[2] += yaw @ np.array(vehicle.rotors.spin)
    np.testing.assert_allclose(moment, torque, atol=1e-9)
    assert np.sum(force) == pytest.approx(thrust)
