"""Output error: parameters for which simulated windows of flight end where the vehicle did.

The equation-error fit compares accelerations, one row at a time. Here windows are simulated open loop from measured
states with all hidden states, and the parameters are adjusted until velocity, attitude and body rate agree
(Jategaonkar, Flight Vehicle System Identification, 2nd ed. 2015, ch. 4). Each window's start, gyro's bias and clock
are unknowns of its own, which are integrated out; errors are whitened by their own covariance along the window, so
that accumulated turbulence has little weight. Slow columns are the instruments where feedback correlates a column with
the disturbance, as in `fit`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from diagnosis.data.filters import decimation
from diagnosis.data.segment import Segment
from diagnosis.estimation.equation_error import clock_variance
from diagnosis.estimation.fitted import Fit, ParameterEstimate, bounds, with_candidates
from diagnosis.models.predictor import Predictor
from diagnosis.models.rollout import SimulatedWindows, Simulator, healthy
from diagnosis.selection.candidates import make_instruments, scales_rotors
from diagnosis.thresholds import DEFAULT, Thresholds
from dynamics import quaternion
from dynamics.arrays import Floats
from dynamics.effect import Effect
from dynamics.effects.gyro_bias import SENSOR_PRIOR as GYRO_BIAS
from dynamics.effects.time_delay import SENSOR_PRIOR as CLOCK_OFFSET
from dynamics.state import ATTITUDE, HIDDEN, RATE, VELOCITY
from dynamics.vehicle import Vehicle

OUTPUTS = 9  # velocity, attitude as a rotation vector, body rate
OF_VELOCITY, OF_ATTITUDE, OF_RATE = slice(0, 3), slice(3, 6), slice(6, 9)  # among outputs, and a start's unknowns
START = 9  # unknowns of a window's start; the gyro's bias and the pose's clock make 13


@dataclass(frozen=True, eq=False)
class Refit:
    """A fit by output error.

    fit: the vehicle and the estimates.
    before, after: squared white error of a held-out window at the first and at the new values, over that of a fitted
        window at the first values.
    """

    fit: Fit
    before: float
    after: float


def refit(
    initial: Fit,
    vehicle: Vehicle,
    catalogue: Mapping[str, Effect],
    fitted: Sequence[Segment],
    held_out: Sequence[Segment],
    thresholds: Thresholds = DEFAULT,
) -> Refit | None:
    """Fit all parameters of an equation-error fit again by output error, starting at its estimates.

    vehicle: with which the first fit began. Returns None where nothing can be simulated: no pose, too few windows, or
    only faults of sensors, which do not move the vehicle.
    """
    free = [
        (c, name)
        for c in initial.candidates
        for key, name in initial.estimates
        if key == c.key and _moves(c.effect) and name not in c.effect.assumed
    ]
    if not free or any(s.lacks for s in (*fitted, *held_out)):
        return None
    names = [f"{c.key}.{name}" for c, name in free]
    instrumented = [scales_rotors(c) for c, _ in free]
    problem, held_out_problem = (
        _OutputErrorProblem(initial.vehicle, catalogue, part, names, instrumented, thresholds)
        for part in (fitted, held_out)
    )
    if not held_out_problem.count or problem.count < thresholds.output_error.min_windows:
        return None
    low, high = np.array([bounds(c.effect, name) for c, name in free]).T
    first = np.array([initial.estimates[c.key, name].value for c, name in free])
    white = problem.whitening(first)
    values, covariance = _settle(problem, first, white, (low, high), thresholds)
    before, after = (held_out_problem.cost(v, white) / held_out_problem.count for v in (first, values))
    level = problem.cost(first, white) / problem.count
    if not np.isfinite([before, after, level]).all():
        return None
    clock = [clock_variance(c.effect, name, fitted[0].rate) for c, name in free]
    keys = list(initial.estimates)
    joint = np.diag([estimate.std**2 for estimate in initial.estimates.values()])
    places = [keys.index((c.key, name)) for c, name in free]
    covariance = covariance + _by_held(initial, places)
    deviation = np.sqrt(np.diag(covariance) + clock)
    joint[np.ix_(places, places)] = covariance
    better = {
        (c.key, name): ParameterEstimate(float(v), float(d), initial.estimates[c.key, name].unit)
        for (c, name), v, d in zip(free, values, deviation, strict=True)
    }
    estimates = {**initial.estimates, **better}
    named = {f"{key}.{name}": estimate.value for (key, name), estimate in estimates.items()}
    again = Fit(with_candidates(vehicle, initial.candidates, named), estimates, initial.candidates, joint)
    return Refit(again, before / level, after / level)


def _settle(
    problem: _OutputErrorProblem, first: Floats, white: Floats, limits: tuple[Floats, Floats], thresholds: Thresholds
) -> tuple[Floats, Floats]:
    """Values to which Gauss-Newton converges from the first ones within their limits, and their covariance."""
    values, covariance = first, np.zeros((0, 0))
    for _ in range(thresholds.output_error.max_steps):
        step, covariance = problem.step(values, white)
        values = np.clip(values + step, *limits)
        if np.all(np.abs(step) <= thresholds.equation_error.converged * np.sqrt(np.diag(covariance))):
            break
    return values, covariance


def _by_held(initial: Fit, places: Sequence[int]) -> Floats:
    """(k, k) covariance that parameters have by what is held here: those assumed, and the gain of the commands."""
    assumed = [
        i for c in initial.candidates for i in initial.of(c) if list(initial.estimates)[i][1] in c.effect.assumed
    ]
    held = [*assumed, *range(len(initial.estimates), len(initial.covariance))]
    across = initial.covariance[np.ix_(places, held)]
    return np.asarray(across @ np.linalg.pinv(initial.covariance[np.ix_(held, held)]) @ across.T)


def _moves(effect: Effect) -> bool:
    """Whether an effect acts on the vehicle's motion, and not on a sensor's reading alone.

    Nor on the rotors' speed: turbulence that accumulates along a window and that commands answer looks like lag.
    """
    return effect.moves_vehicle and effect.rotor_speed is None


class _OutputErrorProblem:
    """Residuals of windows and their slopes, segment by segment."""

    def __init__(
        self,
        vehicle: Vehicle,
        catalogue: Mapping[str, Effect],
        segments: Sequence[Segment],
        names: Sequence[str],
        instrumented: Sequence[bool],
        thresholds: Thresholds,
    ) -> None:
        measured = segments[0].rotor_source == "measured"
        self._vehicle, self._segments = healthy(vehicle, catalogue, segments)
        self._predictor = Predictor(
            self._vehicle, self._vehicle.effects, catalogue, speed_measured=measured, thresholds=thresholds.prediction
        )
        self._rate, self._thresholds = segments[0].rate, thresholds.output_error
        self._simulator = Simulator(self._predictor, self._rate, names, speed_measured=measured)
        self._names, self._instrumented = names, np.array(instrumented)
        self._steps = round(self._thresholds.window * self._rate)
        self._stride = decimation(self._rate, segments[0].filters)
        possible = sum((len(s) - 1) // self._steps for s in segments)
        apart = self._steps * max(1, round(possible / self._thresholds.max_windows))
        self._starts = [range(0, len(s) - self._steps, apart) for s in self._segments]
        self.count = sum(map(len, self._starts))

    def whitening(self, values: Floats) -> Floats:
        """(9, t, t) matrices that make each output's errors along a window white."""
        errors = np.concatenate([self._errors(s, self._run(s, starts, values)) for s, starts in self._pairs()])
        covariance = np.einsum("wto,wuo->otu", errors, errors) / len(errors)
        diagonal = np.einsum("ott->ot", covariance)
        shrinkage, identity = self._thresholds.shrinkage, np.eye(diagonal.shape[1])
        covariance = (1 - shrinkage) * covariance + shrinkage * np.einsum("ot,tu->otu", diagonal, identity)
        covariance += 1e-12 * identity
        return np.asarray(np.linalg.inv(np.linalg.cholesky(covariance)))

    def cost(self, values: Floats, white: Floats) -> float:
        """Squared white error of all windows with their own unknowns at their best."""
        total = 0.0
        for segment, starts in self._pairs():
            windows = self._run(segment, starts, values)
            first = self._first(segment, windows, values)[:, :, :START]
            slopes = self._simulator.sensitivities(windows, self._parameters(values), first, held=True)
            r, n = _whitened(white, self._errors(segment, windows)), self._unknowns(windows, slopes, white)
            nn = np.einsum("wma,wmb->wab", n, n) + np.diag(_information())
            nr = np.einsum("wma,wm->wa", n, r)
            total += float(np.sum(r * r) - np.sum(nr * np.linalg.solve(nn, nr[:, :, None])[:, :, 0]))
        return total

    def step(self, values: Floats, white: Floats) -> tuple[Floats, Floats]:
        """Gauss-Newton step and the covariance of the parameters, from the spread of the windows."""
        k = len(values)
        gram, scores = np.zeros((k, k)), []
        for segment, starts in self._pairs():
            windows = self._run(segment, starts, values)
            r, n, j, z = self._white(segment, windows, values, white)
            nn = np.einsum("wma,wmb->wab", n, n) + np.diag(_information())
            nz = np.einsum("wma,wmb->wab", n, z)
            right = np.concatenate([np.einsum("wma,wmb->wab", n, j), np.einsum("wma,wm->wa", n, r)[:, :, None]], axis=2)
            solved = np.linalg.solve(nn, right)
            gram += np.einsum("wma,wmb->ab", z, j) - np.einsum("wca,wcb->ab", nz, solved[:, :, :k])
            scores.append(np.einsum("wma,wm->wa", z, r) - np.einsum("wca,wc->wa", nz, solved[:, :, k]))
        score = np.concatenate(scores)
        scale = np.sqrt(np.abs(np.diag(gram)) + 1e-300)
        inverse = np.linalg.pinv(gram / np.outer(scale, scale), rcond=1e-8) / np.outer(scale, scale)
        return inverse @ score.sum(axis=0), inverse @ (score.T @ score) @ inverse.T

    def _pairs(self) -> list[tuple[Segment, range]]:
        return [(s, starts) for s, starts in zip(self._segments, self._starts, strict=True) if len(starts)]

    def _parameters(self, values: Floats) -> Floats:
        return self._predictor.values(dict(zip(self._names, values.tolist(), strict=True)))

    def _run(self, segment: Segment, starts: Sequence[int], values: Floats) -> SimulatedWindows:
        return self._simulator.run(segment, starts, self._steps, self._parameters(values))

    def _errors(self, segment: Segment, windows: SimulatedWindows) -> Floats:
        """(W, t, 9) measured less simulated at every decimated step."""
        states, rows = windows.states[:, :: self._stride], windows.rows[:, :: self._stride]
        away = quaternion.multiply(quaternion.conjugate(states[:, :, ATTITUDE]), segment.attitude[rows])
        attitude = quaternion.logarithm(np.where(away[:, :, :1] < 0, -away, away))
        velocity = segment.velocity[rows] - states[:, :, VELOCITY]
        return np.concatenate([velocity, attitude, segment.body_rate[rows] - states[:, :, RATE]], axis=2)

    def _white(
        self, segment: Segment, windows: SimulatedWindows, values: Floats, white: Floats
    ) -> tuple[Floats, Floats, Floats, Floats]:
        """Errors (W, m), slopes in a window's unknowns (W, m, 13), in parameters (W, m, k), instruments (W, m, k)."""
        p, first = self._parameters(values), self._first(segment, windows, values)
        slopes = self._simulator.sensitivities(windows, p, first)
        theta = instruments = self._outputs(slopes, windows)[..., START:]
        if self._instrumented.any():
            speed = make_instruments(segment, self._vehicle).rotor_speed
            slow = (speed[windows.rows[:, :-1]] + speed[windows.rows[:, 1:]]) / 2
            other = self._outputs(self._simulator.sensitivities(windows, p, first, rotor_speed=slow), windows)
            instruments = np.where(self._instrumented, other[..., START:], theta)
        errors = _whitened(white, self._errors(segment, windows))
        unknowns = self._unknowns(windows, slopes, white)
        return errors, unknowns, _whitened(white, theta), _whitened(white, instruments)

    def _unknowns(self, windows: SimulatedWindows, slopes: Floats, white: Floats) -> Floats:
        """(W, m, 13) white slopes in a window's own unknowns. slopes: of the states, those of the start first."""
        own = self._outputs(slopes[..., :START], windows)
        return _whitened(white, np.concatenate([own, self._readings(windows)], axis=3))

    def _first(self, segment: Segment, windows: SimulatedWindows, values: Floats) -> Floats:
        """(W, nx, 9 + k) slopes of the windows' first states in their own unknowns and in the parameters."""
        x = windows.states[:, 0]
        first = np.zeros((len(x), x.shape[1], START + len(values)))
        first[:, VELOCITY, OF_VELOCITY] = first[:, RATE, OF_RATE] = np.eye(3)
        first[:, ATTITUDE, OF_ATTITUDE] = 0.5 * _left(x[:, ATTITUDE])[:, :, 1:]
        if self._predictor.model.hidden_count:
            for i in range(len(values)):
                change = self._thresholds.difference_step * max(abs(values[i]), 1e-6)
                moved = values + change * (np.arange(len(values)) == i)
                states = self._predictor.states(segment, self._parameters(moved))[windows.rows[:, 0]]
                first[:, HIDDEN, START + i] = (states[:, HIDDEN] - x[:, HIDDEN]) / change
        return first

    def _outputs(self, slopes: Floats, windows: SimulatedWindows) -> Floats:
        """(W, t, 9, c) slopes of the outputs, from those of the states (W, n + 1, nx, c)."""
        slopes, states = slopes[:, :: self._stride], windows.states[:, :: self._stride]
        rotation = _left(quaternion.conjugate(states[:, :, ATTITUDE])) @ slopes[:, :, ATTITUDE]
        return np.concatenate([slopes[:, :, VELOCITY], 2 * rotation[:, :, 1:], slopes[:, :, RATE]], axis=2)

    def _readings(self, windows: SimulatedWindows) -> Floats:
        """(W, t, 9, 4) slopes in the gyro's bias and in the age of the pose."""
        states = windows.states[:, :: self._stride]
        slopes = np.zeros((*states.shape[:2], OUTPUTS, 4))
        slopes[:, :, OF_RATE, 0:3] = np.eye(3)
        slopes[:, :, OF_VELOCITY, 3] = -np.gradient(states[:, :, VELOCITY], self._stride / self._rate, axis=1)
        slopes[:, :, OF_ATTITUDE, 3] = -states[:, :, RATE]
        return slopes


def _whitened(white: Floats, rows: Floats) -> Floats:
    """(W, t x 9, ...) rows of outputs (W, t, 9, ...), white along each window."""
    flat = np.einsum("otu,wuo...->wto...", white, rows)
    return np.asarray(flat.reshape(len(rows), -1, *rows.shape[3:]))


def _information() -> Floats:
    """(13,) inverse prior variances of a window's unknowns."""
    return np.array([0.0] * START + [GYRO_BIAS**-2] * 3 + [CLOCK_OFFSET**-2])


def _left(q: Floats) -> Floats:
    """(..., 4, 4) matrix of the product with a quaternion on its left."""
    w, x, y, z = np.moveaxis(q, -1, 0)
    rows = [[w, -x, -y, -z], [x, w, -z, y], [y, z, w, -x], [z, -y, x, w]]
    return np.asarray(np.moveaxis(np.array(rows), (0, 1), (-2, -1)))
