"""Accelerations from velocities: the UKF is the Kalman filter here, and the smoother is better than both."""

from __future__ import annotations

import numpy as np
import pytest

from dynamics.errors import RequestError
from training.data import kalman

RATE = 100.0
TIME = np.arange(800) / RATE
FREQUENCY = np.array([0.5, 0.8, 1.1]) * 2 * np.pi
VELOCITY = np.sin(FREQUENCY * TIME[:, None])
ACCELERATION = FREQUENCY * np.cos(FREQUENCY * TIME[:, None])
MEASURED = VELOCITY + 0.02 * np.random.default_rng(4).standard_normal(VELOCITY.shape)


def error(estimate: np.ndarray) -> float:
    return float(np.sqrt(np.mean((estimate - ACCELERATION)[100:-100] ** 2)))


def test_on_this_linear_model_the_ukf_is_the_kalman_filter() -> None:
    one, other = (f(MEASURED, RATE, 5.0) for f in (kalman.ukf_acceleration, kalman.kalman_acceleration))
    assert np.allclose(one, other, rtol=1e-9, atol=1e-9)


def test_the_smoother_finds_the_planted_acceleration_better_than_the_ukf_at_any_cutoff() -> None:
    cutoffs = (2.0, 3.0, 5.0, 8.0, 12.0, 20.0)
    smoothed = min(error(kalman.rts_acceleration(MEASURED, RATE, cutoff)) for cutoff in cutoffs)
    filtered = min(error(kalman.ukf_acceleration(MEASURED, RATE, cutoff)) for cutoff in cutoffs)
    assert smoothed < 0.5 * filtered
    assert smoothed < 0.2


def test_the_smoother_halves_what_lies_at_its_cutoff() -> None:
    tone = np.sin(2 * np.pi * 5.0 * TIME)[:, None]
    slope = kalman.rts_acceleration(tone, RATE, 5.0)[200:-200]
    assert np.sqrt(2 * np.mean(slope**2)) / (2 * np.pi * 5.0) == pytest.approx(0.5, abs=0.03)


def test_the_ukf_looks_back_only() -> None:
    later = MEASURED.copy()
    later[400:] += 1.0
    assert np.array_equal(
        kalman.ukf_acceleration(MEASURED, RATE, 5.0)[:400], kalman.ukf_acceleration(later, RATE, 5.0)[:400]
    )


def test_gaps_stay_gaps() -> None:
    holed = MEASURED.copy()
    holed[300:310] = np.nan
    acceleration = kalman.rts_acceleration(holed, RATE, 5.0)
    assert np.isnan(acceleration[300:310]).all()
    assert np.array_equal(acceleration[:300], kalman.rts_acceleration(holed[:300], RATE, 5.0))


def test_a_cutoff_beyond_the_rate_is_refused() -> None:
    with pytest.raises(RequestError, match="required is < 50"):
        kalman.rts_acceleration(MEASURED, RATE, 60.0)
