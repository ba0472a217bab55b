"""Stationary gain of the filter about hover, and its derivatives in the noise's hyperparameters."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import scipy
from numpy.typing import NDArray

from diagnosis.noise.component import AXES, FlightConditions
from diagnosis.noise.composition import Composition
from diagnosis.noise.discretisation import DiscreteModel, covariances, discretise
from diagnosis.noise.linear_model import LinearModel, compose
from dynamics.arrays import Floats
from dynamics.rotation_matrix import skew

KINDS = ("velocity", "attitude", "gyro", "accelerometer", "rotor_speed")
RIGID = 9  # error of velocity, body axes, of attitude, and of body rate
DOUBLINGS = 40  # at most: a filter that remembers 2^40 rows has converged
STEP = 1e-5  # of a hyperparameter's logarithm, for slopes of the discretised model
Entries = tuple[NDArray[np.int32], NDArray[np.int32], Floats]  # first of each row, columns, values
Turning = tuple[NDArray[np.int32], NDArray[np.int32], NDArray[np.int32], Floats]  # with which condition before values


@dataclass(frozen=True, eq=False)
class Plant:
    """The rigid body about hover, on which the noise acts.

    conditions: hover on the vehicle, and the logs' rates.
    slope: (6, 9) of specific force and angular acceleration in the error state.
    by_rotor: (6, rotors) in each rotor's speed.
    readings: names of the kinds that are logged.
    """

    conditions: FlightConditions
    slope: Floats
    by_rotor: Floats
    readings: tuple[str, ...]

    @cached_property
    def outputs(self) -> tuple[str, ...]:
        """Names of the readings."""
        rotors = range(self.by_rotor.shape[1])
        places = {kind: rotors if kind == "rotor_speed" else AXES for kind in self.readings}
        return tuple(f"{kind}_{place}" for kind, each in places.items() for place in each)

    def rigid(self) -> Floats:
        """(9, 9) dynamics of the error state (Titterton and Weston, ch. 12, in body axes); none of what is not read."""
        F = np.zeros((RIGID, RIGID))
        F[0:3] = self.slope[:3]
        F[0:3, 3:6] -= skew(self.conditions.specific_force)
        F[0:3, 0:3] -= skew(self.conditions.rate_body)
        F[3:6, 3:6] -= skew(self.conditions.rate_body)
        F[3:6, 6:9] = np.eye(3)
        F[6:9] = self.slope[3:]
        decoupled(F, unread(self.readings), -1.0)
        return F

    def acting(self, output: str) -> Floats | None:
        """(6,) specific force and angular acceleration of a unit of a noise's output; None for a reading's noise."""
        kind, _, place = output.rpartition("_")
        body, response = self.conditions.vehicle.body, np.zeros(6)
        if kind == "rotor_speed":
            return np.asarray(self.by_rotor[:, int(place)])
        if kind == "speed_reading":
            return None
        axis = AXES.index(place)
        if kind == "force":
            response[axis] = 1 / body.mass
        elif kind == "torque":
            response[3 + axis] = 1 / body.inertia[axis]
        elif kind == "air":
            response = -self.slope[:, axis]
        else:
            return None
        return response


def unread(readings: Sequence[str]) -> list[int]:
    """States of the rigid body that logs without a pose do not show: velocity, and attitude where it is not read.

    They stand still: what is not read of a vehicle is as the segment says, and no disturbance moves it.
    """
    if "velocity" in readings:
        return []
    return [*range(3), *(() if "attitude" in readings else range(3, 6))]


def decoupled(matrices: Floats, states: Sequence[int], diagonal: float) -> None:
    """Leave (..., 9, 9) dynamics of the rigid body no path into some states, nor out of them."""
    matrices[..., states, :RIGID] = 0.0
    matrices[..., :RIGID, states] = 0.0
    matrices[..., states, states] = diagonal


@dataclass(frozen=True, eq=False)
class Gain:
    """A filter at values of the hyperparameters.

    A, C, K: (n, n), (m, n) and (n, m). V: (m, m) covariance of the innovations. whitening: (m, m) lower triangular,
    W V W' = 1. log_determinant: of V.
    turning: entries of the transition, times specific force or body rate of a row.
    """

    model: DiscreteModel
    P: Floats
    K: Floats
    V: Floats
    whitening: Floats
    log_determinant: float
    turning: Turning

    @property
    def transition(self) -> Floats:
        """(n, n) transition about hover."""
        return self.model.A

    @cached_property
    def transition_entries(self) -> Entries:
        """The transition but the rigid body's own block."""
        return _entries(_without_rigid(self.model.A, RIGID))

    @cached_property
    def reading_entries(self) -> Entries:
        """The readings of other states than the rigid body's."""
        return _entries(_without_rigid(self.model.C, len(self.model.C)))


