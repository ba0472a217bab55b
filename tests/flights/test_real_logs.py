"""Real flights read as what they are: signs, frames and sizes that physics and two recordings of one flight fix."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

from dynamics import quaternion
from dynamics.vehicle import GRAVITY
from flights import Flight, Log, Stream, read_log
from flights.alignment import resample

DATA = Path(__file__).parents[1] / "data"


def _stream(log: Log, name: str) -> Stream:
    stream = log.stream(name)
    assert stream is not None, f"{name}: {log.names}"
    return stream


def _tilt_slopes(flight: Flight, gap: float = 0.2) -> list[float]:
    """Slope of horizontal acceleration over the thrust's horizontal part, by axis: 1 with correct frames and units."""
    span = round(gap * flight.rate)
    thrust_direction = GRAVITY * quaternion.rotate(flight["attitude"], np.array([0.0, 0.0, 1.0]))
    acceleration = (flight["velocity"][span:] - flight["velocity"][:-span]) / (span * flight.period)
    mean = np.stack(
        [np.convolve(column, np.full(span + 1, 1 / (span + 1)), "valid") for column in thrust_direction.T], axis=1
    )
    finite = np.isfinite(mean).all(axis=1) & np.isfinite(acceleration).all(axis=1)
    assert finite.mean() > 0.8
    a, b = acceleration[finite, :2], mean[finite, :2]
    b = b - b.mean(axis=0)
    return [float(slope) for slope in np.sum(a * b, axis=0) / np.sum(b * b, axis=0)]


@pytest.fixture(scope="module")
def px4_ulog() -> Log:
    return read_log(DATA / "px4_sih_offboard" / "offboard_hover_topics.ulg.gz")


@pytest.fixture(scope="module")
def px4_tlog() -> Log:
    return read_log(DATA / "px4_sih_offboard" / "offboard_hover.tlog.gz")


def test_ulog_and_tlog_of_one_flight_agree(px4_ulog: Log, px4_tlog: Log) -> None:
    # both clocks are the vehicle's: only their starts differ
    later = px4_tlog.start - px4_ulog.start
    for name, tolerance in (("position", 0.02), ("velocity", 0.05), ("rate", 0.05), ("specific_force", 0.6)):
        received, logged = _stream(px4_tlog, name), _stream(px4_ulog, name)
        difference = resample(logged, received.time + later) - received.values
        assert np.nanmedian(np.linalg.norm(difference, axis=1)) < tolerance, name
        assert np.isfinite(difference).mean() > 0.9
    received, logged = _stream(px4_tlog, "attitude"), _stream(px4_ulog, "attitude")
    there = resample(logged, received.time + later)
    finite = np.isfinite(there).all(axis=1)
    assert np.median(quaternion.angle_between(there[finite], received.values[finite])) < 0.002


def test_px4_stands_upright_and_climbs(px4_ulog: Log) -> None:
    assert_allclose(np.nanmedian(_stream(px4_ulog, "specific_force").values, axis=0), [0, 0, GRAVITY], atol=0.3)
    flight = Flight.from_log(px4_ulog)
    flying = flight["landed"] == 0
    assert np.ptp(flight["position_z"][flying]) > 4.0
    assert np.median(flight["position_z"][flying]) > np.nanmedian(flight["position_z"][~flying]) + 3.0
    assert not px4_ulog.provenance.repairs or {r.name for r in px4_ulog.provenance.repairs} == {"no_attitude"}
    assert px4_ulog.parameters["SDLOG_PROFILE"] == 131
    assert px4_ulog.metadata["vehicle_type"] == "2"


def test_px4_rotors_are_in_our_order(px4_ulog: Log) -> None:
    """More lift on the left rolls right, more lift behind pitches down: torques follow from our rotors' levers."""
    flight = Flight.from_log(px4_ulog)
    flying = (flight["landed"] == 0) & np.isfinite(flight["rotor_command"]).all(axis=1)
    command = flight["rotor_command"]
    assert command.shape[1] == 4
    assert np.median(command[flying]) == pytest.approx(0.5, abs=0.02)
    assert flight.origins["rotor_command"].rate == pytest.approx(10.0, abs=0.1)
    commands, rates = _stream(px4_ulog, "rotor_command"), _stream(px4_ulog, "rate")
    # the change of the rates over the tenth of a second that a command stands; torques by the rotors' levers
    change = resample(rates, commands.time + 0.1) - resample(rates, commands.time)
    levers = np.array([[1, 1, -1, -1], [-1, 1, 1, -1], [1, -1, 1, -1]])
    finite = (commands.time > 9) & (commands.time < 60) & np.isfinite(change).all(axis=1)
    agreement = np.corrcoef((commands.values @ levers.T)[finite].T, change[finite].T)[:3, 3:]
    assert (np.diag(agreement) > [0.4, 0.4, 0.1]).all()
    assert np.abs(agreement - np.diag(np.diag(agreement))).max() < 0.1


