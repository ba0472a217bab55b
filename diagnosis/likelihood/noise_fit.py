"""The noise's hyperparameters by maximum likelihood, and which structure of noise a set of logs has.

Fisher's scoring (Astrom, Maximum likelihood and prediction error methods, Automatica 16, 1980; Goodwin and Payne,
Dynamic System Identification, 1977, ch. 5) on a part of the flights. While the noise is fitted every candidate is free,
so that what is missing in the model is not taken for noise.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from diagnosis.data.segment import Segment
from diagnosis.likelihood.columns import Inputs
from diagnosis.likelihood.gain import Gain, NoiseSlopes, Plant, Turning, make_gain, noise_slopes, slopes
from diagnosis.likelihood.innovations import start
from diagnosis.likelihood.problem import Problem
from diagnosis.likelihood.rigid_body import Along
from diagnosis.noise.components import CATALOGUE
from diagnosis.noise.composition import Composition
from dynamics.arrays import Floats
from dynamics.rotation_matrix import logarithm
from dynamics.vehicle import Vehicle

STRUCTURES: Mapping[str, tuple[str, ...]] = {
    "filtered pose": ("filtered_pose",),
    "integrating estimator": ("integrating_estimator",),
    "smooth estimator": ("smooth_estimator",),
}
ALWAYS = ("turbulence", "slow_turbulence", "gyro", "accelerometer", "pose_readings")
DISTURBANCES = ("turbulence", "slow_turbulence")  # of these: forces and torques
MAX_STEP = 1.5  # of a hyperparameter's logarithm at once
FIRST_DAMPING, MAX_DAMPING = 0.1, 1e6  # of the information


@dataclass(frozen=True, eq=False)
class NoiseFit:
    """A structure's best values.

    values: by name. deviations: of their logarithms.
    log_likelihood: with the priors, of the part that was fitted. rows: of it.
    """

    structure: str
    composition: Composition
    values: Mapping[str, float]
    deviations: Mapping[str, float]
    log_likelihood: float
    rows: int
    gain: Gain
    slopes: NoiseSlopes
    steps: int


@dataclass(frozen=True, eq=False)
class _Data:
    """A flight about its reference, and its inputs. first: row that counts."""

    along: Along
    inputs: Inputs
    first: int


def compose(structure: str, readings: Sequence[str]) -> Composition:
    """The components of a structure for logs that have some kinds of readings."""
    names = ["rotor_motion"] if "rotor_speed" in readings else []  # its states are first: they are part of references
    names += [*ALWAYS, *STRUCTURES[structure]]
    return Composition(tuple(CATALOGUE[name] for name in names))


class Fitter:
    """The fit of one structure on some flights."""

    def __init__(self, problem: Problem, structure: str, values: Mapping[str, float] | None = None) -> None:
        self.problem, self.structure = problem, structure
        self.plant: Plant = problem.plant()
        self.composition = compose(structure, self.plant.readings)
        vehicle: Vehicle = problem.vehicle
        parameters = self.composition.parameters
        self.names = tuple(parameters)
        priors = [p.prior(vehicle) for p in parameters.values()]
        self.mean = np.log([prior.median for prior in priors])
        self.precision = np.array([1 / prior.spread**2 for prior in priors])
        self.lower = np.log([p.lower for p in parameters.values()])
        self.upper = np.log([p.upper for p in parameters.values()])
        begin = self._start()
        for place, name in enumerate(self.names):
            if values is not None and name in values:
                begin[place] = np.log(values[name])
        self.logs = np.clip(begin, self.lower, self.upper)
        self.use(problem.thresholds.seconds)
        self.data: list[_Data] = []
        self.turning: Turning | None = None
        self._residuals: list[tuple[Floats, Floats]] = []
        self.theta = np.zeros(problem.what.width)
        self.moving = np.ones(len(self.names), dtype=bool)

    def use(self, duration: float) -> None:
        """Fit on flights in turn until they last for some seconds."""
        chosen, seconds = [], 0.0
        for place, rows in enumerate(self.problem.flights):
            if seconds < duration:
                chosen.append(place)
                seconds += len(rows) * rows.period
        self.places = chosen

    def _start(self) -> Floats:
        """The priors' medians, and for the white noise of readings what their second differences show at most."""
        rows, logs = self.problem.flights[0], self.mean.copy()

        def white(values: Floats) -> Floats:
            return np.asarray(np.sqrt(np.median(np.diff(values, 2, axis=0) ** 2, axis=0) / 0.455 / 6)) + 1e-12

        root = np.sqrt(rows.period)
        gyro, force = white(rows.rate) * root, white(rows.force) * root
        turn = logarithm(np.swapaxes(rows.rotation[:-1], 1, 2) @ rows.rotation[1:])
        levels = {f"gyro.density_{axis}": gyro[i] for i, axis in enumerate("xyz")}
        levels |= {f"accelerometer.density_{axis}": force[i] for i, axis in enumerate("xyz")}
        levels["pose_readings.velocity"] = float(np.median(white(rows.velocity)))
        levels["pose_readings.attitude"] = float(np.median(white(np.cumsum(turn, axis=0))))
        levels["rotor_motion.reading"] = float(np.median(white(rows.rotor_speed(None))))
        for name, level in levels.items():
            if name in self.names:
                logs[self.names.index(name)] = np.log(level)
        return logs

    def linearise(self, only: Sequence[int] | None = None) -> None:
        """The model about the present references."""
        self.data = []
        for place in self.places:
            along = self.problem.along(place)
            first = int(self.problem.thresholds.burn_in / self.problem.flights[place].period)
            self.data.append(_Data(along, self.problem.inputs(place, along, only), first))

    def profile(self, gain: Gain) -> None:
        """The candidates' values at the present noise, by ridge regression."""
        what = self.problem.what
        M, g, columns = np.zeros((what.width, what.width)), np.zeros(what.width), list(self.data[0].inputs.used)
        for data in self.data:
            own = data.inputs
            white, _ = start(gain, own.B.shape[2]).advance(data.along.model, own.B, own.D)
            flat = white[data.first :].reshape(-1, white.shape[2])
            sums = flat.T @ flat
            M[np.ix_(columns, columns)] += sums[1:, 1:]
            g[columns] += sums[0, 1:]
        size = np.sqrt(np.diag(M))
        sizes = [std for one in what.discrepancies for std in one.deviations]
        lasting = np.array([True] * len(what.columns) + [n.lasts in ("always", "flight") for n in what.nuisances])
        lasting = np.concatenate([lasting, np.ones(len(sizes), dtype=bool)])
        used = (size > 0) & lasting
        scaled = M[np.ix_(used, used)] / size[used] / size[used][:, None]
        prior = np.concatenate(
            [
                np.full(len(what.columns), self.problem.thresholds.ridge),
                [1 / n.std**2 for n in what.nuisances],
                [1 / std**2 for std in sizes],
            ]
        )[used]
        of_nuisances = np.arange(what.width)[used] >= len(what.columns)
        prior[of_nuisances] /= size[used][of_nuisances] ** 2
        self.theta = np.zeros(what.width)
        self.theta[used] = np.linalg.solve(scaled + np.diag(prior), g[used] / size[used]) / size[used]

        weights = np.concatenate([[1.0], -self.theta[columns]])
        self._residuals = [
            (np.ascontiguousarray((x.B @ weights)[:, :, None]), np.ascontiguousarray((x.D @ weights)[:, :, None]))
            for x in (data.inputs for data in self.data)
        ]

    def objective(self, gain: Gain, logs: Floats) -> float:
        """Log-likelihood of the residuals at the candidates' values, with the noise's priors."""
        total = 0.0
        for data, (B, D) in zip(self.data, self._residuals, strict=True):
            white, _ = start(gain, 1).advance(data.along.model, B, D)
            part = white[data.first :]
            total -= (np.sum(part**2) + len(part) * gain.log_determinant) / 2
        return float(total - np.sum(self.precision * (logs - self.mean) ** 2) / 2)

    def derivatives(self, gain: Gain, logs: Floats) -> tuple[Floats, Floats]:
        """Gradient and Fisher's information of the objective in the hyperparameters' logarithms."""
        noise = self.noise_slopes(gain, logs)
        inverse, rows = np.linalg.inv(gain.whitening), 0
        gradient, fisher = -noise.precision * noise.away, np.diag(noise.precision)
        for data, (B, D) in zip(self.data, self._residuals, strict=True):
            white, states = start(gain, 1).advance(data.along.model, B, D, path=True)
            moved = noise.inputs(states, white[:, :, 0] @ inverse.T)
            Z, _ = start(gain, len(logs)).advance(data.along.model, *moved)
            Z, e = Z[data.first :].reshape(-1, len(logs)), white[data.first :, :, 0]
            gradient = gradient - Z.T @ e.ravel() + noise.score(e)
            fisher = fisher + Z.T @ Z
            rows += len(e)
        return gradient, fisher + noise.information(rows)

    def noise_slopes(self, gain: Gain, logs: Floats) -> NoiseSlopes:
        """How innovations change with the hyperparameters' logarithms."""
        derivatives = slopes(self.composition, logs, self.names, self.plant, gain)
        return noise_slopes(derivatives, gain, self.precision, logs - self.mean)

    def gain(self, logs: Floats) -> Gain:
        """The filter at logarithms of the hyperparameters."""
        values = dict(zip(self.names, np.exp(logs), strict=True))
        gain = make_gain(self.composition, values, self.plant, self.turning)
        self.turning = gain.turning
        return gain

    def ascend(self, steps: int) -> NoiseFit:
        """Scoring with bounds; damping follows how much of the expected climb a step makes (Levenberg, Marquardt)."""
        logs, damping, raised = self.logs, FIRST_DAMPING, 2.0
        gain = self.gain(logs)
        best, taken, fresh = self.objective(gain, logs), 0, True
        while taken < steps:
            if fresh:
                gradient, fisher = self.derivatives(gain, logs)
                taken += 1
            step = self._step(logs, gradient, fisher, damping)
            trial = np.clip(logs + step, self.lower, self.upper)
            expected = float(gradient @ step - step @ fisher @ step / 2)
            try:
                other = self.gain(trial)
                value = self.objective(other, trial)
            except (np.linalg.LinAlgError, ValueError):
                value = -np.inf
            fresh = value > best
            if fresh:
                gained, best, logs, gain = value - best, value, trial, other
                damping *= max(1 / 3, 1 - (2 * gained / max(expected, gained) - 1) ** 3)
                raised = 2.0
                if gained < self.problem.thresholds.converged:
                    break
            else:
                if expected < self.problem.thresholds.converged or damping > MAX_DAMPING:
                    break
                damping, raised = damping * raised, 2 * raised
        self.logs = logs
        values = dict(zip(self.names, np.exp(logs).tolist(), strict=True))
        rows = sum(len(self.problem.flights[p]) - d.first for p, d in zip(self.places, self.data, strict=True))
        deviations = dict(zip(self.names, np.sqrt(np.diag(np.linalg.inv(fisher))).tolist(), strict=True))
        noise = self.noise_slopes(gain, logs)
        return NoiseFit(self.structure, self.composition, values, deviations, best, rows, gain, noise, taken)

    def _step(self, logs: Floats, gradient: Floats, fisher: Floats, damping: float) -> Floats:
        """A damped step; parameters at a bound that would leave it are held."""
        free, step = self.moving.copy(), np.zeros(len(logs))
        for _ in range(4):
            places = np.flatnonzero(free)
            step[:] = 0.0
            matrix = fisher[np.ix_(places, places)]
            step[places] = np.linalg.solve(matrix + damping * np.diag(np.diag(matrix)), gradient[places])
            outward = ((logs <= self.lower + 1e-9) & (step < 0)) | ((logs >= self.upper - 1e-9) & (step > 0))
            if not np.any(outward & free):
                break
            free &= ~outward
        return np.clip(step, -MAX_STEP, MAX_STEP)


