"""Thrust becomes the right 0..1, and a planted effectiveness is estimated despite lag, noise and a sagging battery."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dynamics import quaternion
from dynamics.vehicle import GRAVITY
from runtime.flight.thrust import (
    MAX_FILE_ERROR,
    EffectivenessEstimator,
    ThrustMap,
    curve,
    curve_inverse,
    specific_force_z,
)

MASS = 0.25
MAP = ThrustMap(thrust_max=4.84, vehicle_curve=1.0, autopilot_curve=0.3)


@given(st.floats(0, 1), st.floats(0, 1))
def test_curve_and_inverse_agree(signal: float, factor: float) -> None:
    assert curve_inverse(curve(signal, factor), factor) == pytest.approx(signal, abs=1e-6)


@given(st.floats(0, 4.8), st.floats(0, 1), st.floats(0, 1), st.floats(1.0, 1.8))
def test_the_map_and_its_inverse_agree(thrust: float, vehicle: float, autopilot: float, effectiveness: float) -> None:
    thrust_map = ThrustMap(4.84, vehicle, autopilot)
    setpoint = thrust_map.setpoint(thrust, effectiveness)
    assert 0.0 <= setpoint <= 1.0
    assert thrust_map.collective_thrust(setpoint, effectiveness) == pytest.approx(thrust, abs=1e-5)


def test_the_autopilot_s_curve_is_undone_before_the_vehicle_s_is_applied() -> None:
    thrust_map = ThrustMap(10.0, vehicle_curve=1.0, autopilot_curve=0.0)
    # a quarter of the thrust needs half the signal on a quadratic vehicle
    assert thrust_map.setpoint(2.5) == pytest.approx(0.5)
    # PX4's SIH: thrust follows the signal, f = 0, hover of 1 kg on 20 N is half
    assert ThrustMap(20.0, 0.0, 0.0).setpoint(GRAVITY) == pytest.approx(0.4905)
    # equal curves cancel
    assert ThrustMap(10.0, 0.4, 0.4).setpoint(2.5) == pytest.approx(0.25)


def test_specific_force_from_velocities_is_gravity_in_hover_and_is_taken_along_body_z() -> None:
    still = np.zeros(3)
    assert specific_force_z(still, still, 0.1, quaternion.IDENTITY) == pytest.approx(GRAVITY)
    tilted = quaternion.from_euler(0.4, 0.0, 0.0)
    force = quaternion.rotate(tilted, [0.0, 0.0, 12.0])
    after = (force - np.array([0.0, 0.0, GRAVITY])) * 0.1
    assert specific_force_z(still, after, 0.1, tilted) == pytest.approx(12.0)


def estimate(
    truth: Callable[[float], float],
    *,
    duration: float = 20.0,
    lag: float = 0.05,
    noise: float = 1.0,
    start: float = 1.0,
) -> tuple[EffectivenessEstimator, list[float]]:
    """Fly a plant of planted effectiveness (first-order lag, 20 ms delay) at changing thrust; errors per tick."""
    rng = np.random.default_rng(5)
    estimator = EffectivenessEstimator(MASS)
    estimator.start(start)
    delayed = [MASS * GRAVITY] * 2
    force = MASS * GRAVITY
    errors = []
    for tick in range(int(duration * 100)):
        time = tick * 0.01
        commanded = MASS * GRAVITY * (1 + 0.3 * np.sin(3 * time) * (time % 4 > 2))
        setpoint = MAP.setpoint(commanded, estimator.value)
        delayed.append(MAP.collective_thrust(setpoint))
        force += (delayed.pop(0) - force) * (1 - np.exp(-0.01 / lag))
        estimator.command(MAP.collective_thrust(setpoint), time)
        estimator.measure(truth(time) * force / MASS + noise * rng.normal(), time + 0.01)
        errors.append(estimator.value - truth(time))
    return estimator, errors


@pytest.mark.parametrize("truth", [0.6, 0.8, 1.0, 1.25])
def test_a_wrong_mass_or_constant_is_recovered(truth: float) -> None:
    _, errors = estimate(lambda time: truth)
    assert np.max(np.abs(errors[200:])) < 0.06
    assert abs(np.mean(errors[500:])) < 0.01


def test_a_sagging_battery_is_followed() -> None:
    _, errors = estimate(lambda time: 1.0 - 0.015 * time)
    assert np.max(np.abs(errors[200:])) < 0.06


def test_a_response_twice_as_slow_as_modelled_leaves_the_mean_right() -> None:
    _, errors = estimate(lambda time: 0.85, lag=0.1)
    assert abs(np.mean(errors[500:])) < 0.02


def test_heavy_noise_is_averaged_out() -> None:
    _, errors = estimate(lambda time: 0.9, noise=4.0)
    assert np.max(np.abs(errors[500:])) < 0.1


def test_shocks_are_gated_and_change_nothing() -> None:
    estimator, _ = estimate(lambda time: 0.9)
    before = estimator.value
    for tick in range(20):
        time = 20.0 + tick * 0.01
        estimator.command(MASS * GRAVITY, time)
        assert not estimator.measure(60.0, time)
    assert estimator.value == before
    assert estimator.rejected >= 20


def test_what_was_estimated_before_the_setpoints_were_ignored_is_kept() -> None:
    estimator, _ = estimate(lambda time: 0.9)
    for tick in range(100):  # another mode holds the vehicle, and no HEARTBEAT shows it yet
        time = 20.0 + tick * 0.01
        estimator.command(0.6 * MASS * GRAVITY, time)
        estimator.measure(GRAVITY, time)
    assert estimator.value > 1.1
    assert estimator.earlier(1.5) == pytest.approx(0.9, abs=0.03)
    assert EffectivenessEstimator(MASS).earlier(1.5) == 1.0


def test_a_lasting_contradiction_is_accepted_in_the_end() -> None:
    estimator, _ = estimate(lambda time: 1.0)
    for tick in range(600):
        time = 20.0 + tick * 0.01
        estimator.command(MASS * GRAVITY, time)
        estimator.measure(0.55 * GRAVITY, time)
    assert estimator.value == pytest.approx(0.55, abs=0.05)


@given(st.lists(st.one_of(st.floats(allow_nan=True, allow_infinity=True), st.floats(-50, 50)), max_size=50))
def test_no_measurement_drives_it_out_of_its_bounds(measurements: list[float]) -> None:
    estimator = EffectivenessEstimator(MASS)
    for tick, measurement in enumerate(measurements):
        estimator.command(MASS * GRAVITY, tick * 0.01)
        estimator.measure(measurement, tick * 0.01)
        assert 0.4 <= estimator.value <= MAX_FILE_ERROR
        assert np.isfinite(estimator.variance)
