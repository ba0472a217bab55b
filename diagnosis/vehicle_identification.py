"""A vehicle's constants from its flights: thrust, inertia, yaw authority, the motors' lag, each with an interval.

Everything is relative to the mass, which flights cannot show: the rotors carry the weight in hover, and forces and
moments scale with it. Torque constant and yaw inertia show as their ratio, and apart only where the vehicle turns about
several axes at once: there (J_z - J_y) omega_y omega_z is a moment about x. The likelihood fits them beside the drag
and the damping that fast flight has, as `alula diagnose` does. The vehicle is corrected by its values, and the logs are
read again, until these change no more.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import casadi as ca
import msgspec
import numpy as np
from scipy.special import ndtri

from diagnosis.by_likelihood import filter_required, fit_of, problems_of
from diagnosis.data.dataset import Dataset, make_dataset
from diagnosis.estimation.command_gain import command_gain
from diagnosis.estimation.fitted import Fit, ParameterEstimate
from diagnosis.likelihood.evidence import IMPOSSIBLE, Search
from diagnosis.likelihood.given_set import nearest_members
from diagnosis.likelihood.identify import Identified, identify
from diagnosis.likelihood.noise_fit import NoiseFit
from diagnosis.likelihood.problem import Problem
from diagnosis.models.command_effects import BEND
from diagnosis.signal_curve import SignalFit, signal_fit
from diagnosis.thresholds import DEFAULT
from dynamics.effect import Conditions, Effect, Parameter, Prior, Values, Wrench
from dynamics.effects import CATALOGUE
from dynamics.effects.inertia import EFFECT as INERTIA
from dynamics.effects.linear_drag import EFFECT as LINEAR_DRAG
from dynamics.effects.motor_lag import EFFECT as MOTOR_LAG
from dynamics.effects.rotor_drag import EFFECT as ROTOR_DRAG
from dynamics.effects.thrust_constant import EFFECT as THRUST_CONSTANT
from dynamics.effects.torque_constant import EFFECT as TORQUE_CONSTANT
from dynamics.errors import DataError
from dynamics.progress import Progress, no_progress
from dynamics.vehicle import GRAVITY, EffectUse, Vehicle
from flights import Flight
from flights.rotors import rotor_speeds


def damped(c: Conditions, p: Values, _: Values) -> Wrench:
    """A moment against each body rate."""
    rates = [c.rate_body[i] for i in range(3)]
    return Wrench(ca.SX.zeros(3), -ca.vertcat(*(p[axis] * rate for axis, rate in zip("xyz", rates, strict=True))))


DAMPING = Effect(
    name="axis_damping",
    summary="Moment against the body rates, each axis with its own coefficient: yaw's depends on the inertia assumed",
    source="definition",
    parameters=tuple(Parameter(axis, "N m s/rad", "", -1e3, 1e3, lambda _: Prior(0.0, 1.0)) for axis in "xyz"),
    wrench=damped,
)
DRAGS = (ROTOR_DRAG.name, LINEAR_DRAG.name)  # nearly one signal: the likelier one


def _by_rule(effect: Effect) -> Effect:
    """An effect about a constant that a rule gives, which errs by as much as half of it."""
    return replace(effect, parameters=tuple(replace(p, prior=lambda _: Prior(1.0, 0.5)) for p in effect.parameters))


def _of_either_sign(effect: Effect) -> Effect:
    """A drag that stands for all that slows a vehicle down, of which nothing may be left."""
    return replace(effect, parameters=tuple(replace(p, lower=-p.upper) for p in effect.parameters))


EFFECTS: Mapping[str, Effect] = {
    effect.name: effect
    for effect in (
        _by_rule(INERTIA),
        _by_rule(TORQUE_CONSTANT),
        THRUST_CONSTANT,
        MOTOR_LAG,
        DAMPING,
        _of_either_sign(ROTOR_DRAG),
        _of_either_sign(LINEAR_DRAG),
    )
}
LIMITS = DEFAULT.vehicle
NO_VEHICLE = "no inertia and lag that a vehicle can have fit these logs. Look at them with `alula inspect`."
NORMAL = float(ndtri(0.975))  # standard deviations in half of an interval of 95 %


@dataclass(frozen=True)
class Constant:
    """One constant.

    value: in the unit.
    half_width: of the interval of 95 %, in the unit.
    """

    value: float
    half_width: float
    unit: str

    @property
    def is_usable(self) -> bool:
        """Whether the interval is narrow enough to use the value."""
        return math.isfinite(self.half_width) and self.half_width <= LIMITS.max_interval * abs(self.value)


@dataclass(frozen=True)
class Identification:
    """Numbers that flights show of a vehicle of a given mass.

    vehicle: with the values below; its torque constant and yaw inertia have the ratio that was found.
    thrust: of all rotors at full signal, N; with measured speeds and no signal, at the vehicle's speed_max.
    thrust_constant: N s^2/rad^2.
    thrust_curve: of the motor signal; None where no signal was logged.
    inertia: about body x and y, kg m^2.
    yaw_gain: torque constant over yaw inertia, from squared rotor speed to yaw acceleration, 1/rad.
    yaw_inertia: kg m^2; None where the flights show that ratio alone, and the vehicle's was assumed.
    motor_lag: s; None where neither signals nor commands were logged.
    speed_max: rad/s; None where no rotor speed was measured.
    drag: the drag that was fitted beside them.
    is_measured: whether rotor speeds were measured.
    hover: signal in hover, None without signals.
    segments, duration: of flight that was used, and their length in s.
    chi_square: reduced, of the innovations; 1 where they are noise.
    """

    vehicle: Vehicle
    thrust: Constant
    thrust_constant: Constant
    thrust_curve: Constant | None
    inertia: tuple[Constant, Constant]
    yaw_gain: Constant
    yaw_inertia: Constant | None
    motor_lag: Constant | None
    speed_max: Constant | None
    drag: str
    is_measured: bool
    hover: float | None
    segments: int
    duration: float
    chi_square: float
    notes: tuple[str, ...]


def identify_vehicle(
    flights: Sequence[Flight],
    vehicle: Vehicle,
    catalogue: Mapping[str, Effect] = CATALOGUE,
    *,
    fit_curve: bool = True,
    progress: Progress = no_progress,
) -> Identification:
    """The constants of a vehicle of known mass and layout.

    flights: at one rate. vehicle: where the estimation begins. fit_curve: estimate the signal's curve too.
    Raises DataError where the flights cannot answer.
    """
    signal = signal_fit(flights)
    if signal is not None:
        vehicle = _with_rotors(
            vehicle, speed_max=signal.speed_max.value, thrust_curve=min(max(signal.curve.value, 0.0), 1.0)
        )
    uses: Sequence[EffectUse] = ()
    noise: Sequence[NoiseFit] = ()
    fitted: Fit | None = None
    is_inertia_rough = True
    for done in range(LIMITS.max_rounds):
        progress(done / LIMITS.max_rounds, f"estimating the constants, round {done + 1}")
        start = calibrated(vehicle, flights)
        dataset = make_dataset(flights, start)
        problems = _problems(dataset, start, catalogue)
        sets = _sets(problems[0])
        members: Sequence[int] = nearest_members(problems[0], uses) if uses else sets[0]
        result = _identified(problems, members, noise)
        is_possible = result.best.evidence != IMPOSSIBLE
        if is_inertia_rough and not is_possible:
            vehicle, is_inertia_rough = _with_linear_inertia(start, result.search, members), False
            continue
        if not uses or not is_possible:
            members = _likeliest(result.search, sets)
        noise, fitted = result.noise, fit_of(result.search, members)
        uses = [use for use in fitted.vehicle.effects if use.name in {c.effect.name for c in fitted.candidates}]
        vehicle, is_moved = _corrected(start, fitted, dataset, fit_curve=fit_curve and signal is None)
        if not is_moved and set(members) == set(result.best.members):
            break
    if fitted is None:
        raise DataError(NO_VEHICLE)
    ratio = _torque_ratio(fitted)
    if ratio is not None and ratio.std > LIMITS.max_torque_deviation * ratio.value:
        what = result.search.what
        fitted = fit_of(result.search, [i for i in members if what.all[i].effect.name != TORQUE_CONSTANT.name])
        vehicle, _ = _corrected(start, fitted, dataset, fit_curve=fit_curve and signal is None)
    return _identification(start, vehicle, fitted, dataset, signal, result.chi_square)


def _problems(dataset: Dataset, vehicle: Vehicle, catalogue: Mapping[str, Effect]) -> list[Problem]:
    """All segments, and as candidates the effects that stand for constants and those of the vehicle file."""
    every = replace(dataset, fitted=dataset.everything, flight_of=_flights(dataset), held_out=())
    own = {use.name: catalogue[use.name] for use in vehicle.effects}
    return problems_of(every, vehicle, {**own, **EFFECTS})


def _identified(problems: Sequence[Problem], members: Sequence[int], noise: Sequence[NoiseFit]) -> Identified:
    """A set about its values. noise: of each kind of logs near its best, where one was fitted."""
    with filter_required():
        return identify(problems, fixed_set=members, begin=noise if len(noise) == len(problems) else ())


def _likeliest(search: Search, sets: Sequence[Sequence[int]]) -> Sequence[int]:
    """The likeliest of some sets."""
    able = [one for one in sets if set(one) <= set(search.able)]
    best = max(able, key=lambda one: search.score(one).evidence, default=())
    if not best or search.score(best).evidence == IMPOSSIBLE:
        raise DataError(NO_VEHICLE)
    return best


def _with_linear_inertia(vehicle: Vehicle, search: Search, members: Sequence[int]) -> Vehicle:
    """The vehicle with the inertia that is likeliest where all is linear, whatever that makes of other values.

    A moment turns an inertia of r as it does 2 n - n^2 / r in the model that is linear about n. That holds for one that
    is several times too large or too small.
    """
    what, total = search.what, search.total
    members = [i for i in members if what.all[i].effect.name != TORQUE_CONSTANT.name]  # their ratio is nearly linear
    places = [place for i in members for place in what.places(i)]
    precision = total.M[np.ix_(places, places)] + np.diag(search.std[places] ** -2.0)
    values = dict(zip(places, np.linalg.solve(precision, total.g[places]), strict=True))
    inertia = next(i for i in members if what.all[i].effect.name == INERTIA.name)
    ratios = []
    for place, parameter in zip(what.places(inertia), INERTIA.parameters, strict=True):
        now, linear = 1 + total.now[place], 1 + values[place]
        ratios.append(now**2 / max(2 * now - linear, now**2 / parameter.upper))
    x, y, z = (own * ratio for own, ratio in zip(vehicle.body.inertia, ratios, strict=True))
    return msgspec.structs.replace(
        vehicle, body=msgspec.structs.replace(vehicle.body, inertia=(x, y, _possible(z, x, y)))
    )


def _sets(problem: Problem) -> list[list[int]]:
    """Sets of what these flights can show: with each drag, that of the vehicle file if it has one, and with each lag
    that is tried, or none where the file has none. First that with usual values."""
    numbers: dict[str, list[int]] = {}
    for number, candidate in enumerate(problem.what.all):
        numbers.setdefault(candidate.effect.name, []).append(number)
    own = [use.name for use in problem.vehicle.effects if use.name in DRAGS]
    drags = [name for name in own[:1] or DRAGS if name in numbers]
    if not drags:
        raise DataError(
            "the logs hold no velocity, so that drag cannot be told from thrust and inertia. Log position or velocity."
        )
    others = [numbers[name][0] for name in EFFECTS if name in numbers and name not in (MOTOR_LAG.name, *DRAGS)]
    lags = [[number] for number in numbers.get(MOTOR_LAG.name, [])]
    usual = MOTOR_LAG.defaults(problem.vehicle)
    lags.sort(key=lambda one: problem.what.all[one[0]].distance(usual))
    if all(use.name != MOTOR_LAG.name for use in problem.vehicle.effects):
        lags.append([])
    return [sorted([*others, numbers[drag][0], *lag]) for lag in lags or [[]] for drag in drags]


def calibrated(vehicle: Vehicle, flights: Sequence[Flight]) -> Vehicle:
    """The vehicle with the thrust constant with which its rotors carry it in these flights."""
    ratios = []
    for flight in flights:
        speed, _ = rotor_speeds(flight, vehicle)
        squares = np.sum(speed**2, axis=1)
        usual = np.nanpercentile(squares, 90) if np.isfinite(squares).any() else np.nan
        force = flight["specific_force"][:, 2] if flight.has("specific_force") else np.full(len(squares), GRAVITY)
        with np.errstate(invalid="ignore", divide="ignore"):
            ratio = vehicle.body.mass * force / squares
            ratios.append(ratio[(squares > LIMITS.min_loaded * usual) & np.isfinite(ratio)])
    together = np.concatenate(ratios)
    if not len(together) or not np.median(together) > 0:
        raise DataError("nowhere do the rotors carry the vehicle in these logs. Give logs of flights.")
    constant = float(np.median(together))
    ratio = vehicle.rotors.torque_constant / vehicle.rotors.thrust_constant
    return _with_rotors(vehicle, thrust_constant=constant, torque_constant=ratio * constant)


def _with_rotors(vehicle: Vehicle, **changed: float) -> Vehicle:
    """The vehicle with other constants of its rotors, at least as much thrust as it needs to exist."""
    rotors = msgspec.structs.replace(vehicle.rotors, **changed)
    needed = 1.01 * vehicle.weight / (rotors.count * rotors.thrust_constant)
    if rotors.speed_max**2 < needed:
        rotors = msgspec.structs.replace(rotors, speed_max=math.sqrt(needed))
    return msgspec.structs.replace(vehicle, rotors=rotors)


def _flights(dataset: Dataset) -> tuple[int, ...]:
    """The flight of each segment, those held out among them."""
    last = max(dataset.flight_of, default=-1) + 1
    logs = list(dict.fromkeys(s.flight for s in dataset.held_out))
    return (*dataset.flight_of, *(last + logs.index(s.flight) for s in dataset.held_out))


def _torque_ratio(fitted: Fit) -> ParameterEstimate | None:
    """Torque constant over that of the vehicle that was fitted; None where the yaw inertia was assumed."""
    return fitted.estimates.get((TORQUE_CONSTANT.name, "ratio"))


def _yaw_gain_deviation(fitted: Fit) -> float:
    """Standard deviation of torque constant over yaw inertia, over it."""
    places = {key: place for place, key in enumerate(fitted.estimates)}
    slopes = np.zeros(len(fitted.covariance))
    for key, sign in (((INERTIA.name, "ratio_z"), -1.0), ((TORQUE_CONSTANT.name, "ratio"), 1.0)):
        if key in places:
            slopes[places[key]] = sign / fitted.estimates[key].value
    return math.sqrt(max(float(slopes @ fitted.covariance @ slopes), 0.0))


def _corrected(start: Vehicle, fitted: Fit, dataset: Dataset, *, fit_curve: bool) -> tuple[Vehicle, bool]:
    """The vehicle with a fit's values, and whether one of them has moved by more than a share of its interval."""
    ratios = [fitted.estimates[INERTIA.name, f"ratio_{axis}"] for axis in "xyz"]
    x, y, z = start.body.inertia
    tilt = (x * ratios[0].value, y * ratios[1].value)
    torque = _torque_ratio(fitted)
    yaw = _possible(z if torque is None else z * ratios[2].value, *tilt)
    thrust = _thrust_ratio(fitted, dataset)
    twist = thrust.value * (1.0 if torque is None else torque.value)
    gain = start.rotors.torque_constant * twist / (z * ratios[2].value)
    constant = start.rotors.thrust_constant * thrust.value
    changed = {"thrust_constant": constant, "torque_constant": gain * yaw}
    curve = _curve(start, fitted, dataset) if fit_curve else None
    if curve is not None and abs(curve.value - start.rotors.thrust_curve) > NORMAL * curve.std:
        changed["thrust_curve"] = min(max(curve.value, 0.0), 1.0)
    body = msgspec.structs.replace(start.body, inertia=(*tilt, yaw))
    moved = [
        e
        for e in (*ratios, *([] if torque is None else [torque]))
        if abs(e.value - 1.0) > LIMITS.converged * NORMAL * e.std
    ]
    return _with_rotors(msgspec.structs.replace(start, body=body), **changed), bool(moved)


