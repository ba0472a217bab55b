"""Does an effect stand in for a signal that was logged late? A delay of one of them is a fault of the log, no force.

The accelerometer, gyro or velocity, or the rotors' commands, against all other signals: a shift in time makes what is
proportional to the derivative of a force, which in motion resembles inflow or lift. Delays of the pose, of the attitude
and of measured rotor speeds are candidates themselves.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from diagnosis.data.filters import advanced
from diagnosis.data.segment import Segment
from diagnosis.estimation.fitted import Fit, coefficients
from diagnosis.models import channels
from diagnosis.models.predictor import Predictor
from diagnosis.selection.candidates import shifts_rotors
from diagnosis.selection.regression import Regression, marginal, solved
from diagnosis.selection.sensor_errors import Biases
from dynamics.arrays import Floats

SIGNALS = ("accelerometer", "gyro", "velocity", "commands")


@dataclass(frozen=True)
class LateSignal:
    """A delay that explains as much as some effects.

    signal: of `SIGNALS`. delay: by which it is late, s.
    gain: twice the log-likelihood that it gains in place of the effects. of_effects: that they gain. keys: theirs.
    """

    signal: str
    delay: float
    gain: float
    of_effects: float
    keys: frozenset[str]


def late_signal(regression: Regression, fitted: Fit, rows: Sequence[Floats]) -> LateSignal | None:
    """The signal whose delay explains as much as some of the fitted effects, which explain little beside it.

    By the slopes of the regression about the fit, each flight's biases and what the flights share marginalised; None
    where there is none. rows: (m, 12) residuals of the fit on the regression's segments.
    """
    limits = regression.thresholds.late_signals
    tried = [c for c in fitted.candidates if c.effect.moves_vehicle and not shifts_rotors(c)]
    if not tried:
        return None
    signals = _signals(regression)
    gram, product = _equations(regression, fitted, rows, _slopes(regression, fitted, signals))
    places, begin = dict[str, list[int]](), 0
    for candidate in fitted.candidates:
        places[candidate.key] = list(range(begin, begin + len(candidate.columns)))
        begin += len(candidate.columns)
    effects = list(range(begin))

    def gain(some: Sequence[int]) -> float:
        return float(solved(gram[np.ix_(some, some)], product[list(some)])[1]) if len(some) else 0.0

    best, everything = None, gain(effects)
    for number, signal in enumerate(signals):
        column = begin + number
        with_both = gain([*effects, column])
        weak = []
        for candidate in tried:
            rest = [i for i in effects if i not in places[candidate.key]]
            if with_both - gain([*rest, column]) < limits.max_share_kept * (everything - gain(rest)):
                weak.append(candidate.key)
        rest = [i for i in effects if not any(i in places[key] for key in weak)]
        with_signal = [*rest, column]
        delay = float(solved(gram[np.ix_(with_signal, with_signal)], product[with_signal])[0][-1])
        of_signal, of_effects = gain(with_signal) - gain(rest), everything - gain(rest)
        explains = of_signal > limits.min_share * of_effects
        if weak and explains and limits.min_delay < abs(delay) and (best is None or of_signal > best.gain):
            best = LateSignal(signal, delay, of_signal, of_effects, frozenset(weak))
    return best


def _signals(regression: Regression) -> list[str]:
    """Signals that the segments have."""
    example = regression.segments[0]
    has = {
        "accelerometer": example.specific_force is not None,
        "gyro": example.gyro is not None,
        "velocity": example.has_pose,
        "commands": example.rotor_source != "measured",
    }
    return [signal for signal in SIGNALS if has[signal]]


def _slopes(regression: Regression, fitted: Fit, signals: Sequence[str]) -> list[Floats]:
    """(m, 12, s) of the residual by the delay of each signal, a segment each."""
    r = regression
    predictor = Predictor(
        fitted.vehicle,
        fitted.vehicle.effects,
        r.catalogue,
        speed_measured=r.segments[0].rotor_source == "measured",
        thresholds=r.thresholds.prediction,
    )
    slopes = []
    for segment in r.segments:
        step = 1 / segment.rate  # either way, so that a signal's noise is not correlated with its slope
        moved = [[_advanced(segment, signal, by) for signal in signals] for by in (-step, step)]
        late, early = ([channels.residual(one, predictor.predict(one)) for one in some] for some in moved)
        slopes.append(np.stack(late, axis=2) / (2 * step) - np.stack(early, axis=2) / (2 * step))
    return slopes


def _advanced(segment: Segment, signal: str, by: float) -> Segment:
    """The segment with one signal as it is logged `by` s later."""

    def moved(values: Floats | None) -> Floats | None:
        return None if values is None else advanced(values, segment.rate, by)

    match signal:
        case "accelerometer":
            return replace(segment, specific_force=moved(segment.specific_force))
        case "gyro":
            return replace(segment, gyro=moved(segment.gyro))
        case "velocity":
            return replace(segment, velocity=advanced(segment.velocity, segment.rate, by))
    return segment.with_rotors_later(by)


def _equations(
    regression: Regression, fitted: Fit, rows: Sequence[Floats], slopes: Sequence[Floats]
) -> tuple[Floats, Floats]:
    """(k, k) and (k,) normal equations of the effects and of the delays behind them, all else marginalised."""
    r = regression
    effects = [i for c in fitted.candidates for i in c.columns]
    theta = np.concatenate([coefficients(fitted, c) for c in fitted.candidates])
    others = [*r.shared.columns, *r.biases.columns]
    count = len(effects) + slopes[0].shape[2]
    shared = replace(r.shared, columns=tuple(range(count, count + len(r.shared.columns))))
    off = Biases(tuple(range(count + len(r.shared.columns), count + len(others))), r.biases.information)
    width = count + len(others)
    grams, products = np.zeros((len(r.flights), width, width)), np.zeros((len(r.flights), width))
    for flight, y, columns, slope in zip(r.flight_of, rows, r.columns, slopes, strict=True):
        x = r.noise.whiten(np.concatenate([columns[:, :, effects], slope, columns[:, :, others]], axis=2))
        x = x.reshape(-1, width)
        left = r.noise.whiten(y + columns[:, :, effects] @ theta).ravel()
        grams[flight] += x.T @ x
        products[flight] += x.T @ left
    gram, product = marginal(grams, products, off)
    gram, product = marginal(gram.sum(axis=0), product.sum(axis=0), shared)
    return gram[:count, :count], product[:count]
