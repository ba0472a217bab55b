"""Planted delays between streams are found with an interval that holds them, and taken off again."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from flights.delays import Delay, estimate_delays, removable, remove_delays
from flights.exclusion import Exclusion
from flights.log import Log, Provenance, Stream
from tests.support.simulated_flight import flown, without

PLANTED = {"attitude": 0.031, "velocity": 0.067, "position": 0.012, "rotor_speed": 0.048}
SAMPLE_MIDDLE = 0.0005  # s from the stamp to the middle of the milliseconds that an inertial or rotor sample averages


def late(log: Log, planted: dict[str, float]) -> Log:
    random = np.random.default_rng(8)
    streams = []
    for stream in log.streams:
        averaged = stream.source == "imu" or stream.name == "rotor_speed"
        delay = planted.get(stream.name, 0.0) + (SAMPLE_MIDDLE if averaged else 0.0)
        jitter = 0.0003 * random.standard_normal(len(stream.time)).clip(-3, 3)
        streams.append(Stream(stream.name, stream.time + delay + jitter, stream.values, stream.source))
    return replace(log, streams=tuple(streams))


@pytest.fixture(scope="module")
def estimates() -> dict[str, Delay]:
    return {delay.stream: delay for delay in estimate_delays(late(flown().log, PLANTED)) if not delay.is_response}


@pytest.mark.parametrize("name", ["attitude", "velocity", "position", "rotor_speed"])
def test_a_planted_delay_is_found_within_its_interval(estimates: dict[str, Delay], name: str) -> None:
    planted = PLANTED[name] - (PLANTED["velocity"] if name == "position" else 0.0)
    assert estimates[name].seconds == pytest.approx(planted, abs=0.003)
    assert estimates[name].low <= planted <= estimates[name].high
    assert estimates[name].is_known


def test_a_commands_lag_is_a_response_and_no_delay() -> None:
    estimates = estimate_delays(late(flown().log, PLANTED))
    (lag,) = [
        delay
        for delay in estimates
        if delay.stream == "rotor_command" and delay.against == "thrust" and delay.kind == "lag"
    ]
    assert lag.is_response
    assert lag.seconds == pytest.approx(0.041, abs=0.004)  # planted: 35 ms of motor lag and 6 ms of the autopilot
    assert lag.explained > 0.98
    assert "rotor_command" not in removable(estimates)


@pytest.mark.parametrize(("kind", "other"), [("lag", "delay"), ("delay", "lag")])
def test_a_lag_and_a_pure_delay_are_distinguished(kind: str, other: str) -> None:
    rate, planted = 1000.0, 0.06
    time = np.arange(0.0, 40.0, 1 / rate)
    random = np.random.default_rng(5)
    command = np.interp(time, np.arange(0.0, 40.1, 0.1), random.uniform(0.3, 0.9, 401))
    if kind == "lag":
        keep = np.exp(-1 / rate / planted)
        speed = lfilter([0, 1 - keep], [1, -keep], command - command[0]) + command[0]
    else:
        speed = np.interp(time - planted, time, command)
    thrust = 4.0 + 3.0 * speed + 12.0 * speed**2 + random.normal(0, 0.1, len(time))
    force = np.stack([0 * time, 0 * time, thrust], axis=1)
    streams = (
        Stream("rate", time, random.normal(0, 0.01, (len(time), 3)), "gyro"),
        Stream("specific_force", time, force, ""),
        Stream("rotor_command", time, np.tile(command[:, None], 4), "motors"),
    )
    estimates = {
        delay.kind: delay
        for delay in estimate_delays(Log(streams, Provenance("planted", "", "", "")))
        if delay.against == "thrust"
    }
    assert estimates[kind].seconds == pytest.approx(planted, abs=0.001)
    assert estimates[kind].explained > estimates[other].explained


def test_what_was_found_is_taken_off_the_stamps(estimates: dict[str, Delay]) -> None:
    log = late(flown().log, PLANTED)
    mended = remove_delays(log, tuple(estimates.values()))
    for delay in estimate_delays(mended):
        if not delay.is_response:
            assert abs(delay.seconds) < 0.001, delay
    for stream in mended.streams:
        original = flown().log.stream(stream.name)
        assert original is not None
        assert np.median(stream.time - original.time) == pytest.approx(0.0, abs=0.003)


def test_excluded_segments_are_not_compared() -> None:
    log = flown().log
    all_of_it = estimate_delays(log)
    half = estimate_delays(log, exclusions=[Exclusion("crash", 10.0, 100.0, "")])
    assert {delay.stream for delay in half} <= {delay.stream for delay in all_of_it}
    assert all(delay.seconds_compared <= 10.0 for delay in half)


def test_without_a_gyro_nothing_is_claimed() -> None:
    assert estimate_delays(without(flown().log, "rate")) == ()


def test_a_short_log_claims_nothing() -> None:
    log = flown().log
    short = replace(log, streams=tuple(Stream(s.name, s.time[:300], s.values[:300], s.source) for s in log.streams))
    assert estimate_delays(short) == ()


def test_rotors_logged_at_10_hz_claim_nothing() -> None:
    log = flown().log
    slow = replace(
        log,
        streams=tuple(
            Stream(s.name, s.time[::10], s.values[::10], s.source) if s.name.startswith("rotor") else s
            for s in log.streams
        ),
    )
    assert not {delay.stream for delay in estimate_delays(slow)} & {"rotor_speed", "rotor_command"}


def test_position_is_late_by_way_of_velocity() -> None:
    delays = [
        Delay("velocity", "specific_force", 0.02, 0.001, 0.018, 0.022, "clock", 20.0, 0.9),
        Delay("position", "velocity", 0.01, 0.001, 0.008, 0.012, "clock", 20.0, 0.9),
        Delay("attitude", "rate", 0.5, 0.1, 0.3, 0.7, "clock", 20.0, 0.9),
    ]
    assert removable(delays) == {"velocity": 0.02, "position": pytest.approx(0.03)}
