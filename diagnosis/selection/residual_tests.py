"""Tests of an identified model's residuals: do they contain more than noise?

Force on which accelerometer and pose agree at low frequency, what a smooth function of state or position predicts, and
lines in the spectrum.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import scipy
from numpy.typing import NDArray
from scipy.linalg.lapack import dposv

from diagnosis.data.segment import Segment
from diagnosis.models.channels import ANGULAR_ACCELERATION, AXES, MOTION, POSE_ACCELERATION, SPECIFIC_FORCE, measured
from diagnosis.selection.noise import NoiseModel
from diagnosis.selection.regression import Regression
from diagnosis.selection.spectral_line import left_of_motion, line_by_chance, strongest_line
from diagnosis.thresholds import ResidualTestThresholds
from dynamics.arrays import Floats
from dynamics.state import POSITION, RATE, VELOCITY

TESTS = ("low_frequency_agreement", "predictable_from_state", "spectral_line", "position_dependent")


@dataclass(frozen=True, eq=False)
class Finding:
    """Finding of a test in the channel where that is largest.

    test: its name, that of the statistic.
    channel: place among the twelve.
    rms: of the part of the residual that the test finds, in the channel's unit.
    over_floor: the same over the floor of the channel, and of all but a line over what a named gust leaves there, too.
    part: (m,) that part of each segment.
    frequency: of a line, Hz.
    """

    test: str
    channel: int
    rms: float
    over_floor: float
    part: tuple[Floats, ...] = field(repr=False)
    frequency: float | None = None


@dataclass(frozen=True)
class Rejection:
    """A test whose statistic, its size, exceeds a threshold, and whose finding is large enough to matter."""

    test: str
    size: float
    threshold: float


@dataclass(frozen=True)
class ResidualTests:
    """Statistics of a model's residuals, near 0 or 1 where they are noise.

    low_frequency_agreement: low-frequency power common to accelerometer and pose, or of torque, over that at mid
        frequencies.
    predictable_from_state: twice the log-likelihood that a smooth function of the state, or a finer one of the
        velocity, gains on flights left out, over the number of whitened residuals, beyond a controller's answer to
        turbulence and what turbulence makes of the state a moment later; beside an estimator's slow errors, less what
        the state gains at most in surrogate (time-shifted) residuals and of its own errors.
    spectral_line: greatest narrow-band power over its surroundings, but for what a form leaves of the motion's lines.
    position_dependent: as predictable_from_state, from position alone and on the other half of each flight; 0 where it
        was not computed.
    findings: what each test finds, by its name.
    line_by_chance: narrow-band power that noise of these flights reaches once in so many cases; 0 where it was not
        computed.
    """

    low_frequency_agreement: float
    predictable_from_state: float
    spectral_line: float
    position_dependent: float = 0.0
    findings: Mapping[str, Finding] = field(default_factory=dict)
    line_by_chance: float = 0.0

    @property
    def statistics(self) -> dict[str, float]:
        """The statistics by name."""
        return {name: getattr(self, name) for name in TESTS}

    def over_floor(self, test: str) -> float:
        """Size of what a test finds over the floor of its channel."""
        return self.findings[test].over_floor if test in self.findings else 0.0


def run_residual_tests(
    regression: Regression,
    rows: Sequence[Floats],
    *,
    by_position: bool = False,
    gust: Floats | None = None,
    perturbed: Callable[[], Sequence[PerturbedResiduals]] | None = None,
) -> ResidualTests:
    """Tests of residuals (m, 12) of the regression's segments.

    by_position: whether to test what repeats at the same positions, which a gust does not. gust: (12,) RMS that one has
    in each channel, which belongs to the floor with which findings but the line are compared: air has no line.
    perturbed: makes draws of the segments with more of an estimator's errors, where one made the pose; asked where the
        state predicts more than it may.
    """
    floor = regression.noise.floor if gust is None else np.hypot(regression.noise.floor, gust)
    thresholds, total = regression.thresholds.residual_tests, max(regression.total, 1)
    states = [_state(s) for s in regression.segments]
    chances = thresholds.chances if regression.pose.there else 0
    by_state = _without_feedback(regression, rows)
    surrogates = [_rolled(by_state, n / (chances + 1)) for n in range(1, chances + 1)]
    tried = [
        _beyond_answers(
            regression, x, by_state, _predictable(regression, x, by_state, regression.flight_of, surrogates)
        )
        for x in _features_of_state(states, thresholds)
    ]
    best = max(tried, key=lambda one: one.gain)
    predictable = max(best.gain - max(one.by_chance for one in tried), 0.0)
    if perturbed is not None and predictable > regression.thresholds.verdict.max_predictable * total:
        of_errors = max(_explained_by_errors(regression, one, thresholds) for one in perturbed())
        predictable = max(predictable - of_errors, 0.0)
    findings = [_largest("predictable_from_state", best.parts, floor)]
    repeating = 0.0
    if by_position:
        positions = [s.smooth[s.decimated, POSITION] for s in regression.segments]
        fine = _features(positions, thresholds.position_fineness, thresholds.features)
        features, parts = ([half for x in whole_flights for half in _halves(x)] for whole_flights in (fine, rows))
        of_halves = _predictable(regression, features, parts, range(len(parts)))
        repeating = of_halves.gain
        of_place = {channel: (size, _joined(halves)) for channel, (size, halves) in of_halves.parts.items()}
        findings.append(_largest("position_dependent", of_place, floor))
    line, by_chance, tone = _line(rows, regression, thresholds)
    return ResidualTests(
        low_frequency_agreement=_slow_agreement(rows, regression, thresholds),
        predictable_from_state=predictable / total,
        spectral_line=line,
        line_by_chance=by_chance,
        position_dependent=repeating / total,
        findings={
            one.test: one
            for one in (*findings, _slow_force(rows, regression, floor, thresholds), tone)
            if one is not None
        },
    )


@dataclass(frozen=True, eq=False)
class PerturbedResiduals:
    """Segments with a draw of an estimator's errors.

    segments: with it. added: (m, 12) what it adds to each one's residuals under the model that is tested.
    """

    segments: Sequence[Segment]
    added: Sequence[Floats]


def _explained_by_errors(
    regression: Regression, perturbed: PerturbedResiduals, thresholds: ResidualTestThresholds
) -> float:
    """Gain of the state in residuals that are its own errors alone, under a model that is right.

    To a drag an error of velocity is force, which the measured velocity predicts as far as it is that error.
    """
    states = [_state(segment) for segment in perturbed.segments]
    tried = _features_of_state(states, thresholds)
    return max(_predictable(regression, x, perturbed.added, regression.flight_of).gain for x in tried)


def _slow_agreement(rows: Sequence[Floats], regression: Regression, thresholds: ResidualTestThresholds) -> float:
    """The agreement at low frequency; of whitened residuals where an estimator's slow errors are noise."""
    if not regression.pose.there:
        return low_frequency_agreement(rows, regression.rate, thresholds)
    whitened = []
    for r in rows:
        white = np.zeros((len(r) - regression.noise.order, r.shape[1]))
        white[:, list(regression.noise.active)] = regression.noise.whiten(r)
        whitened.append(white)
    return low_frequency_agreement(
        whitened, regression.rate, thresholds, expected=1 + regression.pose.thresholds.unsure
    )


