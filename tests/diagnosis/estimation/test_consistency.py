"""An effect of the right form has one value; one that stands in for another form has several."""

from dataclasses import replace

import msgspec
import numpy as np
import pytest

from diagnosis.estimation.consistency import drifts
from diagnosis.estimation.fitted import Fit, ParameterEstimate
from diagnosis.estimation.significance import deviations_of
from diagnosis.models.pose_errors import PoseErrors
from diagnosis.thresholds import DEFAULT
from tests.diagnosis.synthetic import CHANNELS, candidate, effect, hovering, regression

ROWS = 500


def fitted(vehicle, form, *, seed=0, sizes=(1.0, 2.0, 3.0, 4.0)):
    """A fit of a drag that grows with the speed to flights whose drag has another form, and its residuals."""
    random = np.random.default_rng(seed)
    columns, rows = [], []
    for size in sizes:
        speed = size * np.sin(np.arange(ROWS) / 25)
        x = np.zeros((ROWS, CHANNELS, 2))
        x[:, 0, 0] = x[:, 3, 0] = speed
        x[:, 1, 1] = np.cos(np.arange(ROWS) / 40)
        columns.append(x)
        rows.append(form(x[:, :, 0]) + random.standard_normal((ROWS, CHANNELS)))
    drag, other = candidate(effect("drag"), 0), candidate(effect("other"), 1)
    segments = hovering(vehicle, mass_ratio=1.0, seed=0, count=len(rows))
    of_all = regression(vehicle, [drag, other], columns, rows, segments=segments)
    theta, _ = of_all.solve([0, 1])
    estimates = {("drag", "size"): ParameterEstimate(theta[0], 0.1, "1")}
    estimates |= {("other", "size"): ParameterEstimate(theta[1], 0.1, "1")}
    left = [y - x @ theta for x, y in zip(columns, rows, strict=True)]
    return of_all, Fit(vehicle, estimates, (drag, other)), left


@pytest.mark.parametrize("seed", range(3))
def test_the_right_form_has_one_value(arpl_250g, seed):
    drift = drifts(*fitted(arpl_250g, lambda speed: 2.0 * speed, seed=seed))["drag"]
    assert drift.share < 0.1
    assert not drift.matters()
    assert not drift.refutes()


def test_a_form_that_stands_in_for_another_drifts(arpl_250g):
    for form in (lambda speed: 3.0 * np.sign(speed), lambda speed: speed * np.abs(speed)):
        drift = drifts(*fitted(arpl_250g, form))["drag"]
        assert drift.share > DEFAULT.consistency.max_drift
        assert drift.matters()


def test_a_constant_that_stands_in_for_what_warms_up_drifts(arpl_250g):
    warming = 1 - np.exp(-np.arange(ROWS) / 150)[:, None]
    drift = drifts(*fitted(arpl_250g, lambda speed: warming * speed))["drag"]
    assert drift.matters()
    assert drift.refutes()


def test_a_difference_that_is_sure_and_moves_nothing_by_what_matters_refutes_nothing(arpl_250g):
    factor = np.where(np.arange(ROWS) < ROWS / 2, 0.05, 0.15)[:, None]
    drift = drifts(*fitted(arpl_250g, lambda speed: factor * speed, sizes=(1.0, 1.0, 1.0, 1.0)))["drag"]
    sure = msgspec.structs.replace(DEFAULT.consistency, deviations=1.0, sure=1.0)
    assert 0.05 < drift.over_noise < sure.min_over_noise
    assert drift.matters(sure)
    assert not drift.refutes(sure)
    assert drift.refutes(msgspec.structs.replace(sure, min_over_noise=0.05))


def test_a_form_with_another_value_in_other_flights_drifts(arpl_250g):
    """Those where it acts strongly are as strong as the others at most times: blocks of time do not show it."""
    factors = iter([1.0, 1.0, 1.6, 1.6])
    drift = drifts(*fitted(arpl_250g, lambda speed: next(factors) * speed, sizes=(1.0, 1.0, 1.05, 1.05)))["drag"]
    assert drift.share == pytest.approx(0.6 / 1.3, abs=0.1)
    assert drift.matters()


def test_parts_of_one_log_are_no_flights(arpl_250g):
    factors = iter([1.0, 1.0, 1.6, 1.6])
    of_all, fit, left = fitted(arpl_250g, lambda speed: next(factors) * speed, sizes=(1.0, 1.0, 1.05, 1.05))
    one_log = replace(of_all, segments=[replace(segment, flight="log") for segment in of_all.segments])
    assert drifts(one_log, fit, left)["drag"].share < 0.2


def test_a_difference_by_chance_is_none(arpl_250g):
    assert not drifts(*fitted(arpl_250g, lambda speed: 0.02 * speed))["drag"].matters()


def test_nothing_fitted_drifts_nowhere(arpl_250g):
    of_all, _, left = fitted(arpl_250g, np.zeros_like)
    assert drifts(of_all, Fit(arpl_250g, {}, ()), left) == {}


def test_deviations_of_several_estimates_are_those_of_one_as_rare():
    assert deviations_of(np.array([2.0]), np.array([[1.0]])) == pytest.approx(2.0)
    assert deviations_of(np.array([2.448, 0.0]), np.eye(2)) == pytest.approx(1.96, abs=0.01)
    assert deviations_of(np.zeros(2), np.zeros((2, 2))) == 0.0


def test_noise_of_the_measured_velocity_is_no_drift(arpl_250g):
    """It shrinks a drag most where the vehicle is slow."""
    of_all, _, _ = fitted(arpl_250g, lambda speed: 0.0 * speed, sizes=(1.0, 1.0, 4.0, 4.0))
    random, columns, rows, errors = np.random.default_rng(5), [], [], []
    for x, y in zip(of_all.columns, of_all.rows, strict=True):
        noisy, drawn = x.copy(), np.zeros_like(x)
        noise, another = random.standard_normal((2, *x.shape[:2])) * (np.arange(CHANNELS) % 3 == 0)
        noisy[:, :, 0] += noise
        drawn[:, :, 0] = another
        columns.append(noisy)
        rows.append(2.0 * x[:, :, 0] + y)
        errors.append((np.zeros_like(y), drawn))
    drag = candidate(effect("drag"), 0)
    again = regression(arpl_250g, [drag, candidate(effect("other"), 1)], columns, rows, segments=of_all.segments)
    fit = Fit(arpl_250g, {("drag", "size"): ParameterEstimate(2.0, 0.1, "1")}, (drag,))
    left = [y - 2.0 * x[:, :, 0] for x, y in zip(columns, rows, strict=True)]
    unaware = replace(again, errors=errors)
    estimated = replace(unaware, pose=PoseErrors(np.ones(CHANNELS), 0.2))
    assert drifts(unaware, fit, left)["drag"].matters()
    assert not drifts(estimated, fit, left)["drag"].matters()
