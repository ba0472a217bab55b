"""Lets a network's last layer follow in flight: recursive Bayesian regression of what accelerates beyond the network.

The features stay as they were trained and the last layer alone moves, by a Kalman filter whose prior is the training's
(Harrison, Sharma and Pavone, Meta-learning priors for efficient online Bayesian regression, 2018; Neural-Fly, O'Connell
et al., 2022). Derived in docs/adaptation.md. Pure: times are arguments.
"""

from __future__ import annotations

import math

import numpy as np

from dynamics import quaternion
from dynamics.arrays import Floats
from runtime.control.adaptation_settings import AdaptationSettings
from runtime.control.network_features import NetworkFeatures

AXES = 3  # linear; the rate loop has the moments
NUISANCES = 2 * AXES  # a force that stays and one that fades, world axes


class LastLayer:
    """Correction of a network's last layer for the linear acceleration, from the last seconds of flight.

    A block of 0.1 s is a row of a regression by axis: acceleration beyond the trained model = share R V psi + o + g +
    noise. psi: whitened inputs of the layer. V: the change. o, g: a disturbance that stays and one that fades.

    change: (3, k) V, m/s^2 for each whitened feature; its norm by axis is the RMS change over the training's inputs.
    trust: share of V that is flown, in mode "on".
    squares: (2,) mean squares of the forecast errors of a block, with V and without, (m/s^2)^2.
    """

    def __init__(self, features: NetworkFeatures, settings: AdaptationSettings) -> None:
        self.features, self.settings = features, settings
        self._size = AXES * features.rank
        self.clear()

    def clear(self) -> None:
        """Forget everything."""
        settings, count = self.settings.network, self._size + NUISANCES
        self.trust, self.squares = 1.0, np.zeros(2)
        self._state, self._covariance = np.zeros(count), np.zeros((count, count))
        self._variance = settings.deviation**2 / self.features.rank
        self._design = np.eye(AXES, count, k=self._size) + np.eye(AXES, count, k=self._size + AXES)
        linear = self.settings.linear
        diagonal = np.repeat(
            [self._variance, (self.settings.start * linear.fading) ** 2, linear.fading**2], [self._size, AXES, AXES]
        )
        np.fill_diagonal(self._covariance, diagonal)
        self._alone = ForceAlone(float(diagonal[self._size]), float(diagonal[-1]))
        self.restart()

    def restart(self) -> None:
        """Go on after a gap: the block that was begun is not a row."""
        self._seconds, self._beyond = 0.0, np.zeros(AXES)
        self._rows = np.zeros((AXES, AXES, self.features.rank))

    @property
    def change(self) -> Floats:
        """(3, k), see the class."""
        return self._state[: self._size].reshape(AXES, -1)

    @property
    def deviation(self) -> float:
        """Root of the mean variance of a change that the training's inputs would show, m/s^2."""
        return math.sqrt(float(np.trace(self._covariance[: self._size, : self._size])) / AXES)

    def add(self, beyond: Floats, psi: Floats, rotation: Floats, dt: float, level: float) -> bool:
        """Take what velocity changed by beyond the trained model in dt seconds. Returns whether a row was completed.

        beyond: (3,) m/s, world. psi: (k,) as far as the network is flown. rotation: (3, 3) from the outputs' axes to
        the world's. level: of the noise that drives the disturbance, 0 to 1.
        """
        self._beyond += beyond
        self._rows += dt * rotation[:, :, None] * psi
        self._seconds += dt
        if self._seconds < self.settings.network.block - 0.5 * dt:
            return False
        self._update(self._beyond / self._seconds, self._rows.reshape(AXES, -1) / self._seconds, level)
        self.restart()
        return True

    def within(self, psi: Floats) -> float:
        """Share of the change that keeps what it adds at a window within the limit."""
        added = float(np.linalg.norm(self.change @ psi))
        limit = self.settings.network.limit
        return 1.0 if added <= limit else limit / added

    def _update(self, mean: Floats, rows: Floats, level: float) -> None:
        dt, gate = self._seconds, self.settings.gate
        noise, linear = self._noise(dt), self.settings.linear
        left = math.exp(-dt / linear.fading_time)
        drift, fades = level**2 * dt * linear.drift**2, level**2 * (1 - left**2) * linear.fading**2
        self._predict(left, drift, fades)
        alone = self._alone.take(mean, left, drift, fades, noise, gate)
        design = self._design
        design[:, : self._size] = rows
        away = mean - design @ self._state
        if not math.isfinite(float(away @ away)):
            return
        self._guard(away, alone, dt)
        across = self._covariance @ design.T
        spread = design @ across
        spread.flat[:: AXES + 1] += noise
        if (away * away > gate * gate * spread.diagonal()).any():
            return
        gain = across @ np.linalg.inv(spread)
        self._state += gain @ away
        self._covariance -= gain @ across.T
        self._covariance = 0.5 * (self._covariance + self._covariance.T)
        change = self.change
        norms = np.sqrt((change * change).sum(axis=1))
        if norms.max() > self.settings.network.bound:
            change *= np.minimum(1.0, self.settings.network.bound / np.maximum(norms, 1e-12))[:, None]

    def _noise(self, dt: float) -> float:
        """Variance of a block's mean acceleration by the estimates' errors."""
        return 2 * (self.settings.linear.measurement / dt) ** 2 + self.settings.walk**2 / dt

    def _predict(self, left: float, drift: float, fades: float) -> None:
        """V returns to what was trained, with the settings' memory; the disturbance as in the flight filter.

        left: share of what fades that a block leaves. drift, fades: variances that a block adds to the disturbance.
        """
        size = self._size
        remaining = math.exp(-self._seconds / self.settings.network.memory)
        keep, added = np.ones(size + NUISANCES), np.empty(size + NUISANCES)
        keep[:size], keep[size + AXES :] = remaining, left
        added[:size], added[size:] = (1 - remaining**2) * self._variance, fades
        added[size : size + AXES] = drift
        self._state *= keep
        self._covariance *= keep[:, None] * keep
        self._covariance.flat[:: size + NUISANCES + 1] += added

    def _guard(self, away: Floats, alone: Floats, dt: float) -> None:
        """Fly less of the change where forecasts with it have been worse over the last second, and more where not."""
        guard = self.settings.guard
        share = min(dt / guard.averaging, 1.0)
        self.squares += share * (np.array([away @ away, alone @ alone]) - self.squares)
        worse = self.squares[0] > self.settings.network.tolerance**2 * self.squares[1]
        self.trust = min(max(self.trust + (-1 if worse else 1) * dt / guard.averaging, 0.0), 1.0)


