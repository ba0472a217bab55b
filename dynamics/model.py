"""The flight model of a vehicle: rigid body and rotors (PI-TCN eq. 1 and 2) and whatever effects it is given.

Written over CasADi symbols once; the mock's plant, the controller, diagnosis and the training prior all take their
functions from here. Every physical constant is an entry of the parameter vector p, so code compiled for one set of
effects serves all vehicles with as many rotors.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from dynamics import quaternion
from dynamics.effect import Conditions, Effect, Environment, Expression, Physics, Reading, Values
from dynamics.effects import CATALOGUE
from dynamics.errors import RequestError
from dynamics.state import RIGID_BODY_STATES
from dynamics.vehicle import GRAVITY, EffectUse, Vehicle

ENVIRONMENT_DEFAULT = np.array([0.0, 1.0])  # ground_height m, battery_ratio


@dataclass(frozen=True)
class ActiveEffect:
    """An effect in a model, with its values and the places of its hidden states behind the rigid body's."""

    effect: Effect
    key: str
    rotor: int | None
    values: Mapping[str, float]
    hidden: Mapping[str, slice]


@dataclass(frozen=True)
class Model:
    """Functions and names of one model. Shapes: x (nx,), u (n_rotors,) rad/s, p (n_parameters,), e (2,), w (nx - 13,).

    derivative: (x, u, p, e, w) -> xdot, with w unit white noise on hidden states (zero for the mean).
    observe: (x, u, p, e) -> specific_force (3,) body m/s^2, angular_acceleration (3,) rad/s^2, rotor_speed (n,) rad/s.
    respond: (x, u, a, p, e) -> specific_force, angular_acceleration; the rotors accelerate by a (n,) rad/s^2.
    measure: (specific_force, rate_body, rotor_speed, p) -> the same as the sensors read them, and the pose's age, s.
    constants: (p, e) -> mass kg, thrust_constant (n,) N s^2/rad^2, centre_of_mass (3,) m, as the effects change them.
    """

    vehicle: Vehicle
    effects: tuple[ActiveEffect, ...]
    parameter_names: tuple[str, ...]
    parameter_values: NDArray[np.float64]
    hidden_initial: NDArray[np.float64]
    derivative: ca.Function
    observe: ca.Function
    respond: ca.Function
    measure: ca.Function
    constants: ca.Function

    @property
    def state_count(self) -> int:
        """Length of the state, hidden states included."""
        return RIGID_BODY_STATES + self.hidden_initial.size

    @property
    def hidden_count(self) -> int:
        """Number of hidden states."""
        return int(self.hidden_initial.size)

    @property
    def input_count(self) -> int:
        """Number of rotors."""
        return self.vehicle.rotors.count

    def initial_state(self, rigid_body: NDArray[np.float64]) -> NDArray[np.float64]:
        """The whole state for a rigid-body state (13,), with hidden states at their hover values."""
        return np.concatenate([rigid_body, self.hidden_initial])

    @property
    def mass(self) -> float:
        """Mass with the effects on it, kg."""
        return float(self.constants(self.parameter_values, ENVIRONMENT_DEFAULT)[0])

    @property
    def thrust_constants(self) -> NDArray[np.float64]:
        """Thrust constant of each rotor with the effects on it (n,), N s^2/rad^2."""
        return np.array(self.constants(self.parameter_values, ENVIRONMENT_DEFAULT)[1]).ravel()

    @property
    def centre_of_mass(self) -> NDArray[np.float64]:
        """Centre of mass with the effects on it (3,), body FLU, m."""
        return np.array(self.constants(self.parameter_values, ENVIRONMENT_DEFAULT)[2]).ravel()

    @property
    def rotor_speed_places(self) -> tuple[slice, ...]:
        """Where the state holds the rotors' real speeds: a place for each lag of theirs."""
        lags = [(item.hidden, item.effect.rotor_speed_state) for item in self.effects]
        return tuple(hidden[name] for hidden, name in lags if name is not None)

    @property
    def time_constants(self) -> tuple[float, ...]:
        """Values of the effects' time constants, s: no step of an integration may be much longer."""
        return tuple(item.values[name] for item in self.effects for name in item.effect.time_constants)

    def parameter_index(self, name: str) -> int:
        """Place of a parameter, such as "body.mass" or "rotor_drag.coefficient", in p."""
        return self.parameter_names.index(name)