@dataclass(frozen=True, eq=False)
class GainSlope:
    """Derivatives of a filter in the logarithm of one hyperparameter."""

    A: Floats
    C: Floats
    K: Floats
    V: Floats


def combined(noise: LinearModel, plant: Plant) -> LinearModel:
    """The rigid body's error state with the noise that acts on it and on its readings; states that no reading shows
    are left out."""
    noise = _observed(noise, plant)
    acting = {o: response for o in noise.outputs if (response := plant.acting(o)) is not None}
    n, k = RIGID + len(noise.states), len(noise.noises)
    F, L = np.zeros((n, n)), np.zeros((n, k))
    F[:RIGID, :RIGID], F[RIGID:, RIGID:], L[RIGID:] = plant.rigid(), noise.F, noise.L
    m = len(plant.outputs)
    H, D, R = np.zeros((m, n)), np.zeros((m, k)), np.zeros(m)
    shown = {"velocity": np.eye(RIGID)[0:3], "attitude": np.eye(RIGID)[3:6], "gyro": np.eye(RIGID)[6:9]}
    shown["accelerometer"] = plant.slope[:3]
    for place, kind in enumerate(plant.readings):
        if kind in shown:
            H[3 * place : 3 * place + 3, :RIGID] = shown[kind]
    for place, output in enumerate(noise.outputs):
        if output in acting:
            into = np.zeros(n)
            into[0:3], into[6:9] = acting[output][:3], acting[output][3:]
            F[:, RIGID:] += np.outer(into, noise.H[place])
            L += np.outer(into, noise.D[place])
            if output in plant.outputs:  # a rotor's speed acts, and is read
                H[plant.outputs.index(output), RIGID:] += noise.H[place]
            if "accelerometer" in plant.readings:
                first = 3 * plant.readings.index("accelerometer")
                H[first : first + 3, RIGID:] += np.outer(acting[output][:3], noise.H[place])
                D[first : first + 3] += np.outer(acting[output][:3], noise.D[place])
        else:
            row = plant.outputs.index(output.replace("speed_reading", "rotor_speed"))
            H[row, RIGID:] += noise.H[place]
            D[row] += noise.D[place]
            R[row] += noise.R[place]
    still = unread(plant.readings)
    F[still, RIGID:], L[still], H[:, still] = 0.0, 0.0, 0.0
    states = (*(f"rigid_{i}" for i in range(RIGID)), *noise.states)
    return LinearModel(states, noise.noises, plant.outputs, F, L, H, noise.Qc, D, R)


def _observed(noise: LinearModel, plant: Plant) -> LinearModel:
    """The noise without outputs that no reading shows, and without states and noises that only these have."""
    shown = {*plant.outputs, *(o.replace("rotor_speed", "speed_reading") for o in plant.outputs)}
    outputs = np.array([i for i, o in enumerate(noise.outputs) if o in shown or plant.acting(o) is not None], dtype=int)
    reached = np.abs(noise.H[outputs]).sum(0) > 0
    for _ in noise.states:
        reached = reached | (np.abs(noise.F[reached]).sum(0) > 0)
    states = np.flatnonzero(reached)
    used = (np.abs(noise.L[states]).sum(0) > 0) | (np.abs(noise.D[outputs]).sum(0) > 0)
    noises = np.flatnonzero(used)
    return LinearModel(
        tuple(noise.states[i] for i in states),
        tuple(noise.noises[i] for i in noises),
        tuple(noise.outputs[i] for i in outputs),
        noise.F[np.ix_(states, states)],
        noise.L[np.ix_(states, noises)],
        noise.H[np.ix_(outputs, states)],
        noise.Qc[noises],
        noise.D[np.ix_(outputs, noises)],
        noise.R[outputs],
    )


def discrete(composition: Composition, values: Mapping[str, float], plant: Plant) -> DiscreteModel:
    """The whole model over a row, whose readings are means over it."""
    return _over_row(composition.model(values, plant.conditions), plant)


def _over_row(noise: LinearModel, plant: Plant) -> DiscreteModel:
    return discretise(combined(noise, plant), plant.conditions.period, plant.outputs)