def low_frequency_agreement(
    rows: Sequence[Floats], rate: float, thresholds: ResidualTestThresholds, *, expected: float = 1.0
) -> float:
    """Power in the low band over that in the reference band: of the forces' cross spectrum, or of a torque.

    A torque's ratio is taken lower where so few powers exceed it by chance. rows: (m, 12) residuals of each segment at
    rate Hz. expected: power of a slow force, over that of white noise.
    """
    low, reference, size = np.zeros(6), np.zeros(6), np.zeros(6)
    count_low = count_reference = 0
    for r in rows:
        waves = np.fft.rfft(r * np.hanning(len(r))[:, None], axis=0)
        frequency = np.fft.rfftfreq(len(r), 1 / rate)
        force, pose = waves[:, SPECIFIC_FORCE], waves[:, POSE_ACCELERATION]
        torque = np.abs(waves[:, ANGULAR_ACCELERATION]) ** 2
        power = np.hstack([np.real(force * np.conj(pose)), torque])
        own = np.hstack([np.abs(force) * np.abs(pose), torque])
        below, between = _inside(frequency, thresholds.low_band), _inside(frequency, thresholds.reference_band)
        low, reference = low + power[below].sum(0), reference + power[between].sum(0)
        size = size + own[between].sum(0)
        count_low, count_reference = count_low + int(below.sum()), count_reference + int(between.sum())
    low, reference = low / count_low, reference / count_reference
    size = np.maximum(size / count_reference, 1e-30)
    common = (low[:3] / expected - np.maximum(reference[:3], 0)) / size[:3]
    torque = low[3:] / np.maximum(reference[3:], 1e-30) / _excess_of_few(count_low, count_reference, thresholds)
    return float(np.max(np.concatenate([common, torque])))


