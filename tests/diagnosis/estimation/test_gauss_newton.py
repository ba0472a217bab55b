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
    values, last, left = settle_from_afar(Bump(), start)
    assert abs(values[0]) == pytest.approx(1.0, abs=1e-3)
    assert last.cost < 1e-6
    assert abs(left[0]) < 0.01


def test_a_fit_that_goes_straight_is_left_as_it_is():
    start = np.array([0.9])
    assert settle(Bump(), start).is_straight
    assert settle_from_afar(Bump(), start)[0] == settle(Bump(), start).values


def test_a_fit_that_leaves_far_more_than_what_it_is_compared_with_is_not_made_again():
    start = np.array([15.0])
    first = settle(Bump(), start)
    assert settle_from_afar(Bump(), start, hopeless=0.9 * first.last.cost)[0] == first.values
    assert abs(settle_from_afar(Bump(), start, hopeless=1.1 * first.last.cost)[0][0]) == pytest.approx(1.0, abs=1e-3)
