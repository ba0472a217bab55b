"""A physical effect: named parameters, a wrench, hidden states, a source. Written once, in CasADi.

An effect is one module with an `EFFECT` in it. The same object serves the mock's plant, diagnosis, the controller and
the training prior. Hooks are pure functions of CasADi expressions; an effect has those that it needs:

physics       changes the constants of body and rotors (mass, one rotor's thrust constant, ...)
rotor_speed   real rotor speeds, rad/s, from the commanded ones and the hidden states
wind          velocity of the air, world ENU, m/s
wrench        force (body FLU, N) and moment about the centre of mass (N m) added to the rigid body's
derivative    time derivative of the effect's hidden states; `noise` is unit white noise, one entry a hidden state
measurement   the sensors' readings: a sensor's fault is an effect that changes readings, not motion
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from string import Formatter
from typing import Any, Literal, get_args

from dynamics.excitation import Excitation
from dynamics.vehicle import Vehicle

Expression = Any  # casadi.SX or casadi.MX
Values = Mapping[str, Expression]
ActsOn = Literal["motion", "command_gain", "weight", "rotor_speed_reading", "rotor_clock"]


@dataclass(frozen=True)
class Prior:
    """A parameter's distribution before any flight: its usual value and standard deviation, in its unit."""

    mean: float
    std: float


@dataclass(frozen=True)
class Parameter:
    """One number of an effect.

    unit: SI.
    meaning: in a few words.
    lower, upper: physical bounds.
    prior: its usual value on a vehicle.
    neutral: the value at which the effect vanishes.
    """

    name: str
    unit: str
    meaning: str
    lower: float
    upper: float
    prior: Callable[[Vehicle], Prior]
    neutral: float = 0.0


@dataclass(frozen=True)
class Hidden:
    """A hidden state of an effect.

    unit: SI.
    initial: its value in hover on a vehicle.
    per_rotor: whether there is one for each rotor.
    start_std: standard deviation of its value at the start of a log, about that in hover; 0 if it settles at once.
    """

    name: str
    unit: str
    initial: Callable[[Vehicle], float]
    per_rotor: bool = False
    start_std: float = 0.0


@dataclass(frozen=True)
class Physics:
    """Constants of body and rotors as expressions.

    mass: kg.
    inertia: (3,) diagonal about body x, y, z, kg m^2.
    centre_of_mass: (3,) body FLU, m.
    rotor_position: (3, n) body FLU, m.
    spin: (n,) sign of the reaction torque about body z.
    thrust_constant: (n,) k_f, N s^2/rad^2.
    torque_constant: (n,) k_tau, N m s^2/rad^2.
    rotor_radius: of a propeller, m.
    """

    mass: Expression
    inertia: Expression
    centre_of_mass: Expression
    rotor_position: Expression
    spin: Expression
    thrust_constant: Expression
    torque_constant: Expression
    rotor_radius: Expression

    @property
    def rotor_count(self) -> int:
        """Number of rotors."""
        return int(self.rotor_position.shape[1])


@dataclass(frozen=True)
class Environment:
    """The vehicle's surroundings and supply.

    ground_height: world z, m.
    battery_ratio: voltage over its nominal value.
    """

    ground_height: Expression
    battery_ratio: Expression


@dataclass(frozen=True)
class Conditions:
    """The arguments of an effect's hooks: state, input and quantities derived from them. SI, world ENU, body FLU.

    position, velocity_world: (3,) world.
    attitude: (4,) body to world, w first.
    rate_body: (3,) rad/s.
    command: (n,) commanded rotor speeds, rad/s.
    rotor_speed: (n,) real rotor speeds, rad/s.
    rotor_acceleration: (n,) their time derivatives, rad/s^2.
    rotor_position: (3, n) from the centre of mass, m.
    rotor_thrust: (n,) N, before any effect's wrench.
    air_velocity_body: (3,) velocity of the body relative to the air.
    rotor_air_velocity: (3, n) the same at each rotor hub.
    wind_body: (3,) velocity of the air.
    physics: the constants as the effects change them.
    environment: ground and battery.
    has_drag: whether an effect of the model resists the air.
    rotor: the rotor on which a single-rotor effect acts.
    """

    position: Expression
    velocity_world: Expression
    attitude: Expression
    rate_body: Expression
    command: Expression
    rotor_speed: Expression
    rotor_acceleration: Expression
    rotor_position: Expression
    rotor_thrust: Expression
    air_velocity_body: Expression
    rotor_air_velocity: Expression
    wind_body: Expression
    physics: Physics
    environment: Environment
    has_drag: bool = False
    rotor: int | None = None