def build_model(
    vehicle: Vehicle,
    *,
    effects: Sequence[EffectUse] | None = None,
    catalogue: Mapping[str, Effect] = CATALOGUE,
) -> Model:
    """The model of a vehicle. effects: instead of those in the vehicle file (an empty sequence: the textbook model).

    Raises RequestError when an effect is given twice.
    """
    active, hidden_initial = _activate(vehicle, vehicle.effects if effects is None else effects, catalogue)
    names, values = _parameters(vehicle, active)
    x = ca.SX.sym("x", RIGID_BODY_STATES + hidden_initial.size)
    u = ca.SX.sym("u", vehicle.rotors.count)
    p = ca.SX.sym("p", len(names))
    e = ca.SX.sym("e", ENVIRONMENT_DEFAULT.size)
    w = ca.SX.sym("w", hidden_initial.size)
    named = dict(zip(names, ca.vertsplit(p), strict=True))
    environment = Environment(ground_height=e[0], battery_ratio=e[1])
    physics = _physics(vehicle.rotors.count, active, named, environment)
    conditions = _conditions(active, named, x, u, physics, environment)
    motion = _motion(active, named, x, w, conditions)
    derivative = ca.Function("derivative", [x, u, p, e, w], [motion.derivative], ["x", "u", "p", "e", "w"], ["xdot"])
    observed = [motion.specific_force, motion.angular_acceleration, motion.rotor_speed]
    labels = ["specific_force", "angular_acceleration", "rotor_speed"]
    observe = ca.Function("observe", [x, u, p, e], observed, ["x", "u", "p", "e"], labels)
    changed = [physics.mass, physics.thrust_constant, physics.centre_of_mass]
    labels = ["mass", "thrust_constant", "centre_of_mass"]
    constants = ca.Function("constants", [p, e], changed, ["p", "e"], labels)
    respond, measure = _respond(active, named, x, conditions, [x, u, p, e]), _measure(active, named, p, u.numel())
    return Model(vehicle, active, names, values, hidden_initial, derivative, observe, respond, measure, constants)


def _activate(
    vehicle: Vehicle, uses: Sequence[EffectUse], catalogue: Mapping[str, Effect]
) -> tuple[tuple[ActiveEffect, ...], NDArray[np.float64]]:
    active: list[ActiveEffect] = []
    initial: list[float] = []
    for use in uses:
        effect = catalogue[use.name]
        places = {}
        for hidden in effect.hidden:
            count = vehicle.rotors.count if hidden.per_rotor else 1
            start = RIGID_BODY_STATES + len(initial)
            places[hidden.name] = slice(start, start + count)
            initial += [hidden.initial(vehicle)] * count
        key = use.name if use.rotor is None else f"{use.name}[{use.rotor}]"
        if any(item.key == key for item in active):
            raise RequestError(f"effect {key} is given twice; give it once, with the values that it has in all.")
        values = {**effect.defaults(vehicle), **use.parameters}
        active.append(ActiveEffect(effect, key, use.rotor, values, places))
    return tuple(active), np.array(initial, dtype=float)


def _parameters(vehicle: Vehicle, active: Sequence[ActiveEffect]) -> tuple[tuple[str, ...], NDArray[np.float64]]:
    body, rotors = vehicle.body, vehicle.rotors
    named: dict[str, float] = {"body.mass": body.mass}
    for axis, moment, offset in zip("xyz", body.inertia, body.centre_of_mass, strict=True):
        named[f"body.inertia_{axis}"] = moment
        named[f"body.centre_of_mass_{axis}"] = offset
    for i, (position, spin) in enumerate(zip(rotors.position, rotors.spin, strict=True)):
        named |= {f"rotors.position_{axis}[{i}]": value for axis, value in zip("xyz", position, strict=True)}
        named[f"rotors.spin[{i}]"] = float(spin)
    named["rotors.thrust_constant"] = rotors.thrust_constant
    named["rotors.torque_constant"] = rotors.torque_constant
    named["rotors.radius"] = rotors.disc_radius
    for item in active:
        named |= {f"{item.key}.{name}": value for name, value in item.values.items()}
    return tuple(named), np.array(list(named.values()))


