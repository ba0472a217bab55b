"""What a model misses in flight: a Kalman filter of a disturbance and of chosen parameters, on velocities and rates.

Offset-free MPC (Pannocchia and Rawlings 2003) with a disturbance in two parts by axis, accelerations beyond the model:
one that stays (random walk), so that a constant one leaves no error, and one that fades (first-order Gauss-Markov), so
that a gust is not expected to last for a horizon. Parameters of effects (wind, drag, ...) are states of the same filter
(extended Kalman filter, Ljung 1979): what they explain leaves the disturbance, and what no data shows keeps its value.
Derived in docs/adaptation.md. Pure: times are arguments.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Literal, NamedTuple, get_args

import msgspec
import numpy as np
from msgspec import Meta

from dynamics.active_effect import activate, model_parameters
from dynamics.arrays import Floats
from dynamics.effect import Effect
from dynamics.effects import CATALOGUE, wind
from dynamics.errors import RequestError
from dynamics.own_effects import catalogue_of
from dynamics.state import RATE, RIGID_BODY_STATES, VELOCITY
from dynamics.vehicle import EffectUse, Vehicle
from runtime.control.kernel_model import FlownModel
from runtime.control.rti.solver import AXES, FADING, FOLLOWED, MAX_FOLLOWED, STAYING, RtiSolver

Positive = Annotated[float, Meta(gt=0)]
NotNegative = Annotated[float, Meta(ge=0)]
Mode = Literal["off", "shadow", "on"]
Group = Literal["other", "drag", "air"]
MAX_INTERVAL = 0.1  # s between two estimates, beyond which the filter goes on from the newer one
MAX_PAUSE = 10.0  # s without an estimate, after which nothing that was estimated holds any more
HISTORY = 64  # commands that are remembered
DESCRIBE_EVERY = 10  # commands
MOTION = np.r_[VELOCITY, RATE]
FLOWN_FADES = slice(AXES, 2 * AXES)  # of a solver's disturbance


class AxisNoise(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Noise of one kind of axis. Accelerations: m/s^2 or rad/s^2.

    measurement: standard deviation of an estimate's velocity or rate, m/s or rad/s.
    drift: of the staying part, acceleration per sqrt(s).
    fading: standard deviation of the fading part, acceleration.
    fading_time: s in which it falls to 1/e.
    limit: of the sum of both parts, acceleration.
    """

    measurement: Positive
    drift: Positive
    fading: Positive
    fading_time: Positive
    limit: Positive