@dataclass(frozen=True)
class Reading:
    """Readings of the sensors.

    specific_force: (3,) body FLU, m/s^2.
    rate_body: (3,) rad/s, still in the body's axes.
    rotor_speed: (n,) rad/s.
    gyro_axes: (4,) unit quaternion from the gyro's axes to the body's, applied last of all.
    pose_age: s by which position, velocity and attitude are older than their stamps.
    attitude_age: s by which the attitude is older than that still.
    pose_arm: (3,) body FLU, from the centre of mass to the point whose position and velocity are logged, m.
    angular_acceleration: (3,) true, rad/s^2: no reading, but what an accelerometer off the centre of mass responds to.
    rotor_age: s by which the rotors' speeds or commands are older than their stamps.
    """

    specific_force: Expression
    rate_body: Expression
    rotor_speed: Expression
    gyro_axes: Expression
    pose_age: Expression
    attitude_age: Expression
    pose_arm: Expression
    angular_acceleration: Expression
    rotor_age: Expression


@dataclass(frozen=True)
class Span:
    """The box in which flights took place: its corners, world ENU, m."""

    lowest: tuple[float, float, float]
    highest: tuple[float, float, float]


@dataclass(frozen=True)
class Wrench:
    """Force, body FLU, N, and moment about the centre of mass, body FLU, N m."""

    force: Expression
    moment: Expression


@dataclass(frozen=True, eq=False)
class Effect:
    """One physical effect: its formula, and how diagnosis, training, the mock and the controller treat it.

    name: as in vehicle files and on command lines.
    summary: what it does, in a few words.
    source: where its formula comes from.
    parameters: its numbers.
    hidden: its states behind the rigid body's.
    physics, rotor_speed, wind, wrench, derivative, measurement: its hooks, see above.
    grid: values of the parameters in which it is not linear, tried one by one; linear regression gives
        the others, or the size of the effect where all are on the grid.
    refine: parameters of the grid that the final fit frees, with their prior.
    assumed: parameters of the grid that flights hardly show: their prior chooses the point, and is part of the others'
        intervals.
    min_detectable: size below which it is not claimed where all parameters are on the grid, in their unit.
    caveat: what a fit of it cannot settle; {parameter} stands for a fitted value.
    time_constants: parameters, s, that bound the step with which its hidden states can be integrated.
    per_rotor: it acts on one rotor, named by index.
    resists_air: it is a drag, through which wind acts on the vehicle.
    stochastic: noise drives its hidden states, so that no value in a vehicle file predicts them.
    followed: its parameters follow in flight unless the user names others (docs/adaptation.md): they change from day to
        day, and velocities and rates show them.
    lost_thrust: parameter that is the share of its thrust that a rotor has lost, of an effect of one rotor: this is
        named in flight (docs/adaptation.md).
    voltage_power: parameter that is the power of the battery's voltage with which rotor speed goes: it follows in
        flight from the effectiveness of thrust.
    acts_on: "command_gain" is absorbed by the unknown gain of motor commands, and "weight" too unless the vehicle file
        has a drag, "rotor_speed_reading" shows only where rotor speeds are measured, "rotor_clock" shows
        there alone, too: with commands a lag of the rotors absorbs it. "motion" is everything else.
    sensor_prior: standard deviation that a healthy sensor's fault has from flight to flight, in the parameters' unit.
    excitation: logged quantities and motion that a flight needs to show it; None where that is not stated.
    confounded_with: effects with nearly the same signal in most flights.

    Raises ValueError when it contradicts itself.
    """

    name: str
    summary: str
    source: str
    parameters: tuple[Parameter, ...]
    hidden: tuple[Hidden, ...] = ()
    physics: Callable[[Physics, Values, Environment, int | None], Physics] | None = None
    rotor_speed: Callable[[Expression, Values], Expression] | None = None
    wind: Callable[[Values, Values], Expression] | None = None
    wrench: Callable[[Conditions, Values, Values], Wrench] | None = None
    derivative: Callable[[Conditions, Values, Values, Values], Values] | None = None
    measurement: Callable[[Reading, Values, int | None], Reading] | None = None
    grid: Callable[[Vehicle, Span], Sequence[Mapping[str, float]]] | None = None
    refine: tuple[str, ...] = ()
    assumed: tuple[str, ...] = ()
    min_detectable: float = 0.0
    caveat: str = ""
    time_constants: tuple[str, ...] = ()
    per_rotor: bool = False
    resists_air: bool = False
    stochastic: bool = False
    followed: bool = False
    lost_thrust: str = ""
    voltage_power: str = ""
    acts_on: ActsOn = "motion"
    sensor_prior: float | None = None
    excitation: Excitation | None = None
    confounded_with: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        for contradiction in _contradictions(self):
            raise ValueError(f"effect {self.name!r}: {contradiction}.")

    def defaults(self, vehicle: Vehicle) -> dict[str, float]:
        """The usual value of each parameter on this vehicle."""
        return {p.name: min(max(p.prior(vehicle).mean, p.lower), p.upper) for p in self.parameters}

    @property
    def moves_vehicle(self) -> bool:
        """Whether it changes the motion, and not the sensors' readings alone."""
        return any(hook is not None for hook in (self.physics, self.rotor_speed, self.wind, self.wrench))

    @property
    def rotor_speed_state(self) -> str | None:
        """Name of the hidden state of the real rotor speed: with `rotor_speed`, the first per-rotor state."""
        if self.rotor_speed is None:
            return None
        return next((hidden.name for hidden in self.hidden if hidden.per_rotor), None)


