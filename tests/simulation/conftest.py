"""What the flights in lockstep share."""

from __future__ import annotations

import pytest

from dynamics.controller_settings import CONTROL_PERIOD
from dynamics.vehicle_file import read_vehicle
from runtime.control.controller import Controller, ControllerOptions
from runtime.flight.composition import Controllers
from vehicles import FOLDER


@pytest.fixture(scope="session")
def controllers() -> Controllers:
    """The nominal controller of PX4's simulated quadrotor."""
    vehicle = read_vehicle(FOLDER / "px4_sih.toml")
    return Controllers(Controller.build(vehicle, ControllerOptions.for_vehicle(vehicle, period=CONTROL_PERIOD)))
