"""The flight model of a vehicle: rigid body and rotors (PI-TCN eq. 1 and 2) with effects.

Written over CasADi symbols once; the mock's plant, the controller, diagnosis and the training prior all take their
functions from here. Every physical constant is an entry of the parameter vector p, so code compiled for one set of
effects serves all vehicles with as many rotors.
"""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from dynamics import quaternion
from dynamics import symbolic as ca
from dynamics.active_effect import ActiveEffect, activate, changed_physics, model_parameters, time_constants
from dynamics.arrays import Floats
from dynamics.effect import Conditions, Effect, Environment, Expression, Physics, Reading, Values
from dynamics.effects import CATALOGUE
from dynamics.own_effects import catalogue_of
from dynamics.state import ATTITUDE, POSITION, RATE, RIGID_BODY_STATES, VELOCITY
from dynamics.state_shape import StateShape
from dynamics.vehicle import GRAVITY, EffectUse, Vehicle

ENVIRONMENT_DEFAULT = np.array([0.0, 1.0])  # ground_height m, battery_ratio
MAX_KEPT = 256  # structures whose functions are kept


@dataclass(frozen=True)
class Model(StateShape):
    """Functions and names of one model. Shapes: x (nx,), u (n_rotors,) rad/s, p (n_parameters,), e (2,), w (nx - 13,).

    derivative: (x, u, p, e, w) -> xdot, with w unit white noise on hidden states (zero for the mean).
    observe: (x, u, p, e) -> specific_force (3,) body m/s^2, angular_acceleration (3,) rad/s^2, rotor_speed (n,) rad/s.
    respond: (x, u, a, p, e) -> specific_force, angular_acceleration; the rotors accelerate by a (n,) rad/s^2.
    measure: (specific_force, rate_body, rotor_speed, p, angular_acceleration) -> the first three as the sensors read
        them, the rate still in the body's axes, pose_age s, attitude_age s, pose_arm (3,) m, gyro_axes (4,),
        rotor_age s.
    constants: (p, e) -> mass kg, thrust_constant (n,) N s^2/rad^2, centre_of_mass (3,) m, as the effects change them.
    structure: rotors and effects; models of the same structure have the same functions.
    """

    vehicle: Vehicle
    effects: tuple[ActiveEffect, ...]
    parameter_names: tuple[str, ...]
    parameter_values: Floats
    hidden_initial: Floats
    derivative: ca.Function
    observe: ca.Function
    respond: ca.Function
    measure: ca.Function
    constants: ca.Function
    structure: Hashable

    @property
    def mass(self) -> float:
        """Mass with the effects on it, kg."""
        return float(self.constants(self.parameter_values, ENVIRONMENT_DEFAULT)[0])

    @property
    def thrust_constants(self) -> Floats:
        """Thrust constant of each rotor with the effects on it (n,), N s^2/rad^2."""
        return np.array(self.constants(self.parameter_values, ENVIRONMENT_DEFAULT)[1]).ravel()

    @property
    def centre_of_mass(self) -> Floats:
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
        return time_constants(self.effects)

    def parameter_index(self, name: str) -> int:
        """Place of a parameter, such as "body.mass" or "rotor_drag.coefficient", in p."""
        return self.parameter_names.index(name)


def build_model(
    vehicle: Vehicle,
    *,
    effects: Sequence[EffectUse] | None = None,
    catalogue: Mapping[str, Effect] = CATALOGUE,
) -> Model:
    """The model of a vehicle. effects: instead of those in the vehicle file (an empty sequence: the nominal model).

    Raises RequestError when an effect is given twice.
    """
    own = catalogue_of(vehicle, catalogue)
    active, hidden_initial = activate(vehicle, vehicle.effects if effects is None else effects, own)
    named, count = model_parameters(vehicle, active), vehicle.rotors.count
    structure = (count, *((item.effect, item.rotor, *item.values) for item in active))
    if structure not in _functions:
        if len(_functions) >= MAX_KEPT:
            _functions.clear()
        _functions[structure] = _make_functions(count, active, tuple(named), hidden_initial.size)
    return Model(
        vehicle=vehicle,
        effects=active,
        parameter_names=tuple(named),
        parameter_values=np.array(list(named.values())),
        hidden_initial=hidden_initial,
        structure=structure,
        **_functions[structure],
    )


