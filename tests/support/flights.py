"""Flights of the mock's vehicle for tests: quiet sensors, take-off, step responses."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from sitl_mock.vehicle.sensors import SensorErrors
from sitl_mock.vehicle.vehicle import SimulatedVehicle, VehicleOptions
from sitl_mock.vehicle.vehicle_interface import ControlSetpoint

QUIET = VehicleOptions(sensors=SensorErrors().without_noise(), rotor_noise=0.0)


def hover_at(*position: float) -> ControlSetpoint:
    """Hold a position, m."""
    return ControlSetpoint("hold", position_world=np.array(position))


def take_off(vehicle: SimulatedVehicle, *, height: float = 3.0, duration: float = 6.0) -> None:
    """Arm and climb to a height over the origin."""
    vehicle.advance(hover_at(0.0, 0.0, height), True, duration)


def response(
    vehicle: SimulatedVehicle, setpoint: ControlSetpoint, duration: float, look: Callable[[SimulatedVehicle], float]
) -> NDArray[np.float64]:
    """The observed value after every millisecond of a setpoint."""
    observed = []
    for _ in range(round(duration * 1000)):
        vehicle.advance(setpoint, True, 0.001)
        observed.append(look(vehicle))
    return np.array(observed)


def milliseconds_to(level: float, values: NDArray[np.float64]) -> int:
    """When the values first exceed a level."""
    above = values > level
    assert above.any(), f"never above {level}; at most {values.max()}"
    return int(np.argmax(above)) + 1
