"""What every test may use."""

import signal
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import settings

from dynamics import trust
from dynamics.approvals import approve
from dynamics.effect_source import read_effect_file
from dynamics.vehicle import Vehicle
from dynamics.vehicle_file import read_vehicle
from vehicles import FOLDER

pytest_plugins = (
    "tests.support.realtime", "tests.support.clock_worker", "tests.support.durations", "tests.support.nightly",
)  # fmt: skip

# A noisy machine makes single examples slow, which says nothing about them.
settings.register_profile("alula", deadline=None)
settings.load_profile("alula")

# Files of minutes, which the workers begin first: the last one would be left to one of them alone.
LONG = (
    "studio/app/test_journey.py", "studies/test_search.py", "studio/work/test_steps.py", "studies/test_fleet.py",
    "acceptance/test_hidden_effect.py", "training/test_trainer.py", "studies/test_demo.py",
    "studio/pages/test_report.py", "docs/test_commands_of_pages.py",
    "diagnosis/verdicts/test_sets_of_many.py",
)  # fmt: skip


def pytest_configure() -> None:
    """Take signals as a terminal leaves them: what a shell ignores for a job in the background, children ignore too."""
    signal.signal(signal.SIGINT, signal.default_int_handler)
    signal.signal(signal.SIGHUP, signal.SIG_DFL)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Long files first, all else in its order."""
    items.sort(key=lambda item: not item.path.as_posix().endswith(LONG))


OWN_EFFECTS = Path(__file__).parents[1] / "examples" / "my_effects.py"


@pytest.fixture(scope="session", autouse=True)
def approvals_of_tests(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """A list of approved code of the tests' own, beginning with the documented example; the user's is left alone."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_CONFIG_HOME", str(tmp_path_factory.mktemp("config")))
        patch.setenv("XDG_STATE_HOME", str(tmp_path_factory.mktemp("state")))
        approve([("effects", read_effect_file(OWN_EFFECTS).sha256, str(OWN_EFFECTS))])
        yield


@pytest.fixture
def nothing_approved(tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A user who has approved nothing yet, neither for good nor in this process. Returns the configuration folder."""
    folder = tmp_path_factory.mktemp("config")
    monkeypatch.setenv("XDG_CONFIG_HOME", str(folder))
    monkeypatch.setattr(trust, "_approved", set())
    return folder


@pytest.fixture(scope="session")
def arpl_250g() -> Vehicle:
    """The paper's quadrotor."""
    return read_vehicle(FOLDER / "arpl_250g.toml")