_functions: dict[Hashable, dict[str, ca.Function]] = {}


def _make_functions(
    count: int, active: Sequence[ActiveEffect], names: Sequence[str], hidden_count: int
) -> dict[str, ca.Function]:
    """The functions of a model by name, the same for all vehicles of `count` rotors with the same effects."""
    x = ca.SX.sym("x", RIGID_BODY_STATES + hidden_count)
    u = ca.SX.sym("u", count)
    p = ca.SX.sym("p", len(names))
    e = ca.SX.sym("e", ENVIRONMENT_DEFAULT.size)
    values = dict(zip(names, ca.vertsplit(p), strict=True))
    environment = Environment(ground_height=e[0], battery_ratio=e[1])
    physics = changed_physics(count, active, values, environment)
    conditions = _conditions(active, values, x, u, physics, environment)
    derivative, observe = _motion_functions(active, values, conditions, (x, u, p, e))
    return {
        "derivative": derivative,
        "observe": observe,
        "respond": _respond(active, values, conditions, (x, u, p, e)),
        "measure": _measure(active, values, p, count),
        "constants": _constants(physics, p, e),
    }


@dataclass(frozen=True)
class Accelerations:
    """Result of Newton and Euler's equations: specific force f / m (3,) body, and the derivatives of v, q and omega."""

    specific_force: Expression
    velocity: Expression
    attitude: Expression
    rate: Expression


def newton_euler(active: Sequence[ActiveEffect], values: Values, x: Expression, c: Conditions) -> Accelerations:
    """Equations of motion of a rigid body with rotors and effects (PI-TCN eq. 1 and 2).

    T_i = k_f Omega_i^2                      thrust of rotor i, along body z
    f   = sum T_i e_z + effects              force, body
    tau = sum r_i x T_i e_z + k_tau s_i Omega_i^2 e_z + effects
    v'  = q (.) f / m - g e_z                world
    q'  = 1/2 q (0, omega)
    omega' = J^-1 (tau - omega x J omega)    body

    r_i: from the centre of mass to rotor i. s_i: sign of its reaction torque. J: diagonal.
    """
    m, J, s, k_tau = c.physics.mass, c.physics.inertia, c.physics.spin, c.physics.torque_constant
    q, omega, r, T, Omega = c.attitude, c.rate_body, c.rotor_position, c.rotor_thrust, c.rotor_speed
    f = ca.vertcat(0, 0, ca.sum1(T))
    tau = ca.vertcat(ca.dot(r[1, :].T, T), -ca.dot(r[0, :].T, T), ca.dot(s, k_tau * Omega**2))
    for item in active:
        if item.effect.wrench is not None:
            added = item.effect.wrench(replace(c, rotor=item.rotor), item.parameters(values), item.states(x))
            f, tau = f + added.force, tau + added.moment
    v_dot = quaternion.rotate(q, f / m) - ca.vertcat(0, 0, GRAVITY)
    q_dot = quaternion.derivative(q, omega)
    omega_dot = (tau - ca.cross(omega, J * omega)) / J
    return Accelerations(f / m, v_dot, q_dot, omega_dot)


