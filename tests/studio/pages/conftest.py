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


@pytest.fixture(scope="session")
def vehicle() -> Vehicle:
    return read_vehicle(FOLDER / "arpl_250g.toml")


@pytest.fixture(scope="session")
def dataset(vehicle: Vehicle) -> Dataset:
    return planted_dataset(vehicle, [EffectUse("rotor_drag", {"coefficient": 2.2e-5})], seed=5)


@pytest.fixture(scope="session")
def findings(dataset: Dataset, vehicle: Vehicle) -> DiagnosisDetails:
    return diagnose_dataset(dataset, vehicle, CATALOGUE)


@pytest.fixture(scope="session")
def compared(dataset: Dataset, vehicle: Vehicle) -> ComparisonDetails:
    return compare_dataset(dataset, vehicle, CATALOGUE)
