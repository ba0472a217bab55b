"""A flight over a serial line that loses bytes and is unplugged: events say so, and the link comes back."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from dynamics.vehicle import Vehicle
from dynamics.vehicle_file import read_vehicle
from runtime.flight_request import FlightReport
from simulation.mock_process import MockProcess, mock_process
from tests.runtime.test_daemon import VEHICLE_FILE, Announcements, fly, request_for
from tests.support.serial_cable import SerialCable

pytestmark = pytest.mark.realtime

LOSS = 2e-4  # of each byte: one frame in fifty is hit, and estimates still come at 90 Hz
UNPLUGGED_AFTER = 2.0  # s in the air


@pytest.fixture(scope="module")
def vehicle() -> Vehicle:
    return read_vehicle(VEHICLE_FILE)


@pytest.fixture
def cable(tmp_path: Path) -> Iterator[SerialCable]:
    with SerialCable(tmp_path) as made:
        yield made


@pytest.fixture
def mock(cable: SerialCable) -> Iterator[MockProcess]:
    """A mock on the cable's far end, whose own failsafe is slower than the line comes back."""
    with mock_process("--link", f"serial:{cable.far}:921600", "--param", "COM_OF_LOSS_T=4") as process:
        yield process


def fly_with_fault(vehicle: Vehicle, cable: SerialCable, seconds: float, announcements: Announcements) -> FlightReport:
    """Fly over a line that loses bytes from lift-off on, and is unplugged in the air for some seconds."""
    plugging = threading.Timer(UNPLUGGED_AFTER + seconds, cable.plug)
    unplugging = threading.Timer(UNPLUGGED_AFTER, cable.unplug)

    def begin() -> None:
        cable.loss = LOSS
        unplugging.start()
        plugging.start()

    announcements.waiting["in_air"] = begin
    report = fly(vehicle, announcements, request_for(f"serial:{cable.near}:921600"))
    for timer in (unplugging, plugging):
        timer.join()
    return report


@pytest.mark.long("a flight against the clock")
def test_a_line_that_loses_bytes_and_is_gone_for_a_moment_is_flown_through(
    vehicle: Vehicle, cable: SerialCable, mock: MockProcess
) -> None:
    announcements = Announcements()
    report = fly_with_fault(vehicle, cable, 0.3, announcements)
    assert report.landed, announcements
    assert cable.lost > 20
    for text in ("belong to no frame", f"{cable.near} is gone", "is open again", "FALLBACK -> ENGAGED"):
        assert announcements.contain(text), announcements
    assert report.events["estimate_stale"] >= 1


@pytest.mark.long("a flight against the clock")
def test_a_line_that_is_closed_for_longer_comes_back_and_the_vehicle_is_asked_to_land(
    vehicle: Vehicle, cable: SerialCable, mock: MockProcess
) -> None:
    announcements = Announcements()
    report = fly_with_fault(vehicle, cable, 1.3, announcements)
    for text in ("is gone", "has been silent", "is open again", "is heard again", "from OFFBOARD to LAND"):
        assert announcements.contain(text), announcements
    assert not report.landed  # its autopilot lands it: nothing that was silent for a second is taken over again
    assert "nothing arrives from the vehicle" in report.outcome
    assert "mode LAND" in report.outcome