def _conditions(
    active: Sequence[ActiveEffect], p: Values, x: Expression, u: Expression, physics: Physics, environment: Environment
) -> Conditions:
    attitude, rate = x[ATTITUDE], x[RATE]
    speed, wind = u, ca.SX.zeros(3)
    for item in active:
        if item.effect.rotor_speed is not None:
            speed = item.effect.rotor_speed(speed, item.states(x))
        if item.effect.wind is not None:
            wind = wind + item.effect.wind(item.parameters(p), item.states(x))
    wind_body = quaternion.rotate_inverse(attitude, wind)
    air_velocity = quaternion.rotate_inverse(attitude, x[VELOCITY]) - wind_body
    arm = physics.rotor_position - ca.repmat(physics.centre_of_mass, 1, physics.rotor_count)
    at_rotor = [air_velocity + ca.cross(rate, arm[:, i]) for i in range(physics.rotor_count)]
    return Conditions(
        position=x[POSITION],
        velocity_world=x[VELOCITY],
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


def _motion_functions(
    active: Sequence[ActiveEffect], values: Values, conditions: Conditions, symbols: Sequence[Expression]
) -> tuple[ca.Function, ca.Function]:
    """`derivative` and `observe` of a model. symbols: x, u, p, e."""
    x, u, p, e = symbols
    w = ca.SX.sym("w", x.numel() - RIGID_BODY_STATES)
    hidden_rates = [_hidden_derivative(item, values, x, w, conditions) for item in active]
    conditions = replace(conditions, rotor_acceleration=_rotor_acceleration(active, hidden_rates, conditions.physics))
    motion = newton_euler(active, values, x, conditions)
    rates = [value for item_rates in hidden_rates for value in item_rates.values()]
    xdot = ca.vertcat(x[VELOCITY], motion.velocity, motion.attitude, motion.rate, *rates)
    observed = [motion.specific_force, motion.rate, conditions.rotor_speed]
    labels = ["specific_force", "angular_acceleration", "rotor_speed"]
    return (
        ca.Function("derivative", [x, u, p, e, w], [xdot], ["x", "u", "p", "e", "w"], ["xdot"]),
        ca.Function("observe", [x, u, p, e], observed, ["x", "u", "p", "e"], labels),
    )


def _respond(
    active: Sequence[ActiveEffect], values: Values, conditions: Conditions, symbols: Sequence[Expression]
) -> ca.Function:
    x, u, p, e = symbols
    acceleration = ca.SX.sym("a", conditions.physics.rotor_count)
    motion = newton_euler(active, values, x, replace(conditions, rotor_acceleration=acceleration))
    labels = ["specific_force", "angular_acceleration"]
    outputs = [motion.specific_force, motion.rate]
    return ca.Function("respond", [x, u, acceleration, p, e], outputs, ["x", "u", "a", "p", "e"], labels)


def _measure(active: Sequence[ActiveEffect], values: Values, p: Expression, count: int) -> ca.Function:
    force, rate, speed, angular = (ca.SX.sym(name, size) for name, size in (("f", 3), ("r", 3), ("s", count), ("a", 3)))
    aligned = ca.SX([1.0, 0.0, 0.0, 0.0])
    read = Reading(force, rate, speed, aligned, ca.SX(0), ca.SX(0), ca.SX.zeros(3), angular, ca.SX(0))
    for item in active:
        if item.effect.measurement is not None:
            read = item.effect.measurement(read, item.parameters(values), item.rotor)
    labels = ["specific_force", "rate", "rotor_speed"]
    readings = [read.specific_force, read.rate_body, read.rotor_speed]
    outputs = [*readings, read.pose_age, read.attitude_age, read.pose_arm, read.gyro_axes, read.rotor_age]
    return ca.Function(
        "measure",
        [force, rate, speed, p, angular],
        outputs,
        [*labels, "p", "angular_acceleration"],
        [*(f"{name}_read" for name in labels), "pose_age", "attitude_age", "pose_arm", "gyro_axes", "rotor_age"],
    )


def _constants(physics: Physics, p: Expression, e: Expression) -> ca.Function:
    outputs = [physics.mass, physics.thrust_constant, physics.centre_of_mass]
    return ca.Function("constants", [p, e], outputs, ["p", "e"], ["mass", "thrust_constant", "centre_of_mass"])


def _hidden_derivative(
    item: ActiveEffect, values: Values, x: Expression, w: Expression, conditions: Conditions
) -> dict[str, Expression]:
    """Derivatives of an effect's hidden states, in the order in which they stand in x."""
    if item.effect.derivative is None:
        return {}
    here = replace(conditions, rotor=item.rotor)
    derivatives = item.effect.derivative(here, item.parameters(values), item.states(x), item.noise(w))
    return {name: derivatives[name] for name in item.hidden}


def _rotor_acceleration(
    active: Sequence[ActiveEffect], rates: Sequence[Mapping[str, Expression]], physics: Physics
) -> Expression:
    """Acceleration of the rotors: that of the hidden state which holds their speed, or none."""
    for item, derivatives in zip(active, rates, strict=True):
        if item.effect.rotor_speed_state is not None:
            return derivatives[item.effect.rotor_speed_state]
    return ca.SX.zeros(physics.rotor_count)
