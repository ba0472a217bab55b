"""A planted clock is recovered (offset, drift, jitter), implausible samples are rejected, a reboot is noticed."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fixtures.vehicle_clock import PERIOD, Exchange, simulator_clock
from runtime.link.clock import VehicleClock

FOLDER = Path(__file__).parents[2] / "data" / "px4_sih_flights"
RECORDED = ("nothing_1_circle", "drag2_4_lemniscate", "tipped_44deg", "crash_circle")
QUIET = {"accepted", "slow", "outlier", "stepped"}


def linear(offset: float, drift: float) -> Callable[[float], float]:
    return lambda ours: ours + offset + drift * (ours - 100.0)


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


@pytest.mark.parametrize("drift", [-0.012, 0.0, 0.012])
@pytest.mark.parametrize("round_trip", [0.0006, 0.006])
@pytest.mark.parametrize("quantum", [1e-6, 4e-3])
def test_a_simulator_s_clock_is_followed_without_a_jump(drift: float, round_trip: float, quantum: float) -> None:
    vehicle = simulator_clock(round(1e3 * drift) + 100, drift, quantum)
    exchange, errors = Exchange(round_trip), []
    exchange.run(1.0, vehicle)
    while exchange.now < 155.0:
        exchange.run(PERIOD, vehicle)
        assert exchange.clock.is_valid(exchange.now)
        errors.append(exchange.error(vehicle))
    assert set(exchange.verdicts) <= QUIET
    assert np.median(errors) < 2.5e-3
    assert np.percentile(errors, 95) < 0.01
    assert exchange.clock.resets == 0


@pytest.mark.parametrize("name", RECORDED)
def test_px4_s_recorded_clock_is_followed_without_a_jump(name: str) -> None:
    with np.load(FOLDER / "clocks.npz") as data:
        ours, vehicle = 100.0 + data[f"{name}_ours_usec"] * 1e-6, 50.0 + data[f"{name}_vehicle_msec"] * 1e-3
    clock, errors = VehicleClock(), []
    for received, stamp in zip(ours.tolist(), vehicle.tolist(), strict=True):
        assert clock.handle(received - 6e-4, received, stamp) in QUIET
        if received > 101.0:
            assert clock.is_valid(received)
            errors.append(abs(clock.to_vehicle(received) - stamp))
    assert clock.resets == 0
    assert np.percentile(errors, 95) < 6e-3  # of which 4 ms are the steps that the clock counts in


@pytest.mark.parametrize("jump", [-0.5, 0.1, 1.0])
def test_a_true_jump_is_noticed_on_a_simulator_s_clock(jump: float) -> None:
    exchange, vehicle = Exchange(0.0006), simulator_clock(1, -0.01, 4e-3)
    exchange.run(30.0, vehicle)
    assert set(exchange.verdicts) <= QUIET
    exchange.run(1.0, lambda ours: vehicle(ours) + jump)
    assert {"jumped", "ran_backwards"} & set(exchange.verdicts)
    assert exchange.error(lambda ours: vehicle(ours) + jump) < 0.01


def test_an_asymmetric_delay_shifts_the_clock_and_disturbs_nothing_else() -> None:
    exchange, vehicle = Exchange(0.0006), simulator_clock(2, -0.01, 4e-3)
    exchange.run(10.0, vehicle)
    exchange.run(20.0, lambda ours: vehicle(ours - 0.008))
    assert set(exchange.verdicts) <= QUIET
    assert exchange.clock.is_valid(exchange.now)