def _excess_of_few(low: int, reference: int, thresholds: ResidualTestThresholds) -> float:
    """By how much the ratio of two mean powers exceeds by chance what it does with `agreement_powers` in the low band.

    At least 1. low, reference: numbers of powers under a window of Hann, two thirds of which are independent; each
    has the distribution of chi-square with two degrees of freedom.
    """
    usual = thresholds.agreement_powers
    here, there = (
        float(scipy.stats.f.isf(thresholds.chance, 2 * powers, 2 * powers * reference / low))
        for powers in (low / thresholds.window_width, usual)
    )
    return max(1.0, here / there)


def _slow_force(
    rows: Sequence[Floats], regression: Regression, floor: Floats, thresholds: ResidualTestThresholds
) -> Finding | None:
    """The slow part that accelerometer and pose share, or of a torque, beyond what their noise leaves there."""
    rate, (low, reference) = regression.rate, (thresholds.low_band, thresholds.reference_band)
    slow, middle = ([_band(r, rate, band) for r in rows] for band in (low, reference))
    share = (low[1] - low[0]) / (reference[1] - reference[0])
    frequency = np.linspace(*low, thresholds.line_rows)
    density = (1 + regression.pose.thresholds.unsure) * regression.pose.density(frequency).mean(axis=1)
    allowed = 2 * density * (low[1] - low[0])
    parts: dict[int, tuple[float, tuple[Floats, ...]]] = {}
    for axis in range(AXES):
        force, pose, torque = (part.start + axis for part in (SPECIFIC_FORCE, POSE_ACCELERATION, ANGULAR_ACCELERATION))
        for channel, other in ((force, pose), (torque, torque)):
            common, noise = (float(np.mean(np.vstack(x)[:, channel] * np.vstack(x)[:, other])) for x in (slow, middle))
            size = np.sqrt(max(0.0, common - max(noise, 0.0) * share - allowed[channel]))
            parts[channel] = (size, tuple((x[:, channel] + x[:, other]) / 2 for x in slow))
    return _largest("low_frequency_agreement", parts, floor)


def _line(
    rows: Sequence[Floats], regression: Regression, thresholds: ResidualTestThresholds
) -> tuple[float, float, Finding | None]:
    """The strongest line's power over its surroundings, that of chance where it matters, and the line itself."""
    limits = regression.thresholds.verdict
    explained = [measured(s) - r for s, r in zip(regression.segments, rows, strict=True)]
    max_rms = limits.max_excused * regression.noise.floor[MOTION]
    excused = left_of_motion(rows, explained, thresholds, max_share=limits.max_share, max_rms=max_rms)
    line = strongest_line(rows, regression.rate, thresholds, excused)
    matters = line.over_surroundings > limits.max_line
    by_chance = line_by_chance(rows, regression.rate, thresholds) if matters else 0.0
    finding = _largest("spectral_line", {line.channel: (line.rms, line.part)}, regression.noise.floor)
    shown = None if finding is None else replace(finding, frequency=line.frequency)
    return line.over_surroundings, by_chance, shown


def _largest(test: str, parts: Mapping[int, tuple[float, tuple[Floats, ...]]], floor: Floats) -> Finding | None:
    """The finding in the channel where the part is largest over its floor; None without any.

    parts: its RMS and itself, by channel.
    """
    there = [channel for channel in parts if floor[channel] > 0]
    if not there:
        return None
    channel = max(there, key=lambda c: parts[c][0] / floor[c])
    rms, part = parts[channel]
    return Finding(test, channel, float(rms), float(rms / floor[channel]), part)


def _band(values: Floats, rate: float, band: tuple[float, float]) -> Floats:
    """The part of values (m, k) inside a band, Hz."""
    waves = np.fft.rfft(values, axis=0)
    waves[~_inside(np.fft.rfftfreq(len(values), 1 / rate), band)] = 0
    return np.asarray(np.fft.irfft(waves, len(values), axis=0))


def _joined(halves: Sequence[Floats]) -> tuple[Floats, ...]:
    """Neighbouring pairs as one."""
    return tuple(np.concatenate(pair) for pair in zip(halves[::2], halves[1::2], strict=True))


def _inside(frequency: NDArray[np.floating], band: tuple[float, float]) -> NDArray[np.bool_]:
    return np.asarray((frequency > band[0]) & (frequency < band[1]))


def _features_of_state(states: Sequence[Floats], thresholds: ResidualTestThresholds) -> tuple[list[Floats], ...]:
    """Features of states (m, k), and finer ones of the velocity, which comes first in them."""
    velocities = [x[:, :AXES] for x in states]
    return (
        _features(states, thresholds.state_fineness, thresholds.features),
        _features(velocities, thresholds.velocity_fineness, thresholds.features),
    )


