"""Logs whose drag is not the vehicle file's, of real PX4 in three formats and of short flights, and cases of them."""

from __future__ import annotations

import gzip
from collections.abc import Iterator
from pathlib import Path

import pytest

from dynamics.vehicle import EffectUse, Vehicle
from fixtures.planted import planted_flights
from fixtures.recorded import write_recording
from flights import Flight
from studio.app.opened import OpenCase
from studio.case.case import Case
from studio.work.worker import Worker

DATA = Path(__file__).parents[1] / "data" / "px4_sih_flights"
NAMES = ("drag2_1_circle", "drag2_4_lemniscate")
SHORT = ("line:laps=3,ramp=1", "circle:laps=2,ramp=1,speed=1.2", "Lemniscate:laps=3,ramp=1.5,speed=0.9")
PLANTED = 0.1  # N s/m


@pytest.fixture(scope="session")
def ulogs(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    folder = tmp_path_factory.mktemp("ulogs")
    paths = []
    for name in NAMES:
        path = folder / f"{name}.ulg"
        path.write_bytes(gzip.decompress((DATA / f"{name}.ulg.gz").read_bytes()))
        paths.append(path)
    return paths


@pytest.fixture(scope="session")
def csvs(ulogs: list[Path], tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    folder = tmp_path_factory.mktemp("csvs")
    return [Path(Flight.read(path).to_csv(folder / f"{path.stem}.csv")) for path in ulogs]


@pytest.fixture(scope="session")
def recordings(ulogs: list[Path], tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    folder = tmp_path_factory.mktemp("recordings")
    return [write_recording(Flight.read(path, rate=100.0), folder / f"{path.stem}.mcap") for path in ulogs]


@pytest.fixture(scope="session")
def short_logs(arpl_250g: Vehicle, tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Three flights of 10 s of the bundled arpl_250g with a drag, for what does not depend on who recorded them."""
    folder = tmp_path_factory.mktemp("short")
    flights = planted_flights(arpl_250g, [EffectUse("linear_drag", {"coefficient": PLANTED})], seed=5, manoeuvres=SHORT)
    return [Path(flight.to_csv(folder / f"flight_{number}.csv")) for number, flight in enumerate(flights)]


@pytest.fixture(scope="session")
def worker() -> Iterator[Worker]:
    process = Worker()
    yield process
    process.close()


@pytest.fixture
def opened(tmp_path: Path, worker: Worker) -> Iterator[OpenCase]:
    """An empty case, whose work is done by a process that the tests of a module share."""
    case = Case.create(tmp_path / "case")
    yield OpenCase(case, lambda: worker)
    case.close()