class ForceAlone:
    """The disturbance without any change of the layer, which forecasts are compared with; alike in all three axes."""

    def __init__(self, staying: float, fading: float) -> None:
        """staying, fading: variances of both parts beforehand, (m/s^2)^2."""
        self._staying, self._fading = np.zeros(AXES), np.zeros(AXES)
        self._variances = staying, 0.0, fading  # of the staying part, of both together, of the fading part

    def take(self, mean: Floats, left: float, drift: float, fades: float, noise: float, gate: float) -> Floats:
        """Take a block's mean acceleration (3,). Returns by how much it was away from the forecast. See `LastLayer`."""
        staying, both, fading = self._variances
        staying, both, fading = staying + drift, both * left, fading * left**2 + fades
        self._fading *= left
        away = mean - self._staying - self._fading
        spread = staying + 2 * both + fading + noise
        if not float(away @ away) < math.inf or float(np.abs(away).max()) > gate * math.sqrt(spread):
            self._variances = staying, both, fading
            return away
        first, second = (staying + both) / spread, (both + fading) / spread
        self._staying += first * away
        self._fading += second * away
        self._variances = (
            staying - first * (staying + both),
            both - first * (both + fading),
            fading - second * (both + fading),
        )
        return away


def rotation_of(attitude: Floats, *, body: bool) -> Floats:
    """(3, 3) from the axes of a network's outputs to the world's. body: whether these are body axes."""
    return np.asarray(quaternion.rotation_matrix(attitude)) if body else np.eye(AXES)