def _features(states: Sequence[Floats], fineness: float, count: int) -> list[Floats]:
    """Random Fourier features of states (m, k), the scaled states, and a constant."""
    everything = np.vstack(states)
    mean, deviation = everything.mean(axis=0), everything.std(axis=0) + 1e-9
    random = np.random.default_rng(0)
    directions = fineness * random.standard_normal((everything.shape[1], count))
    phase = random.uniform(0, 2 * np.pi, count)
    scaled = [(state - mean) / deviation for state in states]
    return [np.hstack([np.cos(z @ directions + phase), z, np.ones((len(z), 1))]) for z in scaled]


def _rolled(rows: Sequence[Floats], share: float) -> list[Floats]:
    """Surrogate residuals (m, 12) for each segment: all of them in a row, later by a share of their time."""
    everything = np.vstack(rows)
    later = np.roll(everything, round(share * len(everything)), axis=0)
    return np.split(later, np.cumsum([len(r) for r in rows])[:-1])


def _halves(rows: Floats) -> tuple[Floats, Floats]:
    return rows[: len(rows) // 2], rows[len(rows) // 2 :]


@dataclass(frozen=True, eq=False)
class _Prediction:
    """Prediction of residuals by features, on groups left out.

    gain: in twice the log-likelihood, summed over channels.
    by_chance: the greatest such gain in surrogate residuals; 0 without any.
    parts: by channel, the RMS and the values of what is predicted.
    """

    gain: float
    by_chance: float
    parts: dict[int, tuple[float, tuple[Floats, ...]]]


@dataclass(frozen=True, eq=False)
class _LeaveOneOut:
    """Ridge regression of residuals in one channel on the same features, leaving one group out.

    white: (m, k) whitened features of each segment. grams: (k, k), a group each.
    """

    noise: NoiseModel
    place: int
    group_of: Sequence[int]
    white: list[Floats]
    grams: list[Floats]

    @classmethod
    def on(cls, features: Sequence[Floats], noise: NoiseModel, place: int, group_of: Sequence[int]) -> _LeaveOneOut:
        """On features (m, k), in the active channel at a place."""
        white = [noise.whiten_one(place, x) for x in features]
        return cls(noise, place, group_of, white, _by_group([x.T @ x for x in white], group_of))

    def products(self, *residuals: Sequence[Floats]) -> list[Floats]:
        """(k, r) of the features and r residuals (m, 12), a group each."""
        channel = self.noise.active[self.place]
        values = [np.stack([r[:, channel] for r in rows], axis=1) for rows in zip(*residuals, strict=True)]
        white = (self.noise.whiten_one(self.place, y) for y in values)
        return _by_group([x.T @ y for x, y in zip(self.white, white, strict=True)], self.group_of)

    def predict(self, products: Sequence[Floats], ridge: float) -> _LeftOut:
        """The prediction of each group from all others. products: (k, r), a group each."""
        left_out = coefficients_without(self.grams, products, ridge)
        groups = zip(left_out, self.grams, products, strict=True)
        explained, sizes = zip(*((_columnwise(t, p), _columnwise(t, g @ t)) for t, g, p in groups), strict=True)
        size = np.sum(sizes, axis=0)
        return _LeftOut(2 * np.sum(explained, axis=0) - size, size, left_out)


@dataclass(frozen=True, eq=False)
class _LeftOut:
    """Ridge regressions' predictions of r residuals, on groups that they leave out.

    gain: (r,) in twice the log-likelihood. size: (r,) squares of what is predicted. coefficients: (k, r), a group each.
    """

    gain: Floats
    size: Floats
    coefficients: list[Floats]


def _columnwise(one: Floats, other: Floats) -> Floats:
    """(r,) products of the columns of (k, r) and (k, r)."""
    return np.asarray(np.einsum("kr,kr->r", one, other))


def _predictable(
    regression: Regression,
    features: Sequence[Floats],
    rows: Sequence[Floats],
    group_of: Sequence[int],
    surrogates: Sequence[Sequence[Floats]] = (),
) -> _Prediction:
    """Prediction of residuals (m, 12) by features (m, k), leaving one group out. surrogates: others of their size."""
    total, by_chance, noise = 0.0, np.zeros(len(surrogates)), regression.noise
    ridges = regression.thresholds.residual_tests.ridges
    parts: dict[int, tuple[float, tuple[Floats, ...]]] = {}
    for place, channel in enumerate(noise.active):
        if channel >= MOTION.stop:
            continue
        fits = _LeaveOneOut.on(features, noise, place, group_of)
        products = fits.products(rows, *surrogates)
        tried = [fits.predict(products, ridge) for ridge in ridges]
        by_chance += np.max([one.gain[1:] for one in tried], axis=0, initial=0.0)
        best = max(tried, key=lambda one: float(one.gain[0]))
        gain, predicted = float(best.gain[0]), float(best.size[0])
        if gain <= 0.0:
            continue
        total += gain
        part = tuple(x @ best.coefficients[group][:, 0] for x, group in zip(features, group_of, strict=True))
        confirmed = min(1.0, gain / predicted) if predicted > 0 else 0.0
        parts[channel] = (float(np.sqrt(confirmed * np.mean(np.concatenate(part) ** 2))), part)
    return _Prediction(total, float(np.max(by_chance, initial=0.0)), parts)


def _without_feedback(regression: Regression, rows: Sequence[Floats]) -> list[Floats]:
    """Residuals (m, 12) without the angular acceleration that goes with the rate about its own axis, and has its sign.

    In steady motion E[w dw/dt] = 0, so that a torque t of turbulence under a controller's u has E[w t] = -E[w u] > 0,
    as a damping below zero would. A missing damping has the other sign, and stays.
    """
    noise, left = regression.noise, [r.copy() for r in rows]
    for place, channel in enumerate(noise.active):
        if not ANGULAR_ACCELERATION.start <= channel < ANGULAR_ACCELERATION.stop:
            continue
        axis = channel - ANGULAR_ACCELERATION.start
        rates = [s.smooth[s.decimated, RATE][:, axis] for s in regression.segments]
        white = np.concatenate([noise.whiten_one(place, rate) for rate in rates])
        residual = np.concatenate([noise.whiten_one(place, r[:, channel]) for r in rows])
        slope = max(0.0, float(white @ residual) / max(float(white @ white), 1e-30))
        for r, rate in zip(left, rates, strict=True):
            r[:, channel] -= slope * rate
    return left


def _beyond_answers(
    regression: Regression, features: Sequence[Floats], rows: Sequence[Floats], prediction: _Prediction
) -> _Prediction:
    """A prediction less what the state ahead predicts better than the state before.

    What depends on the state does so as well on that a moment before as on that a moment after: it changes slowly. Of
    turbulence the state before knows little; the state after is its result, and the controller's answer to it.
    """
    if prediction.gain <= regression.thresholds.verdict.max_predictable * max(regression.total, 1):
        return prediction
    shift = round(regression.thresholds.residual_tests.state_shift * regression.rate)
    after, before = (
        _predictable(regression, [_moved(x, by) for x in features], rows, regression.flight_of).gain
        for by in (shift, -shift)
    )
    return replace(prediction, gain=max(prediction.gain - max(after - before, 0.0), 0.0))


def _moved(values: Floats, by: int) -> Floats:
    """(m, k) the values of rows ahead, at the ends those of the last or first one."""
    return np.asarray(values[np.clip(np.arange(len(values)) + by, 0, len(values) - 1)])


def _by_group(values: Sequence[Floats], group_of: Sequence[int]) -> list[Floats]:
    """Sums over the segments of each group."""
    sums = [np.zeros_like(values[0]) for _ in range(max(group_of) + 1)]
    for value, group in zip(values, group_of, strict=True):
        sums[group] += value
    return sums


def coefficients_without(grams: Sequence[Floats], products: Sequence[Floats], ridge: float) -> list[Floats]:
    """Ridge coefficients (k, r) from all groups but each. grams: (k, k), products: (k, r), a group each."""
    all_gram, all_product = np.sum(grams, axis=0) + ridge * np.eye(len(grams[0])), np.sum(products, axis=0)
    return [
        _of_positive_definite(all_gram - gram, all_product - product)
        for gram, product in zip(grams, products, strict=True)
    ]


def _of_positive_definite(matrix: Floats, right: Floats) -> Floats:
    """(k, r) that a symmetric positive definite matrix (k, k) takes to (k, r), by LAPACK without checks."""
    _, solution, info = dposv(matrix.T, right, overwrite_a=True)
    if info:
        raise np.linalg.LinAlgError(f"leading minor {info} of a ridge regression is not positive definite")
    return np.asarray(solution)


def _state(segment: Segment) -> Floats:
    """(m, k) quantities that a missing force may depend on."""
    smooth = segment.smooth
    velocity = np.einsum("nji,nj->ni", segment.to_world, smooth[:, VELOCITY])
    squares = segment.rotor_speed**2
    parts = [velocity, smooth[:, RATE], squares, segment.to_world[:, 2, :], smooth[:, POSITION]]
    return np.hstack(parts)[segment.decimated]