def test_px4_segments_begin_with_arming_and_hold_no_reset(px4_ulog: Log) -> None:
    flight = Flight.from_log(px4_ulog)
    segments = flight.segments()
    assert 1 <= len(segments) <= 4
    assert all((segment["armed"] == 1).all() for segment in segments)
    assert max(segment.duration for segment in segments) > 40.0
    for segment in segments:
        assert np.ptp(segment["position_reset_counter"]) == 0


def test_esc_speeds_are_mapped_by_their_function() -> None:
    log = read_log(DATA / "pyulog_samples" / "sample_px4_events.ulg.gz")
    speed = _stream(log, "rotor_speed")
    assert speed.values.shape[1] == 4
    assert speed.rate == pytest.approx(4.0, abs=0.2)
    assert 300 < np.max(speed.values) < 2000
    assert log.start > 1.7e9  # this log counts from 1970


def test_old_and_foreign_firmware_is_read() -> None:
    old = read_log(DATA / "pyulog_samples" / "sample_appended_multiple.ulg.gz")
    assert _stream(old, "rate").source == "sensor_combined"
    assert {stream.source for stream in old.alternatives("rate")} == {"sensor_combined", "vehicle_attitude"}
    assert _stream(old, "armed").values.max() == 0
    assert Flight.from_log(old).segments() == ()
    vtol = read_log(DATA / "pyulog_samples" / "sample_log_small.ulg.gz")
    assert vtol.stream("rotor_command") is None
    outputs = next(str(unused) for unused in vtol.provenance.unused if unused.source == "actuator_outputs[0]")
    assert "move between 900 and 1790" in outputs
    assert "tells neither a multirotor" in outputs


def test_crazyflie_log_and_its_csv_are_one_flight() -> None:
    card = read_log(DATA / "crazyflie" / "log20.gz")
    table = read_log(DATA / "crazyflie" / "log20.csv.gz")
    assert not card.provenance.repairs
    assert table.metadata["mapping"] == "imrc_lee_crazyflie"
    for name in ("position", "velocity", "attitude", "rate", "collective_thrust_command", "position_setpoint"):
        one, other = _stream(card, name), _stream(table, name)
        assert_allclose(one.time, other.time, atol=2e-6)
        assert_allclose(one.values, other.values, rtol=2e-5, atol=2e-6, err_msg=name)


def test_crazyflie_accelerates_where_it_leans() -> None:
    assert _tilt_slopes(Flight.read(DATA / "crazyflie" / "log20.gz")) == pytest.approx([1.0, 1.0], abs=0.06)


def test_crazypad_has_neither_gyro_nor_pitch_and_says_so() -> None:
    log = read_log(DATA / "crazyflie" / "E8_log00.gz")
    assert log.stream("attitude") is None
    assert log.stream("rate") is None
    assert log.stream("pitch") is None
    assert 3.5 < np.median(_stream(log, "battery_voltage").values) < 4.2
    first, second = log.alternatives("rotor_command")
    assert first.source.startswith("motor")
    assert second.source.startswith("pwm")
    assert first.values.max() <= 1.0


def test_x8_log_turns_from_ned_to_enu() -> None:
    flight = Flight.read(DATA / "acsl_x8copter" / "log_20240613_115633_cut.log.gz")
    assert flight.metadata["mapping"] == "acsl_x8copter"
    assert flight["rotor_thrust_command"].shape[1] == 8
    assert flight["rotor_command"].max() <= 1.0
    assert 0.2 < np.median(flight["position_z"]) < 3.0  # NED would have it below the ground
    up = quaternion.rotate(flight["attitude"], np.array([0.0, 0.0, 1.0]))
    assert up[:, 2].min() > 0.8
    assert _tilt_slopes(flight) == pytest.approx([0.7, 0.84], abs=0.1)  # with the drag of a big frame, not -0.7
