"""A planted clock is recovered (offset, drift, jitter), implausible samples are rejected, a reboot is noticed."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from runtime.link.clock import VehicleClock, Verdict

PERIOD = 0.1


def linear(offset: float, drift: float) -> Callable[[float], float]:
    return lambda ours: ours + offset + drift * (ours - 100.0)


class Exchange:
    """TIMESYNC at 10 Hz from ours = 100 s on, over a path with random delays both ways."""

    def __init__(self, round_trip: float, seed: int = 0) -> None:
        self.clock, self.now = VehicleClock(), 100.0
        self.verdicts: list[Verdict] = []
        self._random, self._round_trip = np.random.default_rng(seed), round_trip

    def run(self, seconds: float, vehicle: Callable[[float], float], *, delay: float = 0.0) -> None:
        for _ in range(round(seconds / PERIOD)):
            there, back = self._random.exponential(self._round_trip / 4, 2) + self._round_trip / 4
            answered = self.now + there + delay
            self.verdicts.append(self.clock.handle(self.now, answered + back, vehicle(answered)))
            self.now += PERIOD

    def error(self, vehicle: Callable[[float], float]) -> float:
        return abs(self.clock.to_ours(vehicle(self.now)) - self.now)


@settings(max_examples=60)
@given(
    offset=st.floats(-1e6, 1e6),
    drift=st.floats(-0.01, 0.01),
    round_trip=st.floats(1e-4, 0.02),
    seed=st.integers(0, 1000),
)
def test_offset_and_drift_are_recovered(offset: float, drift: float, round_trip: float, seed: int) -> None:
    exchange, vehicle = Exchange(round_trip, seed), linear(offset, drift)
    exchange.run(20.0, vehicle)
    assert exchange.clock.is_valid(exchange.now)
    assert exchange.error(vehicle) < round_trip + 2e-4
    assert exchange.clock.drift == pytest.approx(drift, abs=2e-3 + round_trip)
    assert exchange.clock.to_vehicle(exchange.clock.to_ours(1234.5)) == pytest.approx(1234.5, abs=1e-6)


def test_the_stated_uncertainty_covers_the_error() -> None:
    vehicle, errors, stated = linear(50.0, 0.005), [], []
    for seed in range(30):
        exchange = Exchange(0.004, seed)
        exchange.run(10.0, vehicle)
        errors.append(exchange.error(vehicle))
        stated.append(exchange.clock.uncertainty(exchange.now))
    assert np.mean(np.array(errors) < 2 * np.array(stated)) > 0.9
    assert np.mean(stated) < 0.003


def test_a_wandering_clock_is_followed() -> None:
    """Drift that alternates by plus and minus 10 ms per second, as simulators' clocks do."""

    def vehicle(ours: float) -> float:
        return ours + 7.0 + 0.016 * np.sin(2 * np.pi * ours / 10.0)

    exchange, errors = Exchange(0.0005), []
    for _ in range(300):
        exchange.run(PERIOD, vehicle)
        errors.append(exchange.error(vehicle))
    assert max(errors[50:]) < 1.5e-3
    assert set(exchange.verdicts) == {"accepted"}


def test_nothing_is_valid_before_enough_samples_and_after_a_silence() -> None:
    exchange, vehicle = Exchange(0.001), linear(5.0, 0.0)
    exchange.run(0.3, vehicle)
    assert not exchange.clock.is_valid(exchange.now)
    exchange.run(1.0, vehicle)
    assert exchange.clock.is_valid(exchange.now)
    assert not exchange.clock.is_valid(exchange.now + 10.0)


def test_a_slow_round_trip_is_ignored() -> None:
    exchange, vehicle = Exchange(0.001), linear(5.0, 0.001)
    exchange.run(5.0, vehicle)
    exchange.run(PERIOD, vehicle, delay=0.2)
    assert exchange.verdicts[-1] == "slow"
    assert exchange.error(vehicle) < 1e-3


def test_single_outliers_move_nothing() -> None:
    exchange, vehicle = Exchange(0.001), linear(5.0, 0.0)
    exchange.run(5.0, vehicle)
    exchange.run(PERIOD, lambda ours: vehicle(ours) + 0.5)
    assert exchange.verdicts[-1] == "outlier"
    assert exchange.error(vehicle) < 1e-3
    assert exchange.clock.resets == 0


def test_a_lasting_jump_restarts_the_filter_and_is_reported() -> None:
    exchange = Exchange(0.001)
    exchange.run(5.0, linear(5.0, 0.0))
    exchange.run(1.0, linear(9.0, 0.0))
    assert "jumped" in exchange.verdicts
    assert exchange.error(linear(9.0, 0.0)) < 2e-3


def test_a_reboot_restarts_the_filter_at_once() -> None:
    exchange = Exchange(0.001)
    exchange.run(5.0, linear(5000.0, 0.0))
    rebooted = linear(-100.0, 0.0)
    exchange.run(PERIOD, rebooted)
    assert exchange.verdicts[-1] == "ran_backwards"
    assert not exchange.clock.is_valid(exchange.now)
    exchange.run(2.0, rebooted)
    assert exchange.clock.is_valid(exchange.now)
    assert exchange.error(rebooted) < 2e-3


def test_a_clock_that_keeps_running_backwards_is_never_valid() -> None:
    exchange = Exchange(0.001)
    for _ in range(50):
        exchange.run(PERIOD, lambda ours: 5000.0 - ours)
        assert not exchange.clock.is_valid(exchange.now)


def test_answers_out_of_order_are_ignored() -> None:
    clock = VehicleClock()
    assert clock.handle(10.0, 10.001, 50.0) == "accepted"
    assert clock.handle(9.9, 10.002, 49.9) == "out_of_order"
    assert clock.handle(11.0, 10.9, 51.0) == "out_of_order"


def test_without_answers_the_vehicle_s_own_stamps_are_used() -> None:
    clock, random = VehicleClock(), np.random.default_rng(1)
    for n in range(200):
        sent = 100.0 + 0.1 * n
        clock.handle_one_way(sent + random.exponential(0.001), sent + 42.0)
    assert clock.is_valid(120.0)
    assert not clock.is_two_way
    assert clock.to_ours(120.0 + 42.0) == pytest.approx(120.0, abs=4e-3)


def test_stamps_without_a_round_trip_do_not_disturb_answers() -> None:
    exchange, vehicle = Exchange(0.001), linear(5.0, 0.0)
    exchange.run(2.0, vehicle)
    assert exchange.clock.handle_one_way(exchange.now + 0.05, vehicle(exchange.now)) is None


def test_the_first_answer_replaces_stamps_that_came_late() -> None:
    exchange, vehicle = Exchange(0.001), linear(5.0, 0.0)
    for _ in range(20):
        exchange.clock.handle_one_way(exchange.now + 0.03, vehicle(exchange.now))
        exchange.now += PERIOD
    exchange.run(2.0, vehicle)
    assert set(exchange.verdicts) == {"accepted"}
    assert exchange.error(vehicle) < 1e-3
