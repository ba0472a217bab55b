"""One flight, written in many formats, reads as itself from each of them."""

from __future__ import annotations

import gzip
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose
from rosbags.rosbag2 import StoragePlugin

from dynamics import quaternion
from flights import Flight, read_log
from flights.log import Log
from tests.support.flight_files import (
    Truth,
    crazyflie_log,
    dataflash_log,
    flight_csv,
    manoeuvre,
    paper_bag,
    ros2_bag,
    tlog,
)


@pytest.fixture(scope="module")
def truth() -> Truth:
    return manoeuvre()


def _assert_equal(log: Log, truth: Truth, names: tuple[str, ...], tolerance: float = 2e-5) -> None:
    for name in names:
        stream = log.stream(name)
        assert stream is not None, f"{name} is missing: {log.names}, {log.provenance.notes}"
        assert_allclose(stream.time - stream.time[0], truth.time, atol=1e-6, err_msg=name)
        expected = getattr(truth, name)
        if name == "attitude":
            assert quaternion.angle_between(stream.values, expected).max() < 10 * tolerance
        else:
            assert_allclose(stream.values, expected, rtol=1e-6, atol=tolerance * max(1.0, np.abs(expected).max()))


MOTION = ("position", "velocity", "attitude", "rate", "specific_force")


def test_a_flight_csv(truth: Truth, tmp_path: Path) -> None:
    log = read_log(flight_csv(truth, tmp_path / "named_wrongly.bin"))
    assert log.provenance.format == "flight CSV"
    assert not log.provenance.repairs
    _assert_equal(log, truth, (*MOTION, "rotor_speed"))


def test_the_papers_bag(truth: Truth, tmp_path: Path) -> None:
    log = read_log(paper_bag(truth, tmp_path / "Ellipse_1.bag"))
    assert log.metadata["data_set"] == "PI-TCN"
    _assert_equal(log, truth, (*MOTION, "rotor_speed"))


def test_a_bag_is_recognised_by_its_content(truth: Truth, tmp_path: Path) -> None:
    bag = paper_bag(truth, tmp_path / "a.bag")
    packed = tmp_path / "flight.dat"
    packed.write_bytes(gzip.compress(bag.read_bytes(), 1))
    _assert_equal(read_log(packed), truth, MOTION)


@pytest.mark.parametrize("storage", [StoragePlugin.SQLITE3, StoragePlugin.MCAP])
@pytest.mark.parametrize("body_velocity", [True, False])
def test_a_ros2_bag_with_its_velocity_in_either_frame(
    truth: Truth, tmp_path: Path, body_velocity: bool, storage: StoragePlugin
) -> None:
    folder = ros2_bag(truth, tmp_path / "bag", body_velocity=body_velocity, storage=storage)
    log = read_log(folder)
    assert any("measured" in note for note in log.provenance.notes)
    _assert_equal(log, truth, MOTION)
    single = next(file for file in folder.iterdir() if file.suffix != ".yaml")
    assert single.rename(tmp_path / "storage_alone").exists()
    _assert_equal(read_log(tmp_path / "storage_alone"), truth, MOTION)


def test_an_ardupilot_log(truth: Truth, tmp_path: Path) -> None:
    path = tmp_path / "00000001.BIN"
    path.write_bytes(dataflash_log(truth))
    log = read_log(path)
    _assert_equal(log, truth, (*MOTION, "rotor_speed"))
    assert log.parameters["FRAME_CLASS"] == 1


@pytest.mark.parametrize("body_velocity", [True, False])
def test_a_tlog_with_its_velocity_in_either_frame(truth: Truth, tmp_path: Path, body_velocity: bool) -> None:
    path = tmp_path / "flight.tlog"
    path.write_bytes(tlog(truth, body_velocity=body_velocity))
    log = read_log(path)
    _assert_equal(log, truth, MOTION)
    assert log.start == pytest.approx(7.0)


@pytest.mark.parametrize("version", [1, 2])
def test_a_crazyflie_log_of_both_versions(truth: Truth, tmp_path: Path, version: int) -> None:
    variables = [
        *((f"stateEstimateZ.{name}", "h") for name in ("x", "y", "z", "vx", "vy", "vz")),
        *((f"stateEstimate.q{part}", "f") for part in "xyzw"),
        *((f"gyro.{axis}", "f") for axis in "xyz"),
        *((f"acc.{axis}", "f") for axis in "xyz"),
        *((f"motor.m{motor}", "H") for motor in (1, 2, 3, 4)),
    ]
    rows = []
    for i, t in enumerate(truth.time):
        xyzw = np.roll(truth.attitude[i], -1)
        numbers = (
            *(round(1000 * value) for value in (*truth.position[i], *truth.velocity[i])),
            *xyzw,
            *np.degrees(truth.rate[i]),
            *truth.specific_force[i] / 9.81,
            1000,
            2000,
            3000,
            4000,
        )
        rows.append((round(t * {1: 1e3, 2: 1e6}[version]), numbers))
    path = tmp_path / "log00"
    path.write_bytes(crazyflie_log(variables, rows, version=version))
    log = read_log(path)
    assert not log.provenance.repairs
    _assert_equal(log, truth, ("attitude", "rate", "specific_force"))
    _assert_equal(log, truth, ("position", "velocity"), tolerance=6e-4)
    command = log.stream("rotor_command")
    assert command is not None
    # motor 4 stands front left, where our rotor 0 is
    assert_allclose(command.values[0], np.array([4000, 3000, 2000, 1000]) / 65_535)


def test_crazyflie_packs_its_attitude_and_turns_its_pitch_rate(truth: Truth, tmp_path: Path) -> None:
    """stateEstimateZ: the attitude in 32 bits, the largest component left out; rates in mrad/s, pitch negated."""
    rows = []
    for t, attitude, rate in zip(truth.time, truth.attitude, 1000 * truth.rate, strict=True):
        xyzw = np.roll(attitude, -1)
        largest = int(np.argmax(np.abs(xyzw)))
        word = largest
        for index in range(4):
            if index != largest:
                negative = (xyzw[index] < 0) != (xyzw[largest] < 0)
                word = word << 10 | negative << 9 | round(511 * abs(xyzw[index]) * np.sqrt(2.0))
        rows.append((round(t * 1e6), (word, round(rate[0]), round(-rate[1]), round(rate[2]))))
    names = ("quat", "I"), ("rateRoll", "h"), ("ratePitch", "h"), ("rateYaw", "h")
    data = crazyflie_log([(f"stateEstimateZ.{name}", letter) for name, letter in names], rows)
    (tmp_path / "log").write_bytes(data)
    log = read_log(tmp_path / "log")
    _assert_equal(log, truth, ("rate",), tolerance=6e-4)
    attitude_stream = log.stream("attitude")
    assert attitude_stream is not None
    assert quaternion.angle_between(attitude_stream.values, truth.attitude).max() < 5e-3


def test_a_flight_joins_the_streams_on_the_gyros_clock(truth: Truth, tmp_path: Path) -> None:
    flight = Flight.read(paper_bag(truth, tmp_path / "a.bag"))
    assert flight.rate == pytest.approx(100.0)
    assert flight.has(*MOTION, "rotor_speed")
    assert flight.unit("rotor_speed") == "rad/s"
    assert flight.frame("velocity_x") == "world ENU"
    assert_allclose(flight["velocity"], truth.velocity, atol=2e-5)
    assert flight.origins["rotor_speed"].source == "/dragonfly17/motor_rpm"
