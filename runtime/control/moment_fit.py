"""Parameters that turn the body and leave its acceleration alone, such as a centre of mass, from real rotor speeds.

The autopilot's rate loop holds their moment, so that a model with planned speeds does not see it. Beside the speeds
that the rotors really had it is the angular acceleration beyond the model, linear in the parameters: least squares over
blocks of 0.1 s with the parameters' priors, forgotten in half a minute.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from dynamics.arrays import Floats
from dynamics.state import RATE, RIGID_BODY_STATES, VELOCITY
from runtime.control.followed_parameters import FollowedParameter
from runtime.control.rti.solver import RtiSolver

BLOCK = 0.1  # s
MEMORY = 30.0  # s, in which a block's weight falls to 1/e
MIN_BLOCKS = 20
CHANGED, PERSISTENCE = (
    5.0,
    5,
)  # standard deviations of a block from its fit, and blocks in a row, after which it restarts
CORRELATION = 0.5  # of a block with the next, at least
MODEL_ERROR = 0.015  # of a rotor's own angular acceleration: other rotors, drag off the centre
SLOPE_STEP = 0.01  # of a prior's standard deviation
HOVER_STEP = 0.002  # s
SHOWN = slice(3, 5)  # angular accelerations about body x and y
MAX_LINEAR, MIN_ANGULAR = 0.05, 1.0  # m/s^2 and rad/s^2 in hover, per standard deviation of the prior


def with_moments(solver: RtiSolver, parameters: Sequence[FollowedParameter]) -> list[FollowedParameter]:
    """The parameters, those that turn the body alone in the group "moment"."""
    hover, state = solver.trim.rotor_speed, solver.model.initial_state(np.array([*[0.0] * 6, 1.0, *[0.0] * 6]))
    usual = solver.propagate(state, hover, HOVER_STEP)[:RIGID_BODY_STATES].copy()
    sorted_ = []
    for parameter in parameters:
        value = float(solver.parameters[parameter.index])
        solver.parameters[parameter.index] = value + SLOPE_STEP * parameter.std
        moved = (solver.propagate(state, hover, HOVER_STEP)[:RIGID_BODY_STATES] - usual) / (SLOPE_STEP * HOVER_STEP)
        solver.parameters[parameter.index] = value
        turns = np.abs(moved[VELOCITY]).max() < MAX_LINEAR and np.abs(moved[RATE][:2]).max() > MIN_ANGULAR
        sorted_.append(replace(parameter, group="moment") if turns else parameter)
    return sorted_


class MomentFit:
    """Blocks of angular accelerations in, parameters of the group "moment" out. Pure.

    values, deviations: (n,) of the parameters; those of their priors until a flight shows them.
    """

    def __init__(self, solver: RtiSolver, parameters: Sequence[FollowedParameter]) -> None:
        self.parameters = tuple(p for p in parameters if p.group == "moment")
        self._solver = solver
        self._scale = np.array([p.std for p in self.parameters])
        self._prior = np.array([p.value for p in self.parameters])
        self._lower, self._upper = (
            np.array([getattr(p, side) for p in self.parameters]) for side in ("lower", "upper")
        )
        self._variance = np.zeros(2)
        self.values = self._prior.copy()
        self.deviations = self._scale.copy()
        self._sum, self._seconds = np.zeros(2), 0.0
        self._restart()

    def _restart(self) -> None:
        """Forget the blocks; the values stay until others show."""
        count = len(self.parameters)
        self._normal, self._right = np.zeros((2, count, count)), np.zeros((2, count))
        self._square, self._weight, self._elsewhere = np.zeros(2), 0.0, 0

    @property
    def named(self) -> dict[str, tuple[float, float]]:
        """Value and standard deviation of each parameter, by name."""
        pairs = zip(self.values.tolist(), self.deviations.tolist(), strict=True)
        return {p.name: pair for p, pair in zip(self.parameters, pairs, strict=True)}

    def add(
        self, before: Floats, speeds: Floats, state: Floats, beyond: Floats, shares: Floats, seconds: float
    ) -> None:
        """Take what was between two estimates (nx,). speeds: (n,) rad/s, that rotors had.

        beyond: (6,) accelerations beyond the model; shares: (n, 6) of each rotor's whole thrust. See `rotor_shares`.
        """
        if not self.parameters:
            return
        self._sum += seconds * beyond[SHOWN]
        self._seconds += seconds
        if self._seconds < BLOCK - 1e-6:
            return
        mean, self._seconds, total = self._sum / self._seconds, 0.0, self._seconds
        self._sum[:] = 0.0
        largest = np.abs(shares[:, SHOWN]).max(axis=0)
        slopes = self._slopes(before, speeds, state, beyond[SHOWN].copy(), seconds)
        if np.isfinite(mean.sum() + slopes.sum() + largest.sum()):
            self._take(mean, slopes, largest, np.exp(-total / MEMORY))

    def _slopes(self, before: Floats, speeds: Floats, state: Floats, beyond: Floats, seconds: float) -> Floats:
        """(2, n) of the model's angular acceleration, per standard deviation of each parameter's prior."""
        slopes, values = np.zeros((2, len(self.parameters))), self._solver.parameters
        for j, parameter in enumerate(self.parameters):
            value = float(values[parameter.index])
            values[parameter.index] = value + SLOPE_STEP * parameter.std
            moved, _ = self._solver.rotor_shares(before, speeds, state, seconds)
            values[parameter.index] = value
            slopes[:, j] = (beyond - moved[SHOWN]) / SLOPE_STEP
        return slopes

    def _take(self, mean: Floats, slopes: Floats, largest: Floats, keep: float) -> None:
        if self._weight >= MIN_BLOCKS:
            away = mean - slopes @ ((self.values - self._prior) / self._scale)
            if (away**2 > CHANGED**2 * self._variance).any():
                self._elsewhere += 1
                if self._elsewhere < PERSISTENCE:
                    return
                self._restart()
            self._elsewhere = 0
        self._normal = keep * self._normal + slopes[:, :, None] * slopes[:, None, :]
        self._right = keep * self._right + slopes * mean[:, None]
        self._square, self._weight = keep * self._square + mean**2, keep * self._weight + 1
        if self._weight < MIN_BLOCKS:
            return
        variance = np.maximum(self._square / self._weight, 1e-6)  # of the noise: what no parameter explains
        for _ in range(2):
            normal = np.eye(len(self.parameters)) + np.einsum("i,ijk->jk", 1 / variance, self._normal)
            moved = np.linalg.solve(normal, np.einsum("i,ij->j", 1 / variance, self._right))
            left = self._square - 2 * self._right @ moved + np.einsum("j,ijk,k->i", moved, self._normal, moved)
            variance = np.maximum(left / self._weight, 1e-6) * (1 + CORRELATION) / (1 - CORRELATION)
        error = (MODEL_ERROR * largest) ** 2  # the same in all blocks: it does not average
        self._variance = variance + error
        noise = variance + self._weight * error
        inverse = np.linalg.inv(np.eye(len(moved)) + np.einsum("i,ijk->jk", 1 / noise, self._normal))
        self.values = np.clip(self._prior + self._scale * moved, self._lower, self._upper)
        self.deviations = self._scale * np.sqrt(np.diag(inverse))
