"""A heading that does not fit the motion is corrected by its error; a right one stays, whatever the sensors' noise."""

from __future__ import annotations

from math import cos, pi, remainder, sin, tau

import numpy as np
import pytest

from dynamics import quaternion
from dynamics.state import ATTITUDE, VELOCITY
from dynamics.vehicle import GRAVITY
from runtime.flight.consistent_heading import ConsistentHeading
from runtime.flight.events import Event
from runtime.link.estimate import StateEstimate

PERIOD = 0.01  # s
NOISE = 1.7  # m/s^2 of a sample: PX4's in its own simulation, at 100 Hz
UP = np.array([0.0, 0.0, 1.0])
BIAS = np.array([0.15, -0.15, 0.15])  # m/s^2
WANDER = 0.23  # m/s by which its velocity errs


def yaw_of(estimate: StateEstimate) -> float:
    return float(np.asarray(quaternion.to_euler(estimate.attitude)).ravel()[2])


class Motion:
    """A level vehicle at heading 0.3 rad, accelerated along a circle; its estimate is turned by `error`, rad."""

    def __init__(self, seed: int, acceleration: float) -> None:
        self._random, self._acceleration = np.random.default_rng(seed), acceleration
        self._velocity, self._step = np.zeros(3), 0
        self.heading = ConsistentHeading()

    def fly(self, seconds: float, error: float, *, reset: float = 0.0) -> StateEstimate:
        for tick in range(round(seconds / PERIOD)):
            self._step += 1
            angle = 1.5 * self._step * PERIOD
            acceleration = self._acceleration * np.array([cos(angle), sin(angle), 0.0])
            self._velocity = self._velocity + PERIOD * acceleration
            true = np.asarray(quaternion.from_euler(0.0, 0.0, 0.3))
            force = np.asarray(quaternion.rotate_inverse(true, acceleration + GRAVITY * UP))
            force = force + BIAS + NOISE * self._random.standard_normal(3)
            state = np.zeros(13)
            state[ATTITUDE] = quaternion.from_euler(0.0, 0.0, 0.3 + error)
            wander = WANDER * np.array([sin(0.6 * self._step * PERIOD), cos(0.6 * self._step * PERIOD), 0.0])
            state[VELOCITY] = self._velocity + wander
            estimate = StateEstimate(self._step * PERIOD, self._step * PERIOD, state, 0, True, "ODOMETRY")
            corrected = self.heading.correct(estimate, force, moved_yaw=0.0 if tick else reset)
        return corrected


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("error", [1.0, -1.0, 1.6, -2.5, pi])
def test_a_wrong_heading_is_corrected_within_two_seconds_of_motion(error: float, seed: int) -> None:
    motion = Motion(seed, acceleration=2.5)
    motion.fly(3.0, 0.0)
    corrected = motion.fly(2.0, error, reset=error)
    assert abs(remainder(yaw_of(corrected) - 0.3, tau)) < 0.5
    assert Event.HEADING_WRONG in motion.heading.findings()


@pytest.mark.parametrize("seed", range(10))
@pytest.mark.parametrize("acceleration", [0.0, 0.5, 1.0, 3.0])
def test_a_right_heading_stays_as_it_is(acceleration: float, seed: int) -> None:
    motion = Motion(seed, acceleration)
    assert yaw_of(motion.fly(20.0, 0.0)) == pytest.approx(0.3)
    assert yaw_of(motion.fly(5.0, 0.2, reset=0.2)) == pytest.approx(0.5)
    assert not motion.heading.findings()


def test_a_reset_that_mends_the_heading_is_believed() -> None:
    motion = Motion(1, acceleration=2.5)
    motion.fly(0.5, 1.0)
    assert yaw_of(motion.fly(5.0, 0.0, reset=-1.0)) == pytest.approx(0.3)


def test_a_reset_that_takes_the_wrong_one_back_ends_the_correction() -> None:
    motion = Motion(2, acceleration=2.5)
    motion.fly(3.0, 1.0)
    assert motion.heading.findings()
    assert yaw_of(motion.fly(5.0, 0.0, reset=-1.0)) == pytest.approx(0.3)
    assert not motion.heading.findings()


def test_without_an_accelerometer_nothing_is_corrected() -> None:
    heading, state = ConsistentHeading(), np.zeros(13)
    state[ATTITUDE] = [1.0, 0.0, 0.0, 0.0]
    for step in range(300):
        state = state.copy()
        state[VELOCITY] = [3.0 * step * PERIOD, 0.0, 0.0]
        estimate = StateEstimate(step * PERIOD, step * PERIOD, state, 0, True, "ODOMETRY")
        assert heading.correct(estimate, np.full(3, np.nan), moved_yaw=0.0) is estimate
