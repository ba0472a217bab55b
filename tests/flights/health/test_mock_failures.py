"""Failures that the mock makes, recorded at PX4's default rates: the cause comes first, with its rotor and its time."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import pytest

from fixtures.default_rate_flight import DefaultRateFlight, record
from fixtures.flight_store import stored
from fixtures.health_cases import health_case, is_right
from flights.health import Health, read_health
from flights.reading import read_log

SEED = 9001


def health_of(flight: DefaultRateFlight, folder: Path) -> Health:
    path = folder / "flight.ulg"
    path.write_bytes(stored(partial(record, flight), "default rates", flight))
    return read_health(read_log(path))


@pytest.mark.parametrize("kind", ["healthy", "stopped", "weakens", "loses_gps"])
def test_the_cause_comes_first(kind: str, tmp_path: Path) -> None:
    case = health_case(kind, SEED)
    health = health_of(case.flight, tmp_path)
    assert is_right(case, health), (case, health.sentences)
    for fault in case.flight.faults:
        (first,) = [s for s in health.statements if s.name == health.first]
        took_off = next(event.time for event in health.events if event.name == "takeoff")
        assert first.start == pytest.approx(took_off + fault.at, abs=1.5)
