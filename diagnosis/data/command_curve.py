"""Thrust of the rotors over their commands, where no rotor speed was measured.

A thrust command in newtons is not thrust (0.63 to 1.7 times of it in one set of real flights), a signal of 0 to 1 has
a curve that vehicle files describe badly, both change with the battery from flight to flight, and motors differ by a
tenth. The curve is therefore fitted to these flights before anything else: for each flight the gain that carries the
weight and the motors' gains that keep the vehicle level in the mean; for all flights the curve's constant, linear and
quadratic term, with the rotors' lag as one more unknown. The lag is not applied: it is the effect `motor_lag`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.signal import lfilter

from diagnosis.data.filters import difference, simpson
from diagnosis.data.segment import Segment
from diagnosis.thresholds import DEFAULT, CommandCurveThresholds
from dynamics.arrays import Floats
from dynamics.errors import DataError
from dynamics.state import VELOCITY
from dynamics.vehicle import GRAVITY, Vehicle


@dataclass(frozen=True)
class FlightGain:
    """Gains of one flight.

    mean: thrust over that which the vehicle file gives for the commands.
    motors: each rotor's gain over that mean.
    """

    mean: float
    motors: tuple[float, ...]


@dataclass(frozen=True)
class CommandCurve:
    """Thrust of a rotor in units of its share of the weight: a + b s + c s^2, where file and gains alone give s.

    terms: a, b, c.
    gains: of each flight, by log.
    low, high: range of s that was flown; beyond it the curve is straight.
    lag: of the rotors, by the vertical force, in seconds.
    explained, without_lag: shares of that force's variance that the curve explains with and without the lag.
    """

    terms: tuple[float, float, float]
    gains: Mapping[str, FlightGain]
    low: float
    high: float
    lag: float
    explained: float
    without_lag: float

    def thrust(self, commanded: Floats) -> Floats:
        """Thrust over a rotor's share of the weight, from s. Any shape."""
        a, b, c = self.terms
        inside = np.clip(commanded, self.low, self.high)
        slope = np.maximum(b + 2 * c * inside, 0.0)
        return np.asarray(np.maximum(a + b * inside + c * inside**2 + slope * (commanded - inside), 0.0))

    def applied(self, segment: Segment, vehicle: Vehicle) -> Segment:
        """The segment with rotor speeds that give the thrust."""
        hover = vehicle.hover_speed
        commanded = (_scaled(segment, self.gains[segment.flight]).rotor_speed / hover) ** 2
        return replace(segment, rotor_speed=hover * np.sqrt(self.thrust(commanded)))

    def __str__(self) -> str:
        means = [gain.mean for gain in self.gains.values()]
        motors = np.mean([gain.motors for gain in self.gains.values()], axis=0)
        gain = f"{min(means):.2f}" + (f" to {max(means):.2f}" if len(means) > 1 else "")
        each = ", ".join(f"{motor:.2f}" for motor in motors)
        return (
            f"no measured rotor speed: by these flights the rotors give {gain} times the thrust that the vehicle file "
            f"gives for their commands, rotor by rotor {each} of that, followed with a lag of about "
            f"{1e3 * self.lag:.0f} ms ({100 * self.without_lag:.0f} % of the vertical force explained without lag, "
            f"{100 * self.explained:.0f} % with it). Mass and thrust_constant cannot be distinguished from such a "
            "gain, nor a weak rotor from a motor's own"
        )


def fit_command_curve(
    fitted: Sequence[Segment],
    held_out: Sequence[Segment],
    vehicle: Vehicle,
    thresholds: CommandCurveThresholds = DEFAULT.command_curve,
) -> CommandCurve:
    """The curve that explains the specific force along body z of the fitted segments best.

    held_out: segments of flights that need gains too; only the gains of flights without a fitted segment are
    estimated on them. Raises DataError for gains out of range.
    """
    logs = dict.fromkeys(s.flight for s in (*fitted, *held_out))
    fitted_logs = {s.flight for s in fitted}
    own = {name: [s for s in (fitted if name in fitted_logs else held_out) if s.flight == name] for name in logs}
    gains = {name: _gain(parts, vehicle, thresholds) for name, parts in own.items()}
    hover, scaled = vehicle.hover_speed, [_scaled(s, gains[s.flight]) for s in fitted]
    commanded = np.concatenate([(s.rotor_speed / hover) ** 2 for s in scaled])
    low, high = np.percentile(commanded, thresholds.command_percentiles)
    force = np.concatenate([_vertical(s) for s in scaled])
    lags = np.arange(0.0, thresholds.max_lag + 1e-4, thresholds.lag_step).tolist()
    fits = [_fit(scaled, hover, force, lag, thresholds) for lag in lags]
    best = int(np.argmax([explained for _, explained in fits]))
    terms, explained = fits[best]
    a, b, c = terms.tolist()
    if min(b + 2 * c * low, b + 2 * c * high) <= 0.0:  # the flights show no more than a gain
        a, b, c = 0.0, 1.0, 0.0
    return CommandCurve((a, b, c), gains, float(low), float(high), lags[best], explained, fits[0][1])


