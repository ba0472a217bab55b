"""Linear time-invariant state space driven by white noise, with named states, noises and outputs.

dx/dt = F x + L w,  y = H x + D w + r,  E[w(t) w(s)'] = diag(Qc) delta(t - s)  (Sarkka and Solin, Applied Stochastic
Differential Equations, 2019, ch. 6 and 12). r is the noise of single readings, independent from row to row.
Densities are two-sided, of frequencies in Hz: the variance is their integral from minus to plus infinity.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import scipy
from numpy.typing import NDArray

from dynamics.arrays import Floats

Complex = NDArray[np.complexfloating]
ABSENT: Floats = np.zeros(0)


@dataclass(frozen=True, eq=False)
class LinearModel:
    """A state space (see above).

    states, noises, outputs: n, k and m names.
    F, L, H, D: (n, n), (n, k), (m, n), (m, k).
    Qc: (k,) intensities of the noises, unit^2/Hz; NaN for a noise of another component.
    R: (m,) variances of the noise of single readings; none where absent, as D.
    start_std: (n,) standard deviations at the start; NaN, or absent, where a state is stationary from the beginning.
    """

    states: tuple[str, ...]
    noises: tuple[str, ...]
    outputs: tuple[str, ...]
    F: Floats
    L: Floats
    H: Floats
    Qc: Floats
    D: Floats = field(default_factory=lambda: ABSENT)
    R: Floats = field(default_factory=lambda: ABSENT)
    start_std: Floats = field(default_factory=lambda: ABSENT)

    def __post_init__(self) -> None:
        """Fill in what is absent. Raises ValueError for other shapes, and for names that occur twice."""
        n, k, m = len(self.states), len(self.noises), len(self.outputs)
        shapes = {"F": (n, n), "L": (n, k), "H": (m, n), "D": (m, k), "Qc": (k,), "R": (m,), "start_std": (n,)}
        for name, shape in shapes.items():
            if getattr(self, name) is ABSENT:
                object.__setattr__(self, name, np.full(shape, np.nan if name == "start_std" else 0.0))
            if (actual := np.shape(getattr(self, name))) != shape:
                raise ValueError(f"{name} is {actual}; {n} states, {k} noises and {m} outputs need {shape}.")
        for names in (self.states, self.noises, self.outputs):
            if len(set(names)) < len(names):
                raise ValueError(f"a name occurs twice among {', '.join(names)}; give each its own.")

    def transfer(self, frequency: Floats) -> Complex:
        """(f, m, k) transfer function G = H (i omega - F)^-1 L + D at frequencies, Hz."""
        shifted = 2j * np.pi * frequency[:, None, None] * np.eye(len(self.states)) - self.F
        driven = np.linalg.solve(shifted, np.broadcast_to(self.L, (len(frequency), *self.L.shape)))
        return np.asarray(self.H @ driven + self.D)

    def density(self, frequency: Floats, period: float) -> Complex:
        """(f, m, m) cross power density of the outputs, unit^2/Hz, at frequencies, Hz; readings every `period` s.

        G Qc G* with the transfer function G, and R period of a white sequence.
        """
        transfer = self.transfer(frequency)
        density = (transfer * self.Qc) @ transfer.conj().transpose(0, 2, 1)
        return np.asarray(density + np.diag(self.R) * period)

    def density_of(self, operator: Complex, frequency: Floats, period: float) -> Floats:
        """(f, c) power density of linear functions (f, c, m) of the outputs.

        As a sum of squares: what a function leaves out of an output may be far larger than what it leaves in.
        """
        driven = np.abs(operator @ self.transfer(frequency)) ** 2 @ self.Qc
        return np.asarray(driven + np.abs(operator) ** 2 @ self.R * period)

    def start_covariance(self) -> Floats:
        """(n, n) covariance of the states at the start: F P + P F' + L Qc L' = 0 where they are stationary.

        Raises ValueError where a state without a start of its own grows without bound.
        """
        covariance = np.diag(np.nan_to_num(self.start_std) ** 2)
        stationary = np.flatnonzero(np.isnan(self.start_std))
        if not len(stationary):
            return covariance
        F, L = self.F[np.ix_(stationary, stationary)], self.L[stationary]
        if np.any(self.F[stationary][:, ~np.isnan(self.start_std)]) or np.linalg.eigvals(F).real.max() >= 0:
            raise ValueError(
                f"of the states {', '.join(self.states)} some have no stationary variance; give each a start_std."
            )
        solution = scipy.linalg.solve_continuous_lyapunov(F, -(L * self.Qc) @ L.T)
        covariance[np.ix_(stationary, stationary)] = (solution + solution.T) / 2
        return covariance


def compose(models: Sequence[LinearModel]) -> LinearModel:
    """Several state spaces as one: block-diagonal F, outputs of one name add, noises of one name are one noise."""
    outputs = tuple(dict.fromkeys(name for model in models for name in model.outputs))
    noises = tuple(dict.fromkeys(name for model in models for name in model.noises))
    states = tuple(name for model in models for name in model.states)
    n, k, m = len(states), len(noises), len(outputs)
    F, L, H, D = np.zeros((n, n)), np.zeros((n, k)), np.zeros((m, n)), np.zeros((m, k))
    Qc, R, first = np.full(k, np.nan), np.zeros(m), 0
    for model in models:
        rows = slice(first, first := first + len(model.states))
        columns, places = [noises.index(x) for x in model.noises], [outputs.index(x) for x in model.outputs]
        F[rows, rows], L[rows, columns], H[places, rows] = model.F, model.L, model.H
        D[np.ix_(places, columns)] += model.D
        R[places] += model.R
        Qc[columns] = np.where(np.isnan(model.Qc), Qc[columns], model.Qc)
    start_std = np.concatenate([model.start_std for model in models]) if models else np.zeros(0)
    return LinearModel(states, noises, outputs, F, L, H, Qc, D, R, start_std)


def renamed(model: LinearModel, component: str) -> LinearModel:
    """A model whose states and noises carry a component's name; a noise with a point in its name is another's."""
    noises = tuple(name if "." in name else f"{component}.{name}" for name in model.noises)
    return replace(model, states=tuple(f"{component}.{name}" for name in model.states), noises=noises)


def white(output: str, density: float, noise: str | None = None) -> LinearModel:
    """White noise: its mean over h seconds has the standard deviation density / sqrt(h)."""
    Qc, empty = np.array([density**2]), np.zeros((0, 0))
    return LinearModel(
        (), (noise or output,), (output,), empty, np.zeros((0, 1)), np.zeros((1, 0)), Qc, D=np.ones((1, 1))
    )


def read_noise(output: str, variance: float) -> LinearModel:
    """Noise of single readings, independent from row to row."""
    return replace(white(output, 0.0), R=np.array([variance]))


def chain(output: str, F: Floats, H: Floats, density: float, start_std: float = np.nan) -> LinearModel:
    """One output of a few states, the last of which one white noise drives. F: (n, n). H: (n,)."""
    n = len(F)
    names = tuple(f"{output}_{place}" for place in range(n)) if n > 1 else (output,)
    Qc, start = np.array([density**2]), np.full(n, start_std)
    return LinearModel(names, (f"{output}_drive",), (output,), F, np.eye(n)[:, -1:], H[None], Qc, start_std=start)


def random_walk(output: str, density: float, start_std: float) -> LinearModel:
    """dx/dt = w: its change over h seconds has the standard deviation density sqrt(h)."""
    return chain(output, np.zeros((1, 1)), np.ones(1), density, start_std)


def gauss_markov(output: str, std: float, time: float) -> LinearModel:
    """dx/dt = -x / time + w (Uhlenbeck and Ornstein, Phys. Rev. 36, 1930)."""
    return chain(output, np.array([[-1 / time]]), np.ones(1), std * np.sqrt(2 / time))


def gauss_markov_density(std: float, time: float, frequency: Floats) -> Floats:
    """2 std^2 time / (1 + (omega time)^2)."""
    return np.asarray(2 * std**2 * time / (1 + (2 * np.pi * frequency * time) ** 2))