def fit_noise(
    problem: Problem, structure: str, *, values: Mapping[str, float] | None = None, only: Sequence[int] | None = None
) -> NoiseFit:
    """The noise of one structure: from afar on a part first, or from values near the best."""
    t, fitter = problem.thresholds, Fitter(problem, structure, values)
    if values is None:
        for _ in range(2):
            _relinearised_fit(fitter, t.first_seconds, t.first_steps, only)
    return _relinearised_fit(fitter, t.seconds, t.steps, only)


def refit_disturbances(problem: Problem, noise: NoiseFit, only: Sequence[int]) -> NoiseFit:
    """The noise with the turbulence's values at their best beside some candidates and all discrepancies: what these do
    not explain it takes for its own. Along present references."""
    fitter = Fitter(problem, noise.structure, noise.values)
    fitter.moving = np.array([name.split(".")[0] in DISTURBANCES for name in fitter.names])
    gain = fitter.gain(fitter.logs)
    fitter.linearise(only)
    fitter.profile(gain)
    return fitter.ascend(problem.thresholds.steps)


def _relinearised_fit(fitter: Fitter, duration: float, steps: int, only: Sequence[int] | None) -> NoiseFit:
    """A fit about references as the present noise predicts them, with the candidates' values at it."""
    fitter.use(duration)
    gain = fitter.gain(fitter.logs)
    fitter.problem.relinearise(gain, fitter.places)
    fitter.linearise(only)
    fitter.profile(gain)
    return fitter.ascend(steps)


def likeliest(problem: Problem, structures: Sequence[str]) -> NoiseFit:
    """The noise of the structure that a part of the flights makes likeliest, fitted on more of them."""
    if len(structures) == 1:
        return fit_noise(problem, structures[0])
    t, begun = problem.thresholds, dict(problem.references)
    fits: list[NoiseFit] = []
    for structure in structures:  # they differ in the pose's errors: of all else the first one's values are near
        problem.references = dict(begun)
        fitter = Fitter(problem, structure, fits[0].values if fits else None)
        turns = 1 if fits else 2
        fits.append([_relinearised_fit(fitter, t.first_seconds, t.first_steps, None) for _ in range(turns)][-1])
    best = max(fits, key=lambda fit: fit.log_likelihood)
    problem.references = begun
    return fit_noise(problem, best.structure, values=best.values)


def structures_of(segment: Segment) -> tuple[str, ...]:
    """The structures that a log's pose may have; among an estimator's the likelihood decides."""
    captured, *estimators = STRUCTURES
    return tuple(estimators) if segment.pose_source == "estimator" else (captured,)
