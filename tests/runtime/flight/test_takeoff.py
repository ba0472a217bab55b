"""Vehicles of any weight lift off without a leap, the controller takes over without a step, landings are detected."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from dynamics.vehicle import GRAVITY
from runtime.flight.takeoff import HandOver, LandingDetector, TakeoffRamp

WEIGHT = 0.25 * GRAVITY


def lift_off(
    effectiveness: float, *, lag: float = 0.08, drift: float = 0.0, inertial: bool = False
) -> tuple[TakeoffRamp, float, float]:
    """A vehicle on the ground whose thrust is so many times the modelled one; its height and climb rate at the end.

    drift: of the estimate, m/s. inertial: whether a noisy accelerometer is measured.
    """
    ramp = TakeoffRamp(WEIGHT, 4.8)
    rng = np.random.default_rng(3)
    height, climb, force = 0.0, 0.0, 0.0
    for tick in range(1000):
        felt = max(force / WEIGHT, 1.0) * GRAVITY + 1.4 * rng.normal() if inertial else np.nan
        estimate = (height + drift * tick * 0.01 + 0.005 * rng.normal(), climb + drift + 0.03 * rng.normal())
        thrust = ramp.update(tick * 0.01, *estimate, felt)
        if ramp.lifted or ramp.failed:
            break
        force += (effectiveness * thrust - force) * 0.01 / lag
        climb = max(climb + (force / WEIGHT - 1) * GRAVITY * 0.01, 0.0 if height <= 0 else -9.0)
        height = max(height + climb * 0.01, 0.0)
    return ramp, height, climb


@pytest.mark.parametrize("effectiveness", [0.7, 0.85, 1.0, 1.3])
def test_vehicles_lighter_or_heavier_than_modelled_lift_off_gently(effectiveness: float) -> None:
    ramp, height, climb = lift_off(effectiveness)
    assert ramp.lifted
    assert height < 0.3
    assert climb < 0.8
    assert ramp.effectiveness == pytest.approx(effectiveness, rel=0.15)


def test_an_estimate_that_sinks_at_rest_does_not_hide_the_lift_off() -> None:
    """By 0.3 m while thrust rises, as PX4's at times: the ground is at the lowest height, not the first."""
    ramp, height, climb = lift_off(1.0, drift=-0.2, inertial=True)
    assert ramp.lifted
    assert height < 0.3
    assert climb < 0.9


def test_a_vehicle_that_cannot_lift_off_is_given_up() -> None:
    ramp, height, _ = lift_off(0.4)
    assert ramp.failed
    assert not ramp.lifted
    assert height == 0.0


def with_gravity_alone(climb_rate: Callable[[int], float]) -> TakeoffRamp:
    """The end of a ramp whose accelerometer shows gravity and noise. climb_rate: of the estimate at a tick, m/s."""
    ramp = TakeoffRamp(WEIGHT, 4.8)
    rng = np.random.default_rng(3)
    height = 0.0
    for tick in range(1000):
        height += 0.01 * climb_rate(tick)
        estimate = (height + 0.005 * rng.normal(), climb_rate(tick) + 0.03 * rng.normal())
        ramp.update(0.01 * tick, *estimate, GRAVITY + 1.4 * rng.normal())
        if ramp.lifted or ramp.failed:
            break
    return ramp


def test_thrust_does_not_end_under_a_vehicle_that_climbs() -> None:
    """One that the greatest thrust of a take-off hardly lifts: its accelerometer shows little beside its noise.

    It climbs at 1 m/s, where drag takes the rest of the excess: gravity alone is felt, as on the ground.
    """
    ramp = with_gravity_alone(lambda tick: 1.0 if tick > 320 else 0.0)
    assert ramp.lifted
    assert 0.5 < ramp.effectiveness < 0.8


def test_an_estimate_that_drifts_up_for_a_while_is_no_lift_off_at_the_greatest_thrust() -> None:
    ramp = with_gravity_alone(lambda tick: 0.25 if tick % 100 < 70 else -0.1)
    assert ramp.failed


def test_thrust_never_steps_on_the_ground() -> None:
    ramp = TakeoffRamp(WEIGHT, 4.8)
    thrusts = [ramp.update(tick * 0.01, 0.0, 0.0) for tick in range(300)]
    assert thrusts[0] <= 0.1 * WEIGHT
    assert np.max(np.diff(thrusts)) < 0.01 * WEIGHT


def test_a_noisy_height_alone_is_no_lift_off() -> None:
    ramp = TakeoffRamp(WEIGHT, 4.8)
    rng = np.random.default_rng(1)
    for tick in range(100):
        ramp.update(tick * 0.01, 0.1 * rng.normal(), 0.05 * rng.normal())
    assert not ramp.lifted


def test_the_controller_takes_over_without_a_step() -> None:
    hand_over = HandOver(started=1.0, collective_thrust=2.0)
    thrusts = [hand_over.blend(3.0, 1.0 + 0.01 * tick) for tick in range(60)]
    assert thrusts[0] == 2.0
    assert thrusts[-1] == 3.0
    assert np.max(np.abs(np.diff(thrusts))) < 0.05


def test_landing_is_detected_by_stillness_at_low_thrust_or_reported_by_the_vehicle() -> None:
    detector = LandingDetector(WEIGHT)
    flying = [detector.update(t * 0.01, -0.5, 0.9 * WEIGHT, reported_landed=False) for t in range(100)]
    assert not any(flying)
    hovering = [detector.update(1 + t * 0.01, 0.0, WEIGHT, reported_landed=False) for t in range(100)]
    assert not any(hovering)
    standing = [detector.update(2 + t * 0.01, 0.0, 0.4 * WEIGHT, reported_landed=False) for t in range(100)]
    assert standing.index(True) == pytest.approx(50, abs=2)
    assert LandingDetector(WEIGHT).update(0.0, 0.0, WEIGHT, reported_landed=True)


def test_an_estimate_that_climbs_at_rest_is_no_lift_off_while_the_accelerometer_shows_rest() -> None:
    ramp = TakeoffRamp(WEIGHT, 4.8)
    rng = np.random.default_rng(2)
    for tick in range(250):
        ramp.update(tick * 0.01, 0.004 * tick, 0.4, GRAVITY + 1.4 * rng.normal())
        assert not ramp.lifted
    assert ramp.collective_thrust > 1.5 * WEIGHT


@pytest.mark.parametrize("effectiveness", [0.8, 1.0, 1.25])
@pytest.mark.parametrize("drift", [0.0, 0.35])
def test_an_estimate_that_drifts_upward_at_rest_does_not_falsify_the_effectiveness(
    effectiveness: float, drift: float
) -> None:
    ramp, _, climb = lift_off(effectiveness, drift=drift, inertial=True)
    assert ramp.lifted
    assert climb < 1.0
    assert ramp.effectiveness == pytest.approx(effectiveness, rel=0.2)