def make_gain(
    composition: Composition, values: Mapping[str, float], plant: Plant, turning: Turning | None = None
) -> Gain:
    """The stationary filter (Anderson and Moore, Optimal Filtering, 1979, sec. 4.4 and 5.5).

    turning: as another gain of the composition has it: it does not depend on the values.
    """
    model = discrete(composition, values, plant)
    slight = 1e-14 * np.eye(len(model.A))
    P = scipy.linalg.solve_discrete_are(model.A.T, model.C.T, model.Q + slight, model.R, s=model.S)
    P = (P + P.T) / 2
    V = model.C @ P @ model.C.T + model.R
    cholesky = np.linalg.cholesky(V)
    K = scipy.linalg.cho_solve((cholesky, True), (model.A @ P @ model.C.T + model.S).T).T
    K[np.abs(K) < 1e-12 * np.abs(K).max()] = 0.0
    W = np.ascontiguousarray(scipy.linalg.solve_triangular(cholesky, np.eye(len(V)), lower=True))
    turning = _turning(composition, values, plant) if turning is None else turning
    return Gain(model, P, np.ascontiguousarray(K), V, W, float(2 * np.log(np.diag(cholesky)).sum()), turning)


def slopes(composition: Composition, logs: Floats, names: Sequence[str], plant: Plant, gain: Gain) -> list[GainSlope]:
    """Derivatives of a gain in the logarithms of its hyperparameters (implicit differentiation of Riccati's
    equation)."""
    m, K, P = gain.model, gain.K, gain.P
    inverse = gain.whitening.T @ gain.whitening
    closed = m.A - K @ m.C
    parts = _discrete_slopes(composition, logs, names, plant, m)
    driven = []
    for d in parts:
        mixed = (d.A - K @ d.C) @ P @ closed.T - d.S @ K.T
        driven.append(d.Q + K @ d.R @ K.T + mixed + mixed.T)
    change = _lyapunov(closed, np.array(driven))
    made = []
    for d, dP in zip(parts, change, strict=True):
        across = d.C @ P @ m.C.T
        dV = m.C @ dP @ m.C.T + across + across.T + d.R
        dK = (d.A @ P @ m.C.T + m.A @ dP @ m.C.T + m.A @ P @ d.C.T + d.S - K @ dV) @ inverse
        made.append(GainSlope(d.A, d.C, dK, dV))
    return made


def _discrete_slopes(
    composition: Composition, logs: Floats, names: Sequence[str], plant: Plant, model: DiscreteModel
) -> list[DiscreteModel]:
    """Derivatives of the discretised model in each hyperparameter's logarithm.

    Most of them change intensities alone, which enter linearly; of the others the whole model is made again.
    """
    here = composition.parts(dict(zip(names, np.exp(logs), strict=True)), plant.conditions)
    base, made = combined(compose(here), plant), dict[int, DiscreteModel]()
    Qc, R, linear = [], [], []
    for place, name in enumerate(names):
        moved = logs.copy()
        moved[place] += STEP
        values = dict(zip(names, np.exp(moved), strict=True))
        there = composition.parts(values, plant.conditions, here, name)
        changed = [(one, other) for one, other in zip(here, there, strict=True) if one is not other]
        if all(_has_dynamics_of(one, other) for one, other in changed):
            before, after = zip(*changed, strict=True)
            linear.append(place)
            Qc.append(_by_name(after, base.noises, "noises", "Qc") - _by_name(before, base.noises, "noises", "Qc"))
            R.append(_by_name(after, base.outputs, "outputs", "R") - _by_name(before, base.outputs, "outputs", "R"))
            continue
        other = _over_row(compose(there), plant)
        made[place] = DiscreteModel(
            *((getattr(other, x) - getattr(model, x)) / STEP for x in ("A", "C", "Q", "S", "R"))
        )
    period, outputs = plant.conditions.period, plant.outputs
    slopes_of = covariances(base, period, outputs, np.array(Qc) / STEP, np.array(R) / STEP) if linear else []
    made |= dict(zip(linear, slopes_of, strict=True))
    return [made[place] for place in range(len(names))]


def _has_dynamics_of(one: LinearModel, other: LinearModel) -> bool:
    """Whether two state spaces differ in their noises' intensities at most."""
    return all(np.array_equal(getattr(one, x), getattr(other, x)) for x in ("F", "L", "H", "D"))


def _by_name(parts: Sequence[LinearModel], names: Sequence[str], of: str, value: str) -> Floats:
    """Values of parts in the order of some names: intensities add, each of one part; variances of readings add."""
    total = np.zeros(len(names))
    places = {name: place for place, name in enumerate(names)}
    for part in parts:
        for name, each in zip(getattr(part, of), getattr(part, value), strict=True):
            place = places.get(name.replace("speed_reading", "rotor_speed") if of == "outputs" else name)
            if place is not None and np.isfinite(each):
                total[place] += each
    return total