def _contradictions(effect: Effect) -> Iterator[str]:
    """Contradictions between an effect's fields, one sentence each."""
    names = [parameter.name for parameter in effect.parameters]
    states = [hidden.name for hidden in effect.hidden]
    hooks = (effect.physics, effect.rotor_speed, effect.wind, effect.wrench, effect.measurement)
    if not effect.name.isidentifier():
        yield "a name is letters, digits and underscores"
    if not names:
        yield "it has no parameter, so nothing of it could be fitted"
    if all(hook is None for hook in hooks):
        yield "it has none of physics, rotor_speed, wind, wrench and measurement, so it does nothing"
    for kind, listed in (("parameter", names), ("hidden state", states)):
        for name in {name for name in listed if listed.count(name) > 1}:
            yield f"two {kind}s are called {name!r}"
    for parameter in effect.parameters:
        if not parameter.lower < parameter.upper:
            yield f"{parameter.name}: lower {parameter.lower} is not below upper {parameter.upper}"
    if bool(states) != (effect.derivative is not None):
        yield "hidden states need a derivative, and a derivative hidden states"
    if effect.rotor_speed is not None and effect.rotor_speed_state is None:
        yield "rotor_speed needs a hidden state of each rotor (per_rotor=True) that holds the speed"
    for field in ("refine", "assumed", "time_constants"):
        for name in set(getattr(effect, field)) - set(names):
            yield f"{field} names {name!r}, which is none of its parameters ({', '.join(names)})"
    yield from _contradicting_roles(effect)


def _contradicting_roles(effect: Effect) -> Iterator[str]:
    """Contradictions between the fields that diagnosis and integration use, one sentence each."""
    for parameter in effect.parameters:
        if parameter.name in effect.time_constants and not parameter.lower > 0:
            yield f"time constant {parameter.name} has the lower bound {parameter.lower} s; it must be above 0"
    if effect.time_constants and not effect.hidden:
        yield "time_constants belong to hidden states, and it has none"
    if effect.grid is None and (effect.refine or effect.assumed or effect.min_detectable):
        yield "refine, assumed and min_detectable belong to a grid, and it has none"
    if effect.stochastic and not effect.hidden:
        yield "stochastic effects have hidden states that noise drives, and it has none"
    if effect.stochastic and effect.grid is not None:
        yield "a stochastic effect is not regressed, so it needs no grid"
    if effect.sensor_prior is not None and (effect.measurement is None or not effect.sensor_prior > 0):
        yield "sensor_prior is a standard deviation above 0 of a fault of a sensor (measurement)"
    if effect.acts_on not in get_args(ActsOn):
        yield f"acts_on is {effect.acts_on!r}, not one of {', '.join(get_args(ActsOn))}"
    if effect.acts_on == "rotor_speed_reading" and effect.measurement is None:
        yield 'acts_on="rotor_speed_reading" needs a measurement'
    if effect.acts_on == "command_gain" and effect.physics is None and effect.wrench is None:
        yield 'acts_on="command_gain" needs physics or a wrench'
    if effect.lost_thrust and not (effect.per_rotor and effect.lost_thrust in {p.name for p in effect.parameters}):
        yield "lost_thrust is a parameter of an effect of one rotor"
    if effect.name in effect.confounded_with:
        yield "confounded_with names the effect itself"
    placeholders = {name for _, name, _, _ in Formatter().parse(effect.caveat) if name is not None}
    for name in placeholders - {parameter.name for parameter in effect.parameters}:
        yield f"caveat names {{{name}}}, which is none of its parameters"
