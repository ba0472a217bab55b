"""Pages of a small data set: a vehicle that hides rotor drag, diagnosed once."""

from __future__ import annotations

import pytest

from diagnosis.comparison import ComparisonDetails, compare_dataset
from diagnosis.data.dataset import Dataset
from diagnosis.diagnose import DiagnosisDetails, diagnose_dataset
from dynamics.effects import CATALOGUE
from dynamics.vehicle import EffectUse, Vehicle
from dynamics.vehicle_file import read_vehicle
from fixtures.planted_dataset import planted_dataset
from vehicles import FOLDER

MANOEUVRES = (
    "circle:laps=3,ramp=1,speed=1.2",
    "Lemniscate:laps=4,ramp=1.5,speed=0.9",
    "ExtendedLemniscate:laps=3,ramp=1",
)


@pytest.fixture(scope="session")
def vehicle() -> Vehicle:
    return read_vehicle(FOLDER / "arpl_250g.toml")


@pytest.fixture(scope="session")
def dataset(vehicle: Vehicle) -> Dataset:
    hidden = EffectUse("rotor_drag", {"coefficient": 2.2e-5})
    return planted_dataset(vehicle, [hidden], seed=5, manoeuvres=MANOEUVRES)


@pytest.fixture(scope="session")
def findings(dataset: Dataset, vehicle: Vehicle) -> DiagnosisDetails:
    return diagnose_dataset(dataset, vehicle, CATALOGUE)


@pytest.fixture(scope="session")
def compared(dataset: Dataset, vehicle: Vehicle) -> ComparisonDetails:
    return compare_dataset(dataset, vehicle, CATALOGUE)
