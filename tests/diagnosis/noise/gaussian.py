"""Gaussian likelihoods by brute force, and autocovariances in closed form: nothing here knows of a state space."""

from __future__ import annotations

import numpy as np

from dynamics.arrays import Floats


def log_density(values: Floats, covariance: Floats) -> float:
    """Logarithm of the density of a zero-mean Gaussian vector; NaN entries are left out."""
    present = np.isfinite(values)
    observed = covariance[np.ix_(present, present)]
    sign, log_determinant = np.linalg.slogdet(2 * np.pi * observed)
    assert sign > 0
    return float(-(log_determinant + values[present] @ np.linalg.solve(observed, values[present])) / 2)


def lags(count: int, period: float) -> Floats:
    """(count, count) time between rows, s."""
    times = period * np.arange(count)
    return np.asarray(np.abs(times[:, None] - times))


def exponential(lag: Floats, std: float, time: float) -> Floats:
    """Of an Ornstein-Uhlenbeck process, and of Dryden's gust along the motion."""
    return np.asarray(std**2 * np.exp(-lag / time))


def smooth(lag: Floats, std: float, time: float, smoothing: float) -> Floats:
    """Of white noise behind two different low-passes."""
    slow, fast = time * np.exp(-lag / time), smoothing * np.exp(-lag / smoothing)
    return np.asarray(std**2 * (slow - fast) / (time - smoothing))


def dryden_across(lag: Floats, std: float, time: float) -> Floats:
    """Of Dryden's gust across the motion."""
    return np.asarray(std**2 * np.exp(-lag / time) * (1 - lag / (2 * time)))


def exponential_means(count: int, period: float, std: float, time: float) -> Floats:
    """Of the means over rows of an Ornstein-Uhlenbeck process."""
    ratio = period / time
    between = std**2 / ratio**2 * (1 - np.exp(-ratio)) ** 2
    covariance = between * np.exp(-(lags(count, period) - period) / time)
    np.fill_diagonal(covariance, 2 * std**2 / ratio**2 * (ratio - 1 + np.exp(-ratio)))
    return np.asarray(covariance)


def sensor_means(count: int, period: float, density: float, walk: float, bias: float) -> Floats:
    """Of the means over rows of white noise and a random walk that starts with the deviation `bias`."""
    begin = period * np.arange(count)
    covariance = bias**2 + walk**2 * (np.minimum.outer(begin, begin) + period / 2)
    np.fill_diagonal(covariance, bias**2 + walk**2 * (begin + period / 3))
    return np.asarray(covariance + density**2 / period * np.eye(count))


def decay_with_sensor(count: int, period: float, density: float, std: float, time: float) -> tuple[Floats, Floats]:
    """Of the integral of a sensor's white noise with decay, and with the mean of that noise over each row.

    The decay is driven by corrections of the intensity 2 std^2 / time as well. Rows end at period, 2 period, ...
    """
    own = exponential(lags(count, period), np.sqrt(std**2 + density**2 * time / 2), time)
    end = period * np.arange(1, count + 1)
    since = end[:, None] - end
    shared = density**2 * time / period * (np.exp(-since / time) - np.exp(-(since + period) / time))
    return own, np.where(since > -period / 2, shared, 0.0)
