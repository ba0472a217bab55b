"""What a command is worth: the thrust that rotors give for it, where the log knows no measured speeds.

A thrust command in newtons is not thrust (0.63 to 1.7 times of it in one set of real flights), a signal of 0 to 1 has
a curve that no vehicle file knows well, both change with the battery from flight to flight, and motors differ by a
tenth. What the commands give is therefore found from these flights before anything else: for each flight the gain that
carries the weight and the motors' gains that keep the vehicle level in the mean; for all flights the curve's constant,
linear and quadratic term, with the rotors' lag as one more unknown. The lag itself stays for `motor_lag` to name.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.signal import lfilter

from diagnosis.data.filters import difference, kept, low_pass, simpson
from diagnosis.data.segment import Segment
from dynamics.arrays import Floats
from dynamics.errors import DataError
from dynamics.vehicle import GRAVITY, Vehicle

LAGS = tuple(np.arange(0.0, 0.1501, 0.01).tolist())  # s
GAINS = (0.55, 1.8)  # thrust over the file's; beyond, the vehicle file is another vehicle's
NOISE = 0.3  # m/s^2 of specific force that other effects leave; rows are far from independent
INDEPENDENT = 0.1  # of the rows
USUAL = np.array([0.3, 1.0, 0.3])  # standard deviations of constant, linear and quadratic term
MOTORS_DIFFER = 0.25  # most by which a healthy vehicle's motors differ from their mean
RANGE = (0.5, 99.5)  # percentiles of the commands that were flown; beyond, the curve goes on straight


@dataclass(frozen=True)
class FlightGain:
    """Of one flight. mean: thrust over what the file makes of the commands. motors: each rotor's over that mean."""

    mean: float
    motors: tuple[float, ...]


@dataclass(frozen=True)
class CommandCurve:
    """Thrust of a rotor over its share of the weight: a + b s + c s^2 of s, what the file and the flight's gains say.

    gains: by log. low, high: range of s that was flown. lag: s, as far as the vertical force shows it. explained,
    without_lag: shares of its variance that the curve explains with and without the lag.
    """

    terms: tuple[float, float, float]
    gains: Mapping[str, FlightGain]
    low: float
    high: float
    lag: float
    explained: float
    without_lag: float

    def thrust(self, said: Floats) -> Floats:
        """Thrust over a rotor's share of the weight for what file and gains say of the same. Any shape."""
        a, b, c = self.terms
        inside = np.clip(said, self.low, self.high)
        slope = np.maximum(b + 2 * c * inside, 0.0)
        return np.asarray(np.maximum(a + b * inside + c * inside**2 + slope * (said - inside), 0.0))

    def applied(self, segment: Segment, vehicle: Vehicle) -> Segment:
        """The segment with rotor speeds that give the thrust."""
        hover = vehicle.hover_speed
        said = (_scaled(segment, self.gains[segment.flight]).rotor_speed / hover) ** 2
        return replace(segment, rotor_speed=hover * np.sqrt(self.thrust(said)))

    def __str__(self) -> str:
        means = [gain.mean for gain in self.gains.values()]
        motors = np.mean([gain.motors for gain in self.gains.values()], axis=0)
        gain = f"{min(means):.2f}" + (f" to {max(means):.2f}" if len(means) > 1 else "")
        each = ", ".join(f"{motor:.2f}" for motor in motors)
        return (
            f"no measured rotor speed: by these flights the rotors give {gain} times the thrust that the vehicle file "
            f"makes of their commands, rotor by rotor {each} of that, followed with a lag of about "
            f"{1e3 * self.lag:.0f} ms ({100 * self.without_lag:.0f} % of the vertical force explained without lag, "
            f"{100 * self.explained:.0f} % with it). Mass and thrust_constant cannot be told from such a gain, nor a "
            "weak rotor from a motor's own"
        )


def fit_command_curve(fitted: Sequence[Segment], held_out: Sequence[Segment], vehicle: Vehicle) -> CommandCurve:
    """The curve that explains the specific force along body z of the fitted segments best.

    held_out: segments whose flights need their own gains too, when nothing of them is fitted. Raises DataError for
    gains that no command of this vehicle can have.
    """
    logs = dict.fromkeys(s.flight for s in (*fitted, *held_out))
    known = {s.flight for s in fitted}
    own = {name: [s for s in (fitted if name in known else held_out) if s.flight == name] for name in logs}
    gains = {name: _gain(parts, vehicle) for name, parts in own.items()}
    hover, scaled = vehicle.hover_speed, [_scaled(s, gains[s.flight]) for s in fitted]
    low, high = np.percentile(np.concatenate([(s.rotor_speed / hover) ** 2 for s in scaled]), RANGE)
    wanted = np.concatenate([_vertical(s) for s in scaled])
    fits = [_fit(scaled, hover, wanted, lag) for lag in LAGS]
    best = int(np.argmax([explained for _, explained in fits]))
    terms, explained = fits[best]
    a, b, c = terms.tolist()
    if min(b + 2 * c * low, b + 2 * c * high) <= 0.0:  # no more than a gain can be told
        a, b, c = 0.0, 1.0, 0.0
    return CommandCurve((a, b, c), gains, float(low), float(high), LAGS[best], explained, fits[0][1])