def _possible(yaw: float, x: float, y: float) -> float:
    """The moment of inertia about z that is nearest to one and possible beside those about x and y."""
    return min(max(yaw, 1.001 * abs(x - y)), 0.999 * (x + y))


def _thrust_ratio(fitted: Fit, dataset: Dataset) -> ParameterEstimate:
    """Thrust in hover over that of the vehicle that was fitted."""
    if dataset.curve is None:
        return fitted.estimates.get((THRUST_CONSTANT.name, "ratio"), ParameterEstimate(1.0, math.nan, "1"))
    gains = [gain.mean for gain in dataset.curve.gains.values()]
    ratio = command_gain(fitted, dataset.curve.mass)
    joint = ratio or ParameterEstimate(1.0, 0.0, "1")
    mean = float(np.mean(gains))
    spread = float(np.std(gains, ddof=1)) / math.sqrt(len(gains)) if len(gains) > 1 else 0.0
    return ParameterEstimate(mean * joint.value, math.hypot(mean * joint.std, spread), "1")


def _curve(start: Vehicle, fitted: Fit, dataset: Dataset) -> ParameterEstimate | None:
    """The share of the thrust that goes with the signal's square, by the slope of thrust over signal in hover."""
    bend = fitted.commands.get((BEND.name, "bend"))
    if dataset.curve is None or bend is None:
        return None
    a, b, c = dataset.curve.terms
    own, hover = start.rotors.thrust_curve, _hover_signal(start)
    slope = (1 + own * (2 * hover - 1)) / (1 + own * (hover - 1))  # d ln thrust / d ln signal of the file
    measured = slope * (b + 2 * c) / (a + b + c) * (1 + bend.value)

    def share(elasticity: float) -> float:
        return (elasticity - 1) / (elasticity * (1 - hover) - 1 + 2 * hover)

    step = 1e-3
    sensitivity = (share(measured + step) - share(measured - step)) / (2 * step)
    return ParameterEstimate(share(measured), abs(sensitivity) * slope * bend.std, "1")


