"""Thrust of the rotors over their commands, where no rotor speed was measured.

A thrust command in newtons is not thrust (0.63 to 1.7 times of it in one set of real flights), a signal of 0 to 1 has
a curve that vehicle files describe badly, both change with the battery from flight to flight, and motors differ by a
tenth. The curve is therefore fitted to these flights before anything else: for each flight the gain that carries the
weight and the motors' gains that keep the vehicle level in the mean; for all flights the motors' yaw moment and the
curve's constant, linear and quadratic term, with the rotors' lag as one more unknown. The lag is not applied: it is the
effect `motor_lag`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy

from diagnosis.data.filters import difference, simpson
from diagnosis.data.segment import Segment
from diagnosis.thresholds import DEFAULT, CommandCurveThresholds
from dynamics.arrays import Floats
from dynamics.effects import CATALOGUE
from dynamics.effects.motor_lag import EFFECT as ROTOR_LAG
from dynamics.errors import DataError
from dynamics.model import build_model
from dynamics.state import RATE, VELOCITY
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
    hover: rotor speed that carries the weight, with the file's effects on mass and thrust, rad/s.
    mass: with the file's effects over that without.
    low, high: range of s that was flown; beyond it the curve is straight.
    lag: of the rotors, by the vertical force, in seconds.
    explained, without_lag: shares of that force's variance that the curve explains with and without the lag.
    """

    terms: tuple[float, float, float]
    gains: Mapping[str, FlightGain]
    hover: float
    mass: float
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

    def applied(self, segment: Segment) -> Segment:
        """The segment with rotor speeds that give the thrust."""
        commanded = (_scaled(segment, self.gains[segment.flight]).rotor_speed / self.hover) ** 2
        speed = self.hover * np.sqrt(self.thrust(commanded))
        return replace(segment, rotor_speed=speed, carried_mass=self.mass)

    @property
    def mean_gain(self) -> float:
        """Thrust over that which the file gives for the commands, over all flights."""
        return float(np.mean([gain.mean for gain in self.gains.values()]))

    def note(self, ratio: float = 1.0, std: float | None = None) -> str:
        """Note for the user. ratio: on all gains, from a fit beside the effects; std: of that."""
        means = [ratio * gain.mean for gain in self.gains.values()]
        motors = np.mean([gain.motors for gain in self.gains.values()], axis=0)
        gain = f"{min(means):.2f}" + (f" to {max(means):.2f}" if len(means) > 1 else "")
        interval = "" if std is None else f", +- {1.96 * std * self.mean_gain:.2f}"
        each = ", ".join(f"{motor:.2f}" for motor in motors)
        return (
            f"no measured rotor speed: by these flights the rotors give {gain} times the thrust that the vehicle file "
            f"gives for their commands{interval}, rotor by rotor {each} of that, followed with a lag of about "
            f"{1e3 * self.lag:.0f} ms ({100 * self.without_lag:.0f} % of the vertical force explained without lag, "
            f"{100 * self.explained:.0f} % with it). thrust_constant cannot be distinguished from such a gain, mass "
            "only where inertia and drag of the file are right, and a weak rotor not from its motor's own gain"
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
    nominal = NominalWrench(vehicle)
    logs = dict.fromkeys(s.flight for s in (*fitted, *held_out))
    fitted_logs = {s.flight for s in fitted}
    own = [[s for s in (fitted if name in fitted_logs else held_out) if s.flight == name] for name in logs]
    gains = dict(zip(logs, _gains(own, nominal, thresholds), strict=True))
    hover, scaled = nominal.hover, [_scaled(s, gains[s.flight]) for s in fitted]
    commanded = np.concatenate([(s.rotor_speed / hover) ** 2 for s in scaled])
    low, high = np.percentile(commanded, thresholds.command_percentiles)
    force = np.concatenate([_vertical(s) - nominal.specific_force(s) for s in scaled])
    lags = np.arange(0.0, thresholds.max_lag + 1e-4, thresholds.lag_step).tolist()
    fits = [_fit(scaled, hover, force, lag, thresholds) for lag in lags]
    best = int(np.argmax([fit.explained for fit in fits]))
    curved, straight = fits[best], _fit(scaled, hover, force, lags[best], thresholds, straight=True)
    a, b, c = curved.terms
    falling = min(b + 2 * c * low, b + 2 * c * high) <= 0.0  # the flights show no more than a gain
    if falling or 1 - curved.explained > thresholds.max_curved_ratio * (1 - straight.explained):
        a, b, c = straight.terms
    return CommandCurve(
        (a, b, c),
        gains,
        hover,
        nominal.mass / vehicle.body.mass,
        float(low),
        float(high),
        lags[best],
        curved.explained,
        fits[0].explained,
    )


class NominalWrench:
    """Forces and moments of the vehicle file's effects beside the thrust of its rotors."""

    def __init__(self, vehicle: Vehicle) -> None:
        uses = [u for u in vehicle.effects if u.name in CATALOGUE and not CATALOGUE[u.name].stochastic]
        uses = [u for u in uses if CATALOGUE[u.name].rotor_speed is None and CATALOGUE[u.name].measurement is None]
        self._model = build_model(vehicle, effects=uses)
        lags = [u.parameters for u in vehicle.effects if u.name == ROTOR_LAG.name]
        self._lag = sum(values.get(name, 0.0) for values in lags for name in ROTOR_LAG.time_constants)
        self.mass, constants = self._model.mass, self._model.thrust_constants
        self.hover = float(np.sqrt(self.mass * GRAVITY / constants.sum()))
        self.allocation = vehicle.rotors.allocation * constants / vehicle.rotors.thrust_constant
        self._inertia = np.array(vehicle.body.inertia)

    def thrust(self, segment: Segment) -> Floats:
        """(n,) the rotors' specific thrust by the file, m/s^2."""
        return np.asarray(self._squares(segment) @ self.allocation[0] / self.mass)

    def specific_force(self, segment: Segment) -> Floats:
        """(m,) specific force along body z of the effects, filtered and in the residuals' rows, m/s^2."""
        force = self.of_effects(segment)[0]
        return segment.low_pass(simpson(force))[segment.decimated]

    def missing_moment(self, segment: Segment) -> Floats:
        """(n, 3) moment of the motion that the effects do not make, N m."""
        rate = segment.low_pass(segment.body_rate)
        moment = self._inertia * difference(rate, segment.rate) + np.cross(rate, self._inertia * rate)
        return np.asarray(moment - self.of_effects(segment)[1])

    def _squares(self, segment: Segment) -> Floats:
        return lagged(segment.rotor_speed, segment.rate, self._lag) ** 2

    def of_effects(self, segment: Segment) -> tuple[Floats, Floats]:
        """Specific force along body z (n,) and moment (n, 3) of the effects; zero where no pose was logged."""
        count = len(segment)
        if not segment.has_pose or not self._model.effects:
            return np.zeros(count), np.zeros((count, 3))
        squares = self._squares(segment)
        state = np.hstack([segment.smooth, np.tile(self._model.hidden_initial, (count, 1))])
        values = np.tile(self._model.parameter_values[:, None], (1, count))
        outputs = self._model.observe.map(count)(state.T, np.sqrt(squares).T, values, segment.environment.T)
        force, angular = (np.array(output).T for output in outputs[:2])
        rate = segment.smooth[:, RATE]
        moment = self._inertia * angular + np.cross(rate, self._inertia * rate) - squares @ self.allocation[1:].T
        return force[:, 2] - squares @ self.allocation[0] / self.mass, np.asarray(moment)


def _gains(
    flights: Sequence[Sequence[Segment]], nominal: NominalWrench, thresholds: CommandCurveThresholds
) -> list[FlightGain]:
    """The gains of each flight: beside one drag of all of them, the thrust carries the weight.

    A flight may turn steadily about z, where a damping that the file lacks brakes it: all flights have one yaw moment.
    """
    means = _means(flights, nominal, thresholds)
    low, high = thresholds.gain
    for segments, mean in zip(flights, means, strict=True):
        if not low <= mean <= high:
            raise DataError(
                f"{segments[0].flight}: the rotors give {mean:.3g} times the thrust that the vehicle file gives for "
                f"their commands; wanted {low:g} to {high:g}. Check mass, thrust_constant, speed_max and thrust_curve "
                "of the file, and that it is this vehicle's."
            )
    missing = [_missing(segments, mean, nominal) for segments, mean in zip(flights, means, strict=True)]
    lengths = [sum(len(s) for s in segments) for segments in flights]
    yaw = np.average([moment[2] / thrust.sum() for thrust, moment in missing], weights=lengths)
    return [
        FlightGain(mean, _motors(thrust, np.append(moment[:2], yaw * thrust.sum()), nominal, thresholds))
        for mean, (thrust, moment) in zip(means, missing, strict=True)
    ]


def _means(
    flights: Sequence[Sequence[Segment]], nominal: NominalWrench, thresholds: CommandCurveThresholds
) -> list[float]:
    """Thrust over the file's in each flight, by least squares with a drag along body z that all flights share."""
    blocks, forces = [], []
    for number, segments in enumerate(flights):
        for s in segments:
            columns = np.zeros((len(s), len(flights) + 1))
            columns[:, number] = nominal.thrust(s)
            if s.has_pose:
                columns[:, -1] = -_velocity(s)[:, 2]
            blocks.append(s.low_pass(simpson(columns))[s.decimated])
            forces.append(_vertical(s) - nominal.specific_force(s))
    weight = np.sqrt(thresholds.independent_share) / thresholds.noise
    prior = np.zeros((1, len(flights) + 1))
    prior[0, -1] = 1 / thresholds.air_std
    x, y = np.vstack([np.concatenate(blocks) * weight, prior]), np.append(np.concatenate(forces) * weight, 0.0)
    return [float(gain) for gain in np.linalg.lstsq(x, y, rcond=None)[0][:-1]]


def _missing(segments: Sequence[Segment], mean: float, nominal: NominalWrench) -> tuple[Floats, Floats]:
    """(rotors,) mean of mean gain times squared speeds, and (3,) mean moment of the motion that these do not make."""
    thrust = mean * np.mean(np.concatenate([s.rotor_speed**2 for s in segments]), axis=0)
    moments = np.concatenate([nominal.missing_moment(s) for s in segments])
    return thrust, np.mean(moments, axis=0) - nominal.allocation[1:] @ thrust


def _motors(
    thrust: Floats, missing: Floats, nominal: NominalWrench, thresholds: CommandCurveThresholds
) -> tuple[float, ...]:
    """Each rotor's gain over the mean, with which a mean moment is that of the mean motion."""
    change = np.linalg.pinv(nominal.allocation * thrust) @ np.concatenate([[0.0], missing])
    plausible = np.max(np.abs(change)) <= thresholds.max_motor_difference
    return tuple((1.0 + change if plausible else np.ones(len(change))).tolist())


def _scaled(segment: Segment, gain: FlightGain) -> Segment:
    return replace(segment, rotor_speed=segment.rotor_speed * np.sqrt(gain.mean * np.array(gain.motors)))


@dataclass(frozen=True)
class _CurveFit:
    """Terms a, b, c of a curve at some lag, and the share of the vertical force's variance that it explains."""

    terms: tuple[float, float, float]
    explained: float


def _fit(
    segments: Sequence[Segment],
    hover: float,
    force: Floats,
    lag: float,
    thresholds: CommandCurveThresholds,
    *,
    straight: bool = False,
) -> _CurveFit:
    """The curve at a lag; the air's terms are fitted with it. straight: with a linear term alone."""
    columns = np.concatenate([_columns(s, hover, lag) for s in segments])
    weight = np.sqrt(thresholds.independent_share) / thresholds.noise
    air = (thresholds.air_std, thresholds.lift_std)[: columns.shape[1] - 3]
    curve = [1e-6, thresholds.term_std[1], 1e-6] if straight else thresholds.term_std
    deviation = np.array([*curve, *air])
    expected = np.zeros(columns.shape[1])
    expected[1] = 1.0
    x = np.vstack([columns * weight, np.diag(1 / deviation)])
    y = np.concatenate([force * weight, expected / deviation])
    theta = np.linalg.lstsq(x, y, rcond=None)[0]
    residual = force - columns @ theta
    a, b, c = theta[:3].tolist()
    return _CurveFit((a, b, c), 1.0 - float(np.var(residual) / max(np.var(force), 1e-12)))


def _columns(segment: Segment, hover: float, lag: float) -> Floats:
    """(m, 3 or 5) specific force along body z of a unit of each term, m/s^2: of the curve, and of the air."""
    commanded = (lagged(segment.rotor_speed, segment.rate, lag) / hover) ** 2
    powers = [np.mean(commanded**k, axis=1) * GRAVITY for k in range(3)]
    if segment.has_pose:
        velocity = _velocity(segment)
        powers += [-velocity[:, 2], velocity[:, 0] ** 2 + velocity[:, 1] ** 2]
    return segment.low_pass(simpson(np.column_stack(powers)))[segment.decimated]


def _velocity(segment: Segment) -> Floats:
    """(n, 3) in body axes, m/s."""
    return np.asarray(np.einsum("nji,nj->ni", segment.to_world, segment.smooth[:, VELOCITY]))


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
    return np.asarray(scipy.signal.lfilter([1 - decay], [1.0, -decay], values, axis=0, zi=decay * values[:1])[0])