@dataclass(frozen=True)
class _Motion:
    derivative: Expression
    specific_force: Expression
    angular_acceleration: Expression
    rotor_speed: Expression


def _physics(count: int, active: Sequence[ActiveEffect], p: Values, environment: Environment) -> Physics:
    """The vehicle file's constants as the effects change them."""

    def along(name: str) -> Expression:
        return ca.vertcat(*[p[f"{name}_{axis}"] for axis in "xyz"])

    position = [ca.vertcat(*[p[f"rotors.position_{axis}[{i}]"] for axis in "xyz"]) for i in range(count)]
    physics = Physics(
        mass=p["body.mass"],
        inertia=along("body.inertia"),
        centre_of_mass=along("body.centre_of_mass"),
        rotor_position=ca.horzcat(*position),
        spin=ca.vertcat(*[p[f"rotors.spin[{i}]"] for i in range(count)]),
        thrust_constant=ca.repmat(p["rotors.thrust_constant"], count, 1),
        torque_constant=ca.repmat(p["rotors.torque_constant"], count, 1),
        rotor_radius=p["rotors.radius"],
    )
    for item in active:
        if item.effect.physics is not None:
            physics = item.effect.physics(physics, _values(item, p), environment, item.rotor)
    return physics


def _values(item: ActiveEffect, p: Values) -> Values:
    return {name: p[f"{item.key}.{name}"] for name in item.values}


def _hidden(item: ActiveEffect, x: Expression) -> Values:
    return {name: x[place] for name, place in item.hidden.items()}


def _conditions(
    active: Sequence[ActiveEffect], p: Values, x: Expression, u: Expression, physics: Physics, environment: Environment
) -> Conditions:
    attitude, rate = x[6:10], x[10:13]
    speed, wind = u, ca.SX.zeros(3)
    for item in active:
        if item.effect.rotor_speed is not None:
            speed = item.effect.rotor_speed(speed, _hidden(item, x))
        if item.effect.wind is not None:
            wind = wind + item.effect.wind(_values(item, p), _hidden(item, x))
    wind_body = quaternion.rotate_inverse(attitude, wind)
    air_velocity = quaternion.rotate_inverse(attitude, x[3:6]) - wind_body
    arm = physics.rotor_position - ca.repmat(physics.centre_of_mass, 1, physics.rotor_count)
    at_rotor = [air_velocity + ca.cross(rate, arm[:, i]) for i in range(physics.rotor_count)]
    return Conditions(
        position=x[0:3],
        velocity_world=x[3:6],
        attitude=attitude,
        rate_body=rate,
        command=u,
        rotor_speed=speed,
        rotor_acceleration=ca.SX.zeros(physics.rotor_count),
        rotor_position=arm,
        rotor_thrust=physics.thrust_constant * speed**2,
        air_velocity_body=air_velocity,
        rotor_air_velocity=ca.horzcat(*at_rotor),
        wind_body=wind_body,
        physics=physics,
        environment=environment,
        has_drag=any(item.effect.resists_air for item in active),
    )


def _rotor_wrench(c: Conditions) -> tuple[Expression, Expression]:
    """Force and moment of the rotors (PI-TCN eq. 2, for any layout), about the centre of mass."""
    roll = ca.dot(c.rotor_position[1, :].T, c.rotor_thrust)
    pitch = -ca.dot(c.rotor_position[0, :].T, c.rotor_thrust)
    yaw = ca.dot(c.physics.spin, c.physics.torque_constant * c.rotor_speed**2)
    return ca.vertcat(0, 0, ca.sum1(c.rotor_thrust)), ca.vertcat(roll, pitch, yaw)