def _hover_signal(vehicle: Vehicle) -> float:
    """Signal of 0 to 1 in hover."""
    share, curve = vehicle.weight / vehicle.rotors.thrust_max, vehicle.rotors.thrust_curve
    if curve < 1e-6:
        return share
    return (math.sqrt((1 - curve) ** 2 + 4 * curve * share) - (1 - curve)) / (2 * curve)


def _identification(
    start: Vehicle,
    vehicle: Vehicle,
    fitted: Fit,
    dataset: Dataset,
    signal: SignalFit | None,
    chi_square: float,
) -> Identification:
    ratios = [fitted.estimates[INERTIA.name, f"ratio_{axis}"] for axis in "xyz"]

    def constant_of(value: float, relative: float, unit: str) -> Constant:
        width = math.hypot(NORMAL * relative, LIMITS.model_error) * abs(value)
        return Constant(value, width if math.isfinite(width) else math.inf, unit)

    x, y, z = (
        constant_of(base * r.value, r.std / r.value, "kg m^2")
        for base, r in zip(start.body.inertia, ratios, strict=True)
    )
    thrust = _thrust_ratio(fitted, dataset)
    deviation = thrust.std / thrust.value
    constant = constant_of(vehicle.rotors.thrust_constant, deviation, "N s^2/rad^2")
    torque = _torque_ratio(fitted)
    twist = thrust.value * (1.0 if torque is None else torque.value)
    gain = constant_of(start.rotors.torque_constant * twist / z.value, _yaw_gain_deviation(fitted), "1/rad")
    curve, lag = _curve_and_lag(start, fitted, dataset, signal)
    full = math.hypot(deviation, _extrapolation(vehicle, curve) / NORMAL)
    return Identification(
        vehicle=vehicle,
        thrust=constant_of(vehicle.rotors.thrust_max, full, "N"),
        thrust_constant=constant,
        thrust_curve=curve,
        inertia=(x, y),
        yaw_gain=gain,
        yaw_inertia=None if torque is None else z,
        motor_lag=lag,
        speed_max=None if signal is None else _in_95(signal.speed_max),
        drag=next(key for key in fitted.keys if key in DRAGS),
        is_measured=dataset.fitted[0].rotor_source == "measured",
        hover=_hover_signal(vehicle) if curve is not None else None,
        segments=len(dataset.everything),
        duration=sum(s.duration for s in dataset.everything),
        chi_square=chi_square,
        notes=tuple(n for n in dataset.notes if dataset.curve is None or n != dataset.curve.note()),
    )


