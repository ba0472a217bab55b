"""The tutorial from training to a flight can be followed and shows what is printed; it flies against the clock."""

import shutil
from pathlib import Path

import pytest

from tests.support.tutorial import TUTORIALS, follow, prepare

PAGE = TUTORIALS / "training_to_flight.md"


@pytest.fixture(scope="session")  # a repeated flight needs no second training
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Where the tutorial was followed up to its flight."""
    folder = tmp_path_factory.mktemp("tutorial")
    prepare(folder)
    follow(PAGE, folder, against_clock=False)
    return folder


@pytest.mark.long("follows the whole page")
def test_every_step_works_and_prints_what_is_shown(folder: Path) -> None:
    assert (folder / "bundles" / "pi_tcn" / "manifest.json").exists()


@pytest.mark.long("a flight against the clock, and what it waits for")
@pytest.mark.realtime
def test_its_flight_lands(folder: Path) -> None:
    shutil.rmtree(folder / "recordings", ignore_errors=True)
    follow(PAGE, folder, against_clock=True)