def _motion(active: Sequence[ActiveEffect], p: Values, x: Expression, w: Expression, conditions: Conditions) -> _Motion:
    hidden_rates = _hidden_derivative(active, p, x, w, conditions)
    turning_up = _rotor_acceleration(active, hidden_rates, conditions.physics)
    conditions = dataclasses.replace(conditions, rotor_acceleration=turning_up)
    specific_force, angular = _accelerations(active, p, x, conditions)
    acceleration = quaternion.rotate(x[6:10], specific_force) - ca.vertcat(0, 0, GRAVITY)
    rates = [value for rates in hidden_rates for value in rates.values()]
    xdot = ca.vertcat(x[3:6], acceleration, quaternion.derivative(x[6:10], x[10:13]), angular, *rates)
    return _Motion(xdot, specific_force, angular, conditions.rotor_speed)


def _accelerations(
    active: Sequence[ActiveEffect], p: Values, x: Expression, conditions: Conditions
) -> tuple[Expression, Expression]:
    """Specific force (m/s^2) and angular acceleration (rad/s^2), body axes, of rotors and effects (PI-TCN eq. 1)."""
    physics = conditions.physics
    force, moment = _rotor_wrench(conditions)
    for item in active:
        if item.effect.wrench is not None:
            here = dataclasses.replace(conditions, rotor=item.rotor)
            added = item.effect.wrench(here, _values(item, p), _hidden(item, x))
            force, moment = force + added.force, moment + added.moment
    rate = x[10:13]
    angular = (moment - ca.cross(rate, physics.inertia * rate)) / physics.inertia
    return force / physics.mass, angular


def _respond(
    active: Sequence[ActiveEffect], p: Values, x: Expression, conditions: Conditions, inputs: Sequence[Expression]
) -> ca.Function:
    acceleration = ca.SX.sym("a", conditions.physics.rotor_count)
    given = dataclasses.replace(conditions, rotor_acceleration=acceleration)
    found = _accelerations(active, p, x, given)
    arguments = [*inputs[:2], acceleration, *inputs[2:]]
    labels = ["specific_force", "angular_acceleration"]
    return ca.Function("respond", arguments, list(found), ["x", "u", "a", "p", "e"], labels)


def _measure(active: Sequence[ActiveEffect], named: Values, p: Expression, count: int) -> ca.Function:
    true = Reading(ca.SX.sym("f", 3), ca.SX.sym("r", 3), ca.SX.sym("s", count), ca.SX(0))
    read = true
    for item in active:
        if item.effect.measurement is not None:
            read = item.effect.measurement(read, _values(item, named), item.rotor)
    inputs, labels = [true.specific_force, true.rate_body, true.rotor_speed], ["specific_force", "rate", "rotor_speed"]
    outputs = [read.specific_force, read.rate_body, read.rotor_speed, read.pose_age]
    return ca.Function("measure", [*inputs, p], outputs, [*labels, "p"], [f"{n}_read" for n in labels] + ["pose_age"])


def _hidden_derivative(
    active: Sequence[ActiveEffect], p: Values, x: Expression, w: Expression, conditions: Conditions
) -> list[dict[str, Expression]]:
    """Derivatives of each effect's hidden states, in the order in which they stand in x."""
    rates: list[dict[str, Expression]] = []
    for item in active:
        if item.effect.derivative is None:
            rates.append({})
            continue
        noise = {name: w[s.start - RIGID_BODY_STATES : s.stop - RIGID_BODY_STATES] for name, s in item.hidden.items()}
        here = dataclasses.replace(conditions, rotor=item.rotor)
        found = item.effect.derivative(here, _values(item, p), _hidden(item, x), noise)
        rates.append({name: found[name] for name in item.hidden})
    return rates


def _rotor_acceleration(
    active: Sequence[ActiveEffect], rates: Sequence[Mapping[str, Expression]], physics: Physics
) -> Expression:
    """Acceleration of the rotors: that of the hidden state which holds their speed, or none."""
    for item, derivatives in zip(active, rates, strict=True):
        if item.effect.rotor_speed_state is not None:
            return derivatives[item.effect.rotor_speed_state]
    return ca.SX.zeros(physics.rotor_count)