class GuardLimits(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """When what was estimated is not flown: where it has forecast worse than the vehicle file's model does.

    forecast: s ahead.
    averaging: s over which squared errors are averaged, and in which what was estimated fades from the flight.
    tolerance: ratio of errors up to which it is trusted.
    linear_resolution: m/s, error of a velocity that does not count.
    angular_resolution: rad/s, of a rate.
    """

    forecast: Positive = 0.2
    averaging: Positive = 1.0
    tolerance: Positive = 1.1
    linear_resolution: Positive = 0.03
    angular_resolution: Positive = 0.1


class AdaptationSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """How a model follows in flight.

    mode: "off", "shadow" (estimated and recorded, not flown) or "on".
    follow: effects whose parameters are estimated; those that the model lacks are added to it.
    thrust_lag: s by which thrust follows its commands later than the model predicts.
    moments: whether the angular disturbance is flown, too: with planned rotor speeds it holds what the autopilot's rate
        loop does otherwise, and makes tracking worse.
    linear: noise of velocities, world axes.
    angular: of body rates, body axes.
    gate: standard deviations beyond which an estimate has jumped.
    start: standard deviation of the staying part at the start, as a share of the fading part's.
    drift: of a parameter, as a share of its prior's standard deviation per sqrt(s).
    window: s over which a drag's slope must vary for it to be followed.
    variation: by how much, m/s^2 per standard deviation of its prior.
    drag_deviations: from zero, beyond which a drag is certain, and shows the wind where it does not vary itself.
    leaving_time: s in which the linear part that stays leaves to the wind, where that is followed: both are constant
        forces, and their difference would wander.
    prior_scale: of the priors' standard deviations: a flight in strong wind is none of the usual ones.
    """

    mode: Mode = "off"
    follow: tuple[str, ...] = ()
    thrust_lag: NotNegative = 0.0
    moments: bool = False
    linear: AxisNoise = AxisNoise(measurement=0.02, drift=0.5, fading=1.0, fading_time=1.0, limit=5.0)
    angular: AxisNoise = AxisNoise(measurement=0.05, drift=0.5, fading=2.0, fading_time=0.3, limit=30.0)
    gate: Positive = 6.0
    start: Positive = 1.0
    drift: Positive = 0.05
    window: Positive = 3.0
    variation: Positive = 0.3
    drag_deviations: Positive = 3.0
    leaving_time: Positive = 10.0
    prior_scale: Positive = 3.0
    guard: GuardLimits = GuardLimits()


@dataclass(frozen=True)
class FollowedParameter:
    """A parameter that is followed in flight.

    name: as in the model's parameter vector, such as "wind.x".
    index: its place there.
    value, std: its prior.
    lower, upper: its bounds.
    group: "drag" shows where its slope varies, whose constant part depends on the wind; "air", the wind, beside a drag
        that shows or is certain; "other" always.
    unit: SI.
    """

    name: str
    index: int
    value: float
    std: float
    lower: float
    upper: float
    group: Group = "other"
    unit: str = ""


def with_followed(vehicle: Vehicle, names: Sequence[str], catalogue: Mapping[str, Effect] = CATALOGUE) -> Vehicle:
    """The vehicle with those of the effects that it lacks, each as if it were not there.

    Raises RequestError for an effect that is not in the catalogue, of one rotor, or that noise drives.
    """
    offered = catalogue_of(vehicle, catalogue)
    there = {use.name for use in vehicle.effects}
    for name in names:
        effect = offered.get(name)
        if effect is None or effect.per_rotor or effect.stochastic or not effect.moves_vehicle:
            what = "not in the catalogue" if effect is None else "of one rotor, of a sensor or random"
            raise RequestError(f"{name} cannot be followed in flight: it is {what}. `alula effects` lists all effects.")
    neutral = (
        EffectUse(name, {p.name: p.neutral for p in offered[name].parameters}) for name in names if name not in there
    )
    return vehicle.with_effects(*neutral)


def followed_parameters(
    model: FlownModel, names: Sequence[str], *, prior_scale: float = 1.0
) -> list[FollowedParameter]:
    """The parameters of those effects that are in a model. The bounds and priors are the effects' own."""
    active, _ = activate(model.vehicle, model.vehicle.effects, catalogue_of(model.vehicle))
    places = list(model_parameters(model.vehicle, active))
    has_drag = any(item.effect.resists_air for item in active)
    followed = []
    for item in active:
        group: Group = "drag" if item.effect.resists_air else "other"
        if item.effect.wind is not None and has_drag:
            group = "air"
        for parameter in item.effect.parameters if item.effect.name in names else ():
            if item.effect.wind is not None and parameter.name == wind.COEFFICIENT.name:
                continue  # acts without a drag alone, where only its product with the wind would show
            name, std = f"{item.key}.{parameter.name}", prior_scale * parameter.prior(model.vehicle).std
            bounds = parameter.lower, parameter.upper
            value = item.values[parameter.name]
            place = places.index(name)
            followed.append(FollowedParameter(name, place, value, std, *bounds, group, parameter.unit))
    return followed


class FlightFilter:
    """Estimates what accelerates the vehicle beyond its model, and the parameters that are followed.

    A view of the filter in a solver's C code (flight_filter.h), for one model.

    staying, fading: (6,) parts of the disturbance, linear m/s^2 in world axes, then angular rad/s^2 in body axes.
    prior: (n,) values of the parameters before any flight.
    followed: (n,) whether the data can show a parameter now.
    trust: (2,) share with which what was estimated is flown: linear disturbance and parameters; angular disturbance.
    squares: (2, 2) mean square errors of forecasts, linear and angular, by what was estimated and by the file's model.
    rejected: number of estimates that jumped.
    """

    def __init__(
        self, solver: RtiSolver, settings: AdaptationSettings, parameters: Sequence[FollowedParameter] = ()
    ) -> None:
        """Raises RequestError for more parameters than the kernel has room for."""
        if len(parameters) > MAX_FOLLOWED:
            raise RequestError(
                f"{len(parameters)} parameters are to be followed in flight, at most {MAX_FOLLOWED} can."
            )
        self.settings, self.parameters = settings, tuple(parameters)
        self._solver = solver
        self._fill_options()
        last = FOLLOWED + len(self.parameters)
        self._covariance = solver.filter_covariance[:last, :last]
        parts = slice(STAYING, FADING), slice(FADING, FOLLOWED), slice(FOLLOWED, last)
        self.staying, self.fading, self._moved = (solver.filter_state[part] for part in parts)
        self.trust, self.squares = solver.filter_trust, solver.filter_squares
        self.followed = solver.filter_followed[: len(self.parameters)]
        self.prior = np.array([p.value for p in self.parameters])
        self._scale = np.array([p.std for p in self.parameters])
        self.index = np.array([p.index for p in self.parameters], dtype=int)
        self.clear()

    def clear(self) -> None:
        """Forget everything."""
        self._solver.clear_filter()
        self.rejected = 0
        self._time = -np.inf

    def restart(self, state: Floats, time: float) -> None:
        """Go on from an estimate (nx,), as after a gap or where one jumped; what it estimates stays."""
        self._solver.restart_filter(state)
        self._time = time

    def compare(self, before: Floats, change: Floats, state: Floats, time: float) -> None:
        """Take an estimate (nx,) after the one before. change: (6,) of velocity and rate, by the model alone."""
        if self._begins(time):
            self._count(self._solver.compare_in_filter(before, change, state, time - self._time), time)
        else:
            self.restart(state, time)

    def follow(self, before: Floats, speeds: Floats, seconds: Floats, state: Floats, time: float) -> None:
        """Take an estimate (nx,) after the one before. speeds: (k, n) rad/s, each acted for its seconds (k,)."""
        if self._begins(time):
            self._count(self._solver.follow(before, speeds, seconds, state), time)
        else:
            self.restart(state, time)

    def _begins(self, time: float) -> bool:
        return 0 < time - self._time <= MAX_INTERVAL

    def _count(self, used: bool, time: float) -> None:
        self.rejected += not used
        self._time = time

    @property
    def values(self) -> Floats:
        """(n,) of the parameters."""
        return np.asarray(self.prior + self._scale * self._moved)

    @property
    def flown_values(self) -> Floats:
        """(n,) the same, as far as they are trusted."""
        return np.asarray(self.prior + self.trust[0] * self._scale * self._moved)

    @property
    def deviations(self) -> Floats:
        """(n,) standard deviations of the parameters."""
        return np.asarray(self._scale * np.sqrt(self._covariance.diagonal()[FOLLOWED:]))

    def _fill_options(self) -> None:
        options, settings = self._solver.filter_options, self.settings
        kinds = [settings.linear] * 3 + [settings.angular] * 3
        for name in ("measurement", "drift", "fading", "fading_time", "limit"):
            getattr(options, name)[:] = [getattr(kind, name) for kind in kinds]
        options.start[:] = [settings.start * kind.fading for kind in kinds]
        options.gate, options.parameter_drift = settings.gate, settings.drift
        options.window, options.variation = settings.window, settings.variation
        options.drag_deviations, options.leaving_time = settings.drag_deviations, settings.leaving_time
        guard = settings.guard
        options.forecast, options.averaging, options.tolerance = guard.forecast, guard.averaging, guard.tolerance
        options.resolution[:] = guard.linear_resolution, guard.angular_resolution
        options.count = len(self.parameters)
        for j, parameter in enumerate(self.parameters):
            options.prior[j], options.scale[j] = parameter.value, parameter.std
            options.lower[j], options.upper[j] = parameter.lower, parameter.upper
            options.index[j], options.group[j] = parameter.index, get_args(Group).index(parameter.group)


class FollowedValue(msgspec.Struct, frozen=True):
    """A parameter that follows. before: as the flown model has it. std: standard deviation. unit: SI."""

    value: float
    std: float
    before: float
    unit: str


class Followed(msgspec.Struct, frozen=True):
    """What a model follows.

    parameters: by name, such as "wind.x".
    disturbance: (6,) accelerations beyond the model, linear m/s^2 in world axes, then angular rad/s^2 in body axes.
    trust: (2,) share with which this is flown: linear disturbance and parameters; angular disturbance.
    """

    parameters: dict[str, FollowedValue]
    disturbance: tuple[float, ...]
    trust: tuple[float, float]


class Measured(NamedTuple):
    """An estimate with the model's hidden states at its time: state (nx,); predicted: (13,) of it, None to be found."""

    time: float
    state: Floats
    predicted: Floats | None


class Adaptation:
    """Lets a solver's model follow the flight: commands and estimates in, disturbance and parameters out.

    changed: which parameters are surely not as in the model, with values and 95 % intervals; empty for none.
    newest: time of the last estimate, s, which a reset does not forget; -inf before the first.
    """

    def __init__(
        self,
        solver: RtiSolver,
        settings: AdaptationSettings,
        *,
        thrust_constants: Floats,
        period: float,
        learned: bool = False,
    ) -> None:
        """thrust_constants: (n,) N s^2/rad^2. period: between commands, s.

        learned: whether predictions come with the estimates, from a learned model.
        """
        self.changed = ""
        scale = settings.prior_scale
        parameters = () if learned else followed_parameters(solver.model, settings.follow, prior_scale=scale)
        self.filter = FlightFilter(solver, settings, parameters)
        self._solver, self._settings, self._learned, self._period = solver, settings, learned, period
        self._thrust_constants = thrust_constants
        self._highest_speed = solver.input_upper.copy()
        noise = settings.linear, settings.angular
        solver.disturbance[2 * AXES :] = [1 / kind.fading_time for kind in noise]
        hover = solver.trim.rotor_speed
        self._times = np.full(HISTORY, -np.inf)
        self._speeds = np.tile(hover, (HISTORY, 1))  # as far as thrust has followed, in the mean of a period
        self._response = hover.copy()
        self._count = 0
        self._last: tuple[float, Floats] | None = None
        self.newest = -math.inf
        self._measured: Measured | None = None
        self._compared: Measured | None = None

    @property
    def followed(self) -> Followed:
        """What has been estimated so far."""
        filtered = self.filter
        parts = zip(filtered.parameters, filtered.values.tolist(), filtered.deviations.tolist(), strict=True)
        return Followed(
            {p.name: FollowedValue(value, std, p.value, p.unit) for p, value, std in parts},
            tuple((filtered.staying + filtered.fading).tolist()),
            (float(filtered.trust[0]), float(filtered.trust[1])),
        )

    def _describe_changes(self) -> str:
        filtered, limit = self.filter, self._settings.drag_deviations
        if not filtered.parameters:
            return ""
        away, deviations = filtered.values - filtered.prior, filtered.deviations
        surely = np.flatnonzero((np.abs(away) > limit * deviations) & (filtered.followed > 0))
        texts = [
            f"{p.name} {filtered.values[i]:.3g} +- {2 * deviations[i]:.2g} {p.unit}"
            for i, p in enumerate(filtered.parameters)
            if i in surely
        ]
        return ", ".join(texts)

    @property
    def refusal(self) -> str:
        """By how much forces and parameters forecast worse than the file's model; empty where they do not."""
        if self.filter.trust[0] >= 1.0:
            return ""
        own, file = self.filter.squares[0]
        return f"{math.sqrt(own / max(file, 1e-12)):.2g} times its error"

    @property
    def flies(self) -> bool:
        """Whether what is estimated is flown."""
        return self._settings.mode == "on"

    def reset(self, time: float) -> None:
        """Forget commands and estimates; after a long pause what they showed, too."""
        if time - self.newest > MAX_PAUSE:
            self.filter.clear()
            self._fly()
        self._times[:], self._count = -np.inf, 0
        self._response[:] = self._solver.trim.rotor_speed
        self._last = self._measured = self._compared = None

    def command(self, time: float, speed: Floats) -> None:
        """Add rotor speeds (n,) rad/s that act from a time on."""
        self._last = time, speed

    def sent(self, collective_thrust: float, acts_at: float, effectiveness: float) -> None:
        """Tell what left in place of the last command, N, and from when on it acts, s.

        effectiveness: thrust per modelled thrust; below 1 the rotors do not give their thrust at full speed any more.
        """
        if self.flies:
            self._solver.input_upper[:] = self._highest_speed * math.sqrt(min(effectiveness, 1.0))
        if self._last is None or self._last[0] != acts_at:
            self._compared = None  # a fallback that is none of the controller's commands
            return
        speed = self._last[1]
        commanded = float((speed * speed) @ self._thrust_constants)
        self._last = acts_at, speed * math.sqrt(collective_thrust / commanded)

    def measure(self, time: float, state: Floats, predicted: Floats | None) -> None:
        """Take an estimate with the model's hidden states (nx,), to be compared by the next `update`."""
        self._measured, self.newest = Measured(time, state.copy(), predicted), time

    def update(self) -> None:
        """Compare the last estimate with its prediction from the one before, and fly what follows."""
        self._respond()
        before, now = self._compared, self._measured
        if now is None or (before is not None and now.time <= before.time):
            return
        self._compared = now
        if before is None or (self._learned and now.predicted is None):
            self.filter.restart(now.state, now.time)
        elif now.predicted is not None:
            change = (now.predicted - before.state[:RIGID_BODY_STATES])[MOTION]
            change -= (now.time - before.time) * (
                self._solver.disturbance[:AXES] + self._solver.disturbance[FLOWN_FADES]
            )
            self.filter.compare(before.state, change, now.state, now.time)
        else:
            self.filter.follow(before.state, *self._acted(before.time, now.time), now.state, now.time)
        if self._count % DESCRIBE_EVERY == 0:
            self.changed = self._describe_changes()
        self._fly()

    def _fly(self) -> None:
        """Give the solver what was estimated, as far as it is trusted."""
        if not self.flies:
            return
        filtered, flown = self.filter, self._solver.disturbance
        trust = np.repeat(filtered.trust * (1.0, self._settings.moments), 3)
        flown[:AXES], flown[FLOWN_FADES] = trust * filtered.staying, trust * filtered.fading
        if filtered.parameters:
            self._solver.parameters[filtered.index] = filtered.flown_values

    def _respond(self) -> None:
        """Let thrust follow the last command by the unmodelled lag, of first order."""
        if self._last is None:
            return
        time, speed = self._last
        self._last = None
        lag = self._settings.thrust_lag
        left = math.exp(-self._period / lag) if lag > 0 else 0.0
        away = self._response - speed
        slot = self._count % HISTORY
        self._times[slot], self._speeds[slot] = time, speed + (1 - left) * lag / self._period * away
        self._response = speed + left * away
        self._count += 1

    def _acted(self, start: float, stop: float) -> tuple[Floats, Floats]:
        """Rotor speeds (k, n) whose thrust acted between two times, and for how many seconds (k,) each did."""
        last = self._count - 1
        while last > max(0, self._count - HISTORY) and self._times[last % HISTORY] >= stop:
            last -= 1
        first = last
        while first > max(0, self._count - HISTORY) and self._times[first % HISTORY] > start:
            first -= 1
        slots = np.arange(first, last + 1) % HISTORY
        return self._speeds[slots], np.diff([start, *self._times[slots[1:]], stop])