def _gain(segments: Sequence[Segment], vehicle: Vehicle, thresholds: CommandCurveThresholds) -> FlightGain:
    """The gains of one flight: the mean force carries the weight, the mean moment is that of the mean motion."""
    inertia, allocation = np.array(vehicle.body.inertia), vehicle.rotors.allocation
    squares = np.mean(np.concatenate([s.rotor_speed**2 for s in segments]), axis=0)
    force = float(np.mean(np.concatenate([_vertical(s) for s in segments]))) * vehicle.body.mass
    mean = force / float(allocation[0] @ squares)
    low, high = thresholds.gain
    if not low <= mean <= high:
        raise DataError(
            f"{segments[0].flight}: the rotors give {mean:.3g} times the thrust that the vehicle file gives for their "
            f"commands; wanted {low:g} to {high:g}. Check mass, thrust_constant, speed_max and thrust_curve "
            "of the file, and that it is this vehicle's."
        )
    moments = []
    for s in segments:
        rate = s.low_pass(s.body_rate)
        moments.append(inertia * difference(rate, s.rate) + np.cross(rate, inertia * rate))
    thrust = mean * squares
    missing = np.mean(np.concatenate(moments), axis=0) - allocation[1:] @ thrust
    change = np.linalg.pinv(allocation * thrust) @ np.concatenate([[0.0], missing])
    plausible = np.max(np.abs(change)) <= thresholds.max_motor_difference
    motors = 1.0 + change if plausible else np.ones(len(change))
    return FlightGain(mean, tuple(motors.tolist()))


def _scaled(segment: Segment, gain: FlightGain) -> Segment:
    return replace(segment, rotor_speed=segment.rotor_speed * np.sqrt(gain.mean * np.array(gain.motors)))


def _fit(
    segments: Sequence[Segment], hover: float, force: Floats, lag: float, thresholds: CommandCurveThresholds
) -> tuple[Floats, float]:
    """Terms of the curve at a lag and the share of variance that they explain; the air's terms are fitted with them."""
    columns = np.concatenate([_columns(s, hover, lag) for s in segments])
    weight = np.sqrt(thresholds.independent_share) / thresholds.noise
    deviation = np.concatenate([thresholds.term_std, np.full(columns.shape[1] - 3, thresholds.air_std)])
    expected = np.zeros(columns.shape[1])
    expected[1] = 1.0
    x = np.vstack([columns * weight, np.diag(1 / deviation)])
    y = np.concatenate([force * weight, expected / deviation])
    theta = np.linalg.lstsq(x, y, rcond=None)[0]
    residual = force - columns @ theta
    return theta[:3], 1.0 - float(np.var(residual) / max(np.var(force), 1e-12))


def _columns(segment: Segment, hover: float, lag: float) -> Floats:
    """(m, 3 or 5) specific force along body z of a unit of each term, m/s^2: of the curve, and of the air."""
    commanded = (lagged(segment.rotor_speed, segment.rate, lag) / hover) ** 2
    powers = [np.mean(commanded**k, axis=1) * GRAVITY for k in range(3)]
    if segment.has_pose:
        velocity = np.einsum("nji,nj->ni", segment.to_world, segment.smooth[:, VELOCITY])
        powers += [-velocity[:, 2], velocity[:, 0] ** 2 + velocity[:, 1] ** 2]
    return segment.low_pass(simpson(np.column_stack(powers)))[segment.decimated]


def _vertical(segment: Segment) -> Floats:
    """(m,) specific force along body z, of the accelerometer if there is one, m/s^2."""
    if segment.specific_force is not None:
        return segment.low_pass(simpson(segment.specific_force[:, 2]))[segment.decimated]
    world = segment.low_pass(difference(segment.velocity, segment.rate)) + np.array([0.0, 0.0, GRAVITY])
    return np.asarray(np.einsum("nj,nj->n", segment.to_world[:, :, 2], world)[segment.decimated])


def lagged(values: Floats, rate: float, lag: float) -> Floats:
    """values (n, k) behind a first-order lag in seconds that has settled at the first one. rate: Hz."""
    if lag == 0.0:
        return values
    decay = float(np.exp(-1.0 / (rate * lag)))
    return np.asarray(lfilter([1 - decay], [1.0, -decay], values, axis=0, zi=decay * values[:1])[0])
