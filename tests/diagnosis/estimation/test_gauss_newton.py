"""Gauss-Newton's steps end at a minimum, and damped ones lead to it where they do not go straight."""

import numpy as np
import pytest

from diagnosis.estimation.gauss_newton import Step, settle, settle_from_afar
from diagnosis.thresholds import DEFAULT


class Bump:
    """One parameter x of the model 1/(1 + x^2), measured as 0.5: far from 1 the slope is small, and steps are huge."""

    thresholds = DEFAULT.equation_error

    def step(self, values):
        (x,) = values
        slope, residual = -2 * x / (1 + x**2) ** 2, 0.5 - 1 / (1 + x**2)
        return Step(np.array([residual / slope]), np.eye(1) / slope**2, np.eye(1) * slope**2, residual**2)

    def bounded(self, values, step):
        return np.clip(values + step, -1e6, 1e6)

    def at_bounds(self, values):
        return np.abs(values) >= 1e6


def test_a_fit_that_begins_far_off_gets_there_by_damped_steps():
    start = np.array([15.0])
    assert abs(settle(Bump(), start).values[0]) > 2.0
    ended = settle_from_afar(Bump(), start)
    assert abs(ended.values[0]) == pytest.approx(1.0, abs=1e-3)
    assert ended.last.cost < 1e-6
    assert abs(ended.left[0]) < 0.01


def test_a_fit_that_goes_straight_is_left_as_it_is():
    start = np.array([0.9])
    assert settle(Bump(), start).is_straight
    assert settle_from_afar(Bump(), start).values == settle(Bump(), start).values


def test_a_fit_that_leaves_far_more_than_what_it_is_compared_with_is_not_made_again():
    start = np.array([15.0])
    first = settle(Bump(), start)
    hopeless, hoped = (settle_from_afar(Bump(), start, hopeless=share * first.last.cost) for share in (0.9, 1.1))
    assert hopeless.values == first.values
    assert abs(hoped.values[0]) == pytest.approx(1.0, abs=1e-3)


class Valley:
    """A model that ends at x = 0 with a cost of 2, and whose steps there lead to and fro: nothing is measured of y."""

    thresholds = DEFAULT.equation_error

    def __init__(self):
        self.steps = 0

    def step(self, values):
        x, _ = values
        self.steps += 1
        return Step(np.array([-x, 5.0 * (-1) ** self.steps]), np.eye(2), np.eye(2), 2.0 + x**2)

    def bounded(self, values, step):
        return values + step

    def at_bounds(self, values):
        return np.zeros(2, dtype=bool)


@pytest.mark.parametrize(("goal", "steps"), [(np.inf, 2 * 9), (2.5, 2 * 9), (1.9, 4)])
def test_a_fit_that_stops_short_of_its_goal_is_left_there(goal, steps):
    valley = Valley()
    ended = settle_from_afar(valley, np.array([1.0, 0.0]), goal=goal)
    assert ended.values[0] == pytest.approx(0.0)
    assert ended.is_short == (goal < 2.0)
    assert valley.steps == pytest.approx(steps, abs=3)  # and the damped ones between two attempts


def test_a_fit_goes_over_a_rise_to_its_goal():
    class Rise(Valley):
        costs = (4.0, 3.99, 2.0, 1.0)

        def step(self, values):
            place = min(int(values[0]), 3)
            return Step(np.array([float(place < 3), 0.0]), np.eye(2), np.eye(2), self.costs[place])

    ended = settle_from_afar(Rise(), np.zeros(2), goal=1.5)
    assert ended.last.cost == 1.0
    assert not ended.is_short
