"""Unobserved accelerations from measured velocities: a kinematic Kalman filter, its RTS smoother, and a UKF.

The model: each axis's acceleration is a random walk, its velocity is measured with white noise. Only the ratio of the
two noises matters; it is given by the cutoff of the smoother, |H(f)| = 1 / (1 + (f / cutoff)^4), so that it can be
compared with a Butterworth filter. On this linear model a UKF is the Kalman filter; the cost of its causality against
the RTS smoother is in `python -m benchmarks learning labels`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dynamics.arrays import Floats
from dynamics.errors import RequestError
from flights.filters import each_segment

_START = 1e4  # variance of the first acceleration over that of the steady state: no prior


@dataclass(frozen=True)
class KinematicModel:
    """x = (velocity, acceleration) of one axis. transition, process: (2, 2). measurement: variance of the velocity."""

    transition: Floats
    process: Floats
    measurement: float

    @classmethod
    def with_cutoff(cls, rate: float, cutoff: float) -> KinematicModel:
        """The model whose smoother has a gain of one half at the cutoff. rate, cutoff: Hz.

        Raises RequestError for a cutoff that is not below half the rate.
        """
        if not 0.0 < cutoff < 0.5 * rate:
            raise RequestError(f"a smoother of {cutoff:g} Hz on data of {rate:g} Hz: required is < {0.5 * rate:g}.")
        h = 1.0 / rate
        density = (2 * np.pi * cutoff) ** 4 * h  # of the white jerk, for a measurement variance of 1
        process = density * np.array([[h**3 / 3, h**2 / 2], [h**2 / 2, h]])
        return cls(np.array([[1.0, h], [0.0, 1.0]]), process, 1.0)


def rts_acceleration(velocity: Floats, rate: float, cutoff: float) -> Floats:
    """Acceleration by the Rauch-Tung-Striebel smoother: looks ahead, for labels only.

    velocity: (n, k), NaN rows split it. rate, cutoff: Hz. Returns (n, k). Also gives angular from body rates.
    """
    model = KinematicModel.with_cutoff(rate, cutoff)
    return each_segment(velocity, lambda segment: _smooth(model, *_filter(model, segment))[:, 1])


def kalman_acceleration(velocity: Floats, rate: float, cutoff: float) -> Floats:
    """Acceleration by the Kalman filter alone: causal. velocity: (n, k). rate, cutoff: Hz. Returns (n, k)."""
    model = KinematicModel.with_cutoff(rate, cutoff)
    return each_segment(velocity, lambda segment: _filter(model, segment)[0][:, 1])


def ukf_acceleration(velocity: Floats, rate: float, cutoff: float) -> Floats:
    """Acceleration by an unscented Kalman filter, as in PI-TCN section IV-A: causal. Arguments as above."""
    model = KinematicModel.with_cutoff(rate, cutoff)
    return each_segment(velocity, lambda segment: _unscented(model, segment))


def _filter(model: KinematicModel, velocity: Floats) -> tuple[Floats, Floats]:
    """Filtered states (n, 2, k) and their covariances (n, 2, 2), the same for every axis."""
    states = np.empty((len(velocity), 2, velocity.shape[1]))
    covariances = np.empty((len(velocity), 2, 2))
    mean = np.stack([velocity[0], np.zeros_like(velocity[0])])
    covariance = np.diag([model.measurement, _START * model.process[1, 1]])
    for row, measured in enumerate(velocity):
        if row:
            mean = model.transition @ mean
            covariance = model.transition @ covariance @ model.transition.T + model.process
        gain = covariance[:, 0] / (covariance[0, 0] + model.measurement)
        mean = mean + np.outer(gain, measured - mean[0])
        covariance = covariance - np.outer(gain, covariance[0])
        states[row], covariances[row] = mean, covariance
    return states, covariances


def _smooth(model: KinematicModel, states: Floats, covariances: Floats) -> Floats:
    """The backward pass (Rauch, Tung, Striebel 1965, eq. 3.28)."""
    smoothed = states.copy()
    predicted = model.transition @ covariances @ model.transition.T + model.process
    gains = covariances @ model.transition.T @ np.linalg.inv(predicted)
    extrapolated = model.transition @ states
    for row in range(len(states) - 2, -1, -1):
        smoothed[row] += gains[row] @ (smoothed[row + 1] - extrapolated[row])
    return smoothed


def _unscented(model: KinematicModel, velocity: Floats) -> Floats:
    """Filtered accelerations by sigma points (Julier, Uhlmann 2004; kappa = 1, so that all weights are positive)."""
    spread = float(np.sqrt(3.0))
    weights = np.array([1 / 3, *[1 / 6] * 4])
    result = np.empty_like(velocity)
    mean = np.stack([velocity[0], np.zeros_like(velocity[0])])
    covariance = np.diag([model.measurement, _START * model.process[1, 1]])
    for row, measured in enumerate(velocity):
        if row:
            points = model.transition @ _sigma_points(mean, covariance, spread)
            mean = np.tensordot(weights, points, axes=1)
            covariance = _scatter(points, mean, weights) + model.process
        points = _sigma_points(mean, covariance, spread)
        readings = points[:, 0]
        expected = weights @ readings
        gap = readings - expected
        variance = weights @ gap[:, 0] ** 2 + model.measurement
        gain = weights @ ((points - mean)[:, :, 0] * gap[:, :1]) / variance
        mean = mean + np.outer(gain, measured - expected)
        covariance = covariance - variance * np.outer(gain, gain)
        result[row] = mean[1]
    return result


def _sigma_points(mean: Floats, covariance: Floats, spread: float) -> Floats:
    """Five points (5, 2, k) about the mean (2, k)."""
    root = spread * np.linalg.cholesky(covariance)
    steps = np.concatenate([np.zeros((1, 2)), root.T, -root.T])
    return np.asarray(mean[None] + steps[:, :, None])


def _scatter(points: Floats, mean: Floats, weights: Floats) -> Floats:
    """Covariance (2, 2) of sigma points, the same for every axis: that of the first."""
    gap = (points - mean)[:, :, 0]
    return np.asarray((weights[:, None] * gap).T @ gap)
