"""A stream that the physics does not need refuses no flight: it is cut or left out, and the log says so."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

from dynamics.arrays import Floats
from dynamics.errors import DataError
from flights import Flight, Log, read_log
from flights.assembly import Assembly
from runtime.record.recorder import Recorder
from runtime.record.records import BatteryRecord, EstimateRecord, ImuRecord, MotorRecord
from tests.support.flight_files import Truth, flight_csv, manoeuvre

Change = Callable[[Floats], Floats]
IDENTITY = np.array([1.0, 0.0, 0.0, 0.0])


@pytest.fixture(scope="module")
def truth() -> Truth:
    return manoeuvre()


def _with_battery_at(stamps: Change, truth: Truth, folder: Path) -> Log:
    """A recording whose battery has other stamps than its motion."""
    recorder, now = Recorder(folder, "flight", metadata={}), time.monotonic()
    battery = stamps(truth.time[::20])
    for i, t in enumerate(truth.time.tolist()):
        at, state = 100.0 + t, (truth.position[i], truth.velocity[i], truth.attitude[i], truth.rate[i])
        recorder.put(EstimateRecord(at, at, *state, reset_counter=9), now + t)
        recorder.put(ImuRecord(at, truth.specific_force[i], truth.rate[i]), now + t)
        recorder.put(MotorRecord(at, 1000 + truth.rotor_speed[i, [3, 1, 0, 2]] / 2.0), now + t)
        if i % 20 == 0:
            recorder.put(BatteryRecord(100.0 + float(battery[i // 20]), 7.4, 3.0, 0.9), now + t)
    recorder.close()
    return read_log(recorder.path)


def _late_rows(stamps: Floats) -> Floats:
    """Two rows that arrived out of turn, 0.83 s ahead of the next."""
    shifted = stamps.copy()
    shifted[6:8] = stamps[8] + 0.83 + np.array([0.0, 1e-4])
    return shifted


@pytest.mark.parametrize(
    ("stamps", "cut"),
    [
        (_late_rows, "stream_cut"),
        (lambda t: np.where(np.arange(len(t)) < 12, t, t - 2.0), "stream_cut"),  # its clock was set once
        (lambda t: t[::-1], "stream_left_out"),
        (np.zeros_like, "stream_left_out"),  # it stands still
        (lambda t: t + 1e6, ""),  # another clock
        (lambda t: t - 1e6, ""),
    ],
)
def test_a_batterys_clock_refuses_no_flight(stamps: Change, cut: str, truth: Truth, tmp_path: Path) -> None:
    log = _with_battery_at(stamps, truth, tmp_path)
    assert {repair.name for repair in log.provenance.repairs} == ({cut} if cut else set())
    assert all("/battery" in detail for detail in log.provenance.damage)
    assert log.duration == pytest.approx(truth.time[-1])
    flight = Flight.from_log(log)
    assert_allclose(flight["position"], truth.position, atol=1e-9)
    battery = log.stream("battery_voltage")
    assert (battery is None) is (cut == "stream_left_out")
    if battery is not None:
        assert np.all(np.diff(battery.time) > 0)


def test_the_longest_part_in_order_stays(truth: Truth, tmp_path: Path) -> None:
    battery = _with_battery_at(_late_rows, truth, tmp_path).stream("battery_voltage")
    assert battery is not None
    assert len(battery.time) == len(truth.time[::20]) - 8
    assert_allclose(battery.time, truth.time[::20][8:], atol=1e-9)


def test_a_setpoint_that_is_no_attitude_is_left_out() -> None:
    assembly, stamps = Assembly(), 0.01 * np.arange(100)
    assembly.add("attitude", stamps, np.tile(IDENTITY, (100, 1)), "pose")
    assembly.add("attitude_setpoint", stamps, np.tile(57.3 * IDENTITY, (100, 1)), "control")
    assembly.add("rate_setpoint", stamps, np.zeros((100, 2)), "control")
    content = assembly.finish()
    assert [stream.name for stream in content.streams] == ["attitude"]
    assert [repair.name for repair in content.repairs] == ["stream_left_out", "stream_left_out"]


@pytest.mark.parametrize("broken_first", [True, False])
def test_another_source_takes_the_place_of_a_broken_one(*, broken_first: bool) -> None:
    assembly, stamps = Assembly(), 0.01 * np.arange(100)
    sources = [("rotor_speed", stamps[::-1].copy()), ("rotor_command", stamps)]
    for name, own in sources if broken_first else sources[::-1]:
        assembly.add(name, own, np.ones((100, 4)), name)
    content = assembly.finish()
    assert [stream.name for stream in content.streams] == ["rotor_command"]
    assert [repair.name for repair in content.repairs] == ["stream_left_out"]


def test_what_the_physics_needs_refuses_the_flight() -> None:
    assembly, stamps = Assembly(), 0.01 * np.arange(100)
    assembly.add("rotor_command", stamps, np.ones((100, 4)), "motors")
    assembly.add("attitude", stamps[::-1], np.tile(IDENTITY, (100, 1)), "pose")
    with pytest.raises(DataError, match=r"attitude \(pose\): the time stamps go back"):
        assembly.finish()


@pytest.mark.parametrize(
    "change",
    [
        lambda line, row: f"{line},{'battery_voltage' if row == 0 else 'full'}",
        lambda line, row: f"{line},{'position_setpoint_x' if row == 0 else '1.0'}",  # without y and z
        lambda line, row: f"{line},{'battery_voltage,battery_voltage' if row == 0 else '7.4,7.4'}",
    ],
)
def test_a_secondary_column_refuses_no_table(change: Callable[[str, int], str], truth: Truth, tmp_path: Path) -> None:
    path = flight_csv(truth, tmp_path / "flight.csv")
    path.write_text("\n".join(change(line, row) for row, line in enumerate(path.read_text().splitlines())) + "\n")
    log = read_log(path)
    assert {repair.name for repair in log.provenance.repairs} == {"stream_left_out"}
    assert not {"battery_voltage", "position_setpoint"} & set(log.names)
    position = log.stream("position")
    assert position is not None
    assert_allclose(position.values, truth.position)
