"""What every test may use."""

import pytest
from hypothesis import settings

from dynamics.vehicle import Vehicle
from dynamics.vehicle_file import read_vehicle
from vehicles import FOLDER

pytest_plugins = ("tests.support.realtime", "tests.support.alone")

# A noisy machine makes single examples slow, which says nothing about them.
settings.register_profile("alula", deadline=None)
settings.load_profile("alula")


@pytest.fixture(scope="session")
def arpl_250g() -> Vehicle:
    """The paper's quadrotor."""
    return read_vehicle(FOLDER / "arpl_250g.toml")
