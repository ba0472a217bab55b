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

# Files of minutes, which the workers begin first: the last one would be left to one of them alone.
LONG = (
    "studio/app/test_journey.py", "studio/work/test_steps.py", "docs/test_commands_of_pages.py",
    "diagnosis/verdicts/test_real_statements.py", "diagnosis/verdicts/test_sets_of_many.py",
)  # fmt: skip


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Long files first, all else in its order."""
    items.sort(key=lambda item: not item.path.as_posix().endswith(LONG))


@pytest.fixture(scope="session")
def arpl_250g() -> Vehicle:
    """The paper's quadrotor."""
    return read_vehicle(FOLDER / "arpl_250g.toml")