def _gain(segments: Sequence[Segment], vehicle: Vehicle) -> FlightGain:
    """The gains of one flight: the mean force carries the weight, the mean moment is that of the mean motion."""
    inertia, allocation = np.array(vehicle.body.inertia), vehicle.rotors.allocation
    squares = np.mean(np.concatenate([s.rotor_speed**2 for s in segments]), axis=0)
    force = float(np.mean(np.concatenate([_vertical(s) for s in segments]))) * vehicle.body.mass
    mean = force / float(allocation[0] @ squares)
    if not GAINS[0] <= mean <= GAINS[1]:
        raise DataError(
            f"{segments[0].flight}: the rotors give {mean:.3g} times the thrust that the vehicle file makes of their "
            f"commands; wanted {GAINS[0]:g} to {GAINS[1]:g}. Check mass, thrust_constant, speed_max and thrust_curve "
            "of the file, and that it is this vehicle's."
        )
    moments = []
    for s in segments:
        rate = low_pass(s.body_rate, s.rate)
        moments.append(inertia * difference(rate, s.rate) + np.cross(rate, inertia * rate))
    given = mean * squares
    missing = np.mean(np.concatenate(moments), axis=0) - allocation[1:] @ given
    change = np.linalg.pinv(allocation * given) @ np.concatenate([[0.0], missing])
    motors = 1.0 + change if np.max(np.abs(change)) <= MOTORS_DIFFER else np.ones(len(change))
    return FlightGain(mean, tuple(motors.tolist()))


def _scaled(segment: Segment, gain: FlightGain) -> Segment:
    return replace(segment, rotor_speed=segment.rotor_speed * np.sqrt(gain.mean * np.array(gain.motors)))


def _fit(segments: Sequence[Segment], hover: float, wanted: Floats, lag: float) -> tuple[Floats, float]:
    """Terms of the curve at a lag and the share of variance that they explain; what air does is let free beside it."""
    columns = np.concatenate([_columns(s, hover, lag) for s in segments])
    weight = np.sqrt(INDEPENDENT) / NOISE
    deviation = np.concatenate([USUAL, np.full(columns.shape[1] - 3, 1.0)])
    expected = np.zeros(columns.shape[1])
    expected[1] = 1.0
    x = np.vstack([columns * weight, np.diag(1 / deviation)])
    y = np.concatenate([wanted * weight, expected / deviation])
    theta = np.linalg.lstsq(x, y, rcond=None)[0]
    left = wanted - columns @ theta
    return theta[:3], 1.0 - float(np.var(left) / max(np.var(wanted), 1e-12))


def _columns(segment: Segment, hover: float, lag: float) -> Floats:
    """(m, 3 or 5) what a unit of each term gives along body z, m/s^2; drag of climbing and lift of travelling."""
    said = (lagged(segment.rotor_speed, segment.rate, lag) / hover) ** 2
    rows = kept(len(segment), segment.rate)
    powers = [np.mean(said**k, axis=1) * GRAVITY for k in range(3)]
    if segment.has_pose:
        velocity = np.einsum("nji,nj->ni", segment.to_world, segment.smooth[:, 3:6])
        powers += [-velocity[:, 2], velocity[:, 0] ** 2 + velocity[:, 1] ** 2]
    return low_pass(simpson(np.column_stack(powers)), segment.rate)[rows]


def _vertical(segment: Segment) -> Floats:
    """(m,) specific force along body z, of the accelerometer if there is one, m/s^2."""
    rows = kept(len(segment), segment.rate)
    if segment.specific_force is not None:
        return low_pass(simpson(segment.specific_force[:, 2]), segment.rate)[rows]
    world = low_pass(difference(segment.velocity, segment.rate), segment.rate) + np.array([0.0, 0.0, GRAVITY])
    return np.asarray(np.einsum("nj,nj->n", segment.to_world[:, :, 2], world)[rows])


def lagged(values: Floats, rate: float, lag: float) -> Floats:
    """values (n, k) through a first-order lag, s, from rest at the first one."""
    if lag == 0.0:
        return values
    keep = float(np.exp(-1.0 / (rate * lag)))
    return np.asarray(lfilter([1 - keep], [1.0, -keep], values, axis=0, zi=keep * values[:1])[0])