def _curve_and_lag(
    start: Vehicle, fitted: Fit, dataset: Dataset, signal: SignalFit | None
) -> tuple[Constant | None, Constant | None]:
    """Of the rotors behind their signal, where the flights show them."""
    if signal is not None:
        return _in_95(signal.curve), _in_95(signal.lag)
    bend = _curve(start, fitted, dataset)
    curve = None if bend is None else _in_95(bend)
    lag = fitted.estimates.get((MOTOR_LAG.name, "time_constant"))
    if lag is None:
        return curve, None
    return curve, Constant(lag.value, math.hypot(NORMAL * lag.std, LIMITS.lag_error * lag.value), "s")


def _in_95(estimate: ParameterEstimate) -> Constant:
    """A value with its interval of 95 %."""
    return Constant(estimate.value, NORMAL * estimate.std, estimate.unit)


def _extrapolation(vehicle: Vehicle, curve: Constant | None) -> float:
    """Half of the interval of thrust at full signal, over its value, that the curve's own interval makes."""
    if curve is None:
        return 0.0
    hover = _hover_signal(vehicle)
    share = 1 + curve.value * (hover - 1)  # thrust in hover over that at full signal, over the signal
    return abs(curve.half_width * (hover - 1) / share)


def with_yaw_inertia(identified: Identification, yaw: float) -> Identification:
    """Identification with another yaw inertia, kg m^2, and the torque constant that goes with it."""
    body = msgspec.structs.replace(identified.vehicle.body, inertia=(*identified.vehicle.body.inertia[:2], yaw))
    rotors = msgspec.structs.replace(identified.vehicle.rotors, torque_constant=identified.yaw_gain.value * yaw)
    return replace(identified, vehicle=msgspec.structs.replace(identified.vehicle, body=body, rotors=rotors))