@dataclass(frozen=True, eq=False)
class NoiseSlopes:
    """How innovations change with the noise's hyperparameters, as inputs of the filter.

    A: (n, h n), C: (n, h m), K: (m, h n): maps of the states and innovations of a row, transposed and side by side.
    V: (h, m, m) of the whitened innovations' covariance. precision: (h,) of the priors. away: (h,) from their medians.
    """

    A: Floats
    C: Floats
    K: Floats
    V: Floats
    precision: Floats
    away: Floats

    def inputs(self, states: Floats, nu: Floats) -> tuple[Floats, Floats]:
        """B (N, n, h) and D (N, m, h) from the states (N, n) and innovations (N, m) of a pass."""
        h, rows = len(self.V), len(nu)
        B = (states @ self.A + nu @ self.K).reshape(rows, states.shape[1], h)
        D = -(states @ self.C).reshape(rows, nu.shape[1], h)
        return np.ascontiguousarray(B), np.ascontiguousarray(D)

    def information(self, rows: int) -> Floats:
        """(h, h) of the innovations' covariance, beside that of the innovations themselves."""
        flat = self.V.reshape(len(self.V), -1)
        return np.asarray(rows / 2 * flat @ flat.T)

    def score(self, white: Floats) -> Floats:
        """(h,) of the covariance, of whitened innovations (N, m)."""
        E = white.T @ white
        return np.asarray(np.einsum("hij,ij->h", self.V, E) - len(white) * np.trace(self.V, axis1=1, axis2=2)) / 2


def noise_slopes(derivatives: Sequence[GainSlope], gain: Gain, precision: Floats, away: Floats) -> NoiseSlopes:
    """The maps of derivatives of a gain."""
    W = gain.whitening
    dA, dC, dK = (np.array([getattr(c, name) for c in derivatives]) for name in ("A", "C", "K"))
    dA[:, :RIGID, :RIGID] = 0.0
    dC[:, :, :RIGID] = 0.0
    n, m = dA.shape[1], dC.shape[1]
    of_V = np.array([W @ change.V @ W.T for change in derivatives])
    by_A, by_C, by_K = (x.transpose(2, 1, 0).reshape(width, -1) for x, width in ((dA, n), (dC, n), (dK, m)))
    return NoiseSlopes(by_A, by_C, by_K, of_V, precision, away)


def _lyapunov(F: Floats, Q: Floats) -> Floats:
    """(h, n, n) solutions of P = F P F' + Q, by doubling."""
    P = Q
    for _ in range(DOUBLINGS):
        P = P + F @ P @ F.T
        F = F @ F
        if np.abs(F).max() < 1e-9:
            break
    return P


def _turning(composition: Composition, values: Mapping[str, float], plant: Plant) -> Turning:
    """How the noise's own transition depends on specific force and body rate, to first order in the period."""
    conditions, period = plant.conditions, plant.conditions.period
    base = _observed(composition.model(values, conditions), plant).F
    at_row, at_column, which, size = [], [], [], []
    for place in range(6):
        force, rate = conditions.specific_force.copy(), conditions.rate_body.copy()
        (force if place < 3 else rate)[place % 3] += 1.0
        moved = replace(conditions, specific_force=force, rate_body=rate)
        slope = (_observed(composition.model(values, moved), plant).F - base) * period
        rows, columns = np.nonzero(np.abs(slope) > 0)
        at_row += [*(rows + RIGID)]
        at_column += [*(columns + RIGID)]
        which += [place] * len(rows)
        size += [*slope[rows, columns]]
    order = np.argsort(at_row, kind="stable")
    entries, conditions_of = np.array(at_column, np.int32)[order], np.array(which, np.int32)[order]
    return _firsts(np.array(at_row, int), RIGID + len(base)), entries, conditions_of, np.array(size, float)[order]


def _without_rigid(matrix: Floats, rows: int) -> Floats:
    rest = matrix.copy()
    rest[:rows, :RIGID] = 0.0
    return rest


def _entries(matrix: Floats) -> Entries:
    rows, columns = np.nonzero(np.abs(matrix) > 1e-14 * np.abs(matrix).max())
    return _firsts(rows, len(matrix)), columns.astype(np.int32), np.ascontiguousarray(matrix[rows, columns])


def _firsts(rows: NDArray[np.int_], count: int) -> NDArray[np.int32]:
    """(count + 1,) where each row's entries begin among entries in the order of rows."""
    return np.concatenate([[0], np.cumsum(np.bincount(rows, minlength=count))]).astype(np.int32)
