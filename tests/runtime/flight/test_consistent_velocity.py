"""The velocity's slow errors go, motion and noise stay, and a position that steps is no motion."""

from __future__ import annotations

import numpy as np
import pytest

from dynamics.state import POSITION, VELOCITY
from runtime.flight.consistent_velocity import MAX_CORRECTION, ConsistentVelocity
from runtime.link.estimate import StateEstimate

PERIOD = 0.01  # s


def estimate(time: float, position: np.ndarray, velocity: np.ndarray) -> StateEstimate:
    state = np.zeros(13)
    state[6], state[POSITION], state[VELOCITY] = 1.0, position, velocity
    return StateEstimate(time, time, state, 0, True, "ODOMETRY")


def errors(error: np.ndarray, *, noise: float = 0.0, steps: int = 300) -> np.ndarray:
    """(steps, 3) errors left of the velocity of a vehicle on a circle at 3 m/s, whose estimate errs by `error`."""
    velocity, random, left = ConsistentVelocity(), np.random.default_rng(1), []
    for step in range(steps):
        time = step * PERIOD
        angle = 2.0 * time
        position = 1.5 * np.array([np.cos(angle), np.sin(angle), 0.0]) + noise * random.standard_normal(3)
        true = 3.0 * np.array([-np.sin(angle), np.cos(angle), 0.0])
        corrected = velocity.correct(estimate(time, position, true + error), moved=False)
        left.append(corrected.velocity_world - true)
    return np.array(left)


def test_a_slow_error_of_the_velocity_is_taken_from_the_position_s_slope() -> None:
    left = np.linalg.norm(errors(np.array([0.3, -0.2, 0.1])), axis=1)
    assert left[0] == pytest.approx(0.374, abs=0.01)
    assert left[100:].max() < 0.02


def test_a_true_velocity_stays_as_it_is_and_a_noisy_position_adds_little() -> None:
    assert np.abs(errors(np.zeros(3))).max() < 0.005
    assert np.std(errors(np.zeros(3), noise=0.001)[100:]) < 0.005


def test_a_position_that_steps_is_no_motion() -> None:
    velocity = ConsistentVelocity()
    for step in range(100):
        position = np.array([1.0 if step >= 50 else 0.0, 0.0, 0.0])
        velocity.correct(estimate(step * PERIOD, position, np.zeros(3)), moved=False)
        assert np.linalg.norm(velocity.correction) < 0.1
    velocity.correct(estimate(1.0, np.array([5.0, 0.0, 0.0]), np.zeros(3)), moved=True)
    assert np.linalg.norm(velocity.correction) < 0.1


def test_a_gap_says_nothing_and_the_correction_is_bounded() -> None:
    velocity = ConsistentVelocity()
    velocity.correct(estimate(0.0, np.zeros(3), np.zeros(3)), moved=False)
    velocity.correct(estimate(0.5, np.array([5.0, 0.0, 0.0]), np.zeros(3)), moved=False)
    assert not velocity.correction.any()
    for step in range(200):
        velocity.correct(estimate(0.51 + step * PERIOD, np.array([0.1 * step, 0, 0]), np.zeros(3)), moved=False)
    assert np.linalg.norm(velocity.correction) <= MAX_CORRECTION + 1e-9
