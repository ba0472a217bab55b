"""One millisecond of the vehicle as one CasADi function: inner loop, allocation, motors, flight, ground, battery.

The flight model is that of `dynamics` with any effects; here the autopilot, the ground and the sensors are added.
Everything that a user may change is an input of the function, so that the machine code serves all vehicles with as many
rotors and the same set of effects.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from dynamics import quaternion
from dynamics import symbolic as ca
from dynamics.effect import Effect, Expression, Values
from dynamics.effects import CATALOGUE
from dynamics.integrators import required_steps, rk4, with_unit_attitude
from dynamics.model import Model, build_model
from dynamics.own_effects import catalogue_of
from dynamics.rate_loop import ACTUATION_DELAY, with_motor_lag
from dynamics.state import ATTITUDE, POSITION, RATE, RIGID_BODY_STATES, VELOCITY
from dynamics.vehicle import EffectUse, Vehicle
from sitl_mock.vehicle import allocation, battery, ground, inner_loop
from sitl_mock.vehicle.layout import Layout
from sitl_mock.vehicle.sensors import next_estimate_error, next_inertial_error, next_wander

DT = 0.001  # s
ACTUATION_STEPS = round(ACTUATION_DELAY / DT)
AT_REST = 0.01  # share of the greatest rotor speed below which the rotors stand still
CASCADE_STEPS = 4  # from attitude to rate control, which runs first in each of PX4's cycles of 4 ms


@dataclass(frozen=True)
class Plant:
    """The compiled step and the layouts of its vectors.

    model: the flight model in it.
    state, command, constants, noise: layouts of the inputs.
    record: layout of the second output, which holds the time after the step.
    step: (state, command, constants, noise) -> (next state, record).
    """

    model: Model
    state: Layout
    command: Layout
    constants: Layout
    noise: Layout
    record: Layout
    step: ca.Function


def plant_effects(
    vehicle: Vehicle, hidden: Sequence[EffectUse], catalogue: Mapping[str, Effect] = CATALOGUE
) -> tuple[EffectUse, ...]:
    """Effects of the vehicle file, those hidden from it in their place or beside them, and always some motor lag."""
    catalogue = catalogue_of(vehicle, catalogue)
    merged = {(use.name, use.rotor): use for use in (*vehicle.effects, *hidden)}
    return with_motor_lag(tuple(merged.values()), catalogue)


def build_plant(
    vehicle: Vehicle, hidden: Sequence[EffectUse] = (), catalogue: Mapping[str, Effect] = CATALOGUE
) -> Plant:
    """The plant of a vehicle with effects that its file does not name."""
    model = build_model(vehicle, effects=plant_effects(vehicle, hidden, catalogue), catalogue=catalogue)
    layouts = _layouts(model)
    inputs, parts = zip(*(layout.symbol(name) for name, layout in layouts.items() if name != "record"), strict=True)
    after, record = _step(model, *parts)
    outputs: Expression = ca.cse([layouts["state"].join(after), layouts["record"].join(record)])
    into, out = ["state", "command", "constants", "noise"], ["next", "record"]
    step = ca.Function("vehicle_step", list(inputs), outputs, into, out)
    return Plant(model=model, step=step, **layouts)


def _layouts(model: Model) -> dict[str, Layout]:
    n = model.input_count
    state = {
        "plant": model.state_count, "gyro_memory": 6, "rate": 3, "rate_acceleration": 3, "integral": 3,
        "rate_setpoint_queue": 3 * CASCADE_STEPS, "unallocated": 3, "yaw_torque": 1,
        "signal_queue": n * ACTUATION_STEPS, "charge": 1, "voltage": 1, "estimate_error": 9, "wander": 9,
        "wander_rate": 9, "inertial_error": 2, "offset": 9, "force_integral": 3, "gyro_integral": 3, "ground_point": 3,
    }  # fmt: skip
    command = {
        "armed": 1, "holds_attitude": 1, "attitude": 4, "rate": 3, "axis_free": 3, "yaw_rate": 1, "thrust": 1,
        "landed": 1,
    }  # fmt: skip
    constants = {
        "model": len(model.parameter_names), "mixer": 4 * n, "unmixer": 4 * n, "feet": 6 * n, "mass_over_inertia": 3,
        "ground_normal": 3, "ground_velocity": 3, "ground_rights": 1, "leg_height": 1, "held": 1, "held_at": 3,
        "speed_min": 1, "speed_max": 1, "thrust_curve": 1, "torque_constant": 1, "rotor_noise": 1,
        "cells": 1, "capacity": 1, "resistance": 1, "nominal_voltage": 1,
        "attitude_gain": 3, "rate_limit": 3, "yaw_weight": 1, "rate_gain_p": 3, "rate_gain_i": 3, "rate_gain_d": 3,
        "rate_gain_ff": 3, "integral_limit": 3, "thrust_model_factor": 1, "gyro_cutoff": 1, "acceleration_cutoff": 1,
        "yaw_torque_cutoff": 1,
        "gyro_noise": 3, "accelerometer_noise": 3, "gyro_rest_noise": 3, "accelerometer_rest_noise": 3,
        "gyro_bias": 3, "accelerometer_bias": 3, "estimate_noise": 9, "estimate_time": 9, "rotor_speed_noise": 1,
        "wander_frequency": 9, "wander_noise": 9, "wander_rest": 9, "inertial_forgetting": 2,
        "drift": 9,
    }  # fmt: skip
    noise = {"hidden": model.hidden_count, "rotor": n, "gyro": 3, "accelerometer": 3, "estimate": 9, "rotor_speed": n}
    record = {
        "truth": RIGID_BODY_STATES, "estimate": RIGID_BODY_STATES, "force_integral": 3, "gyro_integral": 3,
        "rotor_speed": n, "rotor_speed_measured": n, "motor_signal": n, "ground_force": 1, "voltage": 1, "current": 1,
        "charge": 1,
    }  # fmt: skip
    sizes = {"state": state, "command": command, "constants": constants, "noise": noise, "record": record}
    return {name: Layout(parts) for name, parts in sizes.items()}


def _step(
    model: Model, state: Values, command: Values, constants: Values, noise: Values
) -> tuple[dict[str, Expression], dict[str, Expression]]:
    n = model.input_count
    control, signal = _control(n, state, command, constants)
    applied = state["signal_queue"][-n:]
    speed = allocation.rotor_speed_command(applied, curve=constants["thrust_curve"], speed_max=constants["speed_max"])
    speed = ca.fmin(speed * (1 + constants["rotor_noise"] * noise["rotor"]), constants["speed_max"])
    speed = ca.if_else(command["armed"], ca.fmax(speed, constants["speed_min"]), 0)
    point = state["ground_point"] + DT * constants["ground_velocity"]
    surface = {**constants, "ground_point": point}
    above = _ground_height(state["plant"], surface)
    environment = ca.vertcat(above, state["voltage"] / constants["nominal_voltage"])
    x = _fly(model, state["plant"], speed, environment, surface, noise["hidden"])
    observed = _observe(model, x, speed, environment, surface)
    battery_state, current = _discharge(state, observed["rotor_speed"], constants)
    jitter = constants["rotor_speed_noise"] * noise["rotor_speed"]
    sensed = (observed["specific_force"], x[RATE], observed["rotor_speed"] + jitter)
    read = model.measure(*sensed, constants["model"], observed["angular_acceleration"])
    turning = ca.sumsqr(observed["rotor_speed"]) > n * (AT_REST * constants["speed_max"]) ** 2
    measured, estimate = _measure(x, read, turning, state, constants, noise)
    record = {
        "truth": x[:RIGID_BODY_STATES], "estimate": estimate, "force_integral": measured["force_integral"],
        "gyro_integral": measured["gyro_integral"], "rotor_speed": observed["rotor_speed"],
        "rotor_speed_measured": read[2], "motor_signal": signal,
        "ground_force": observed["ground_force"], "current": current, **battery_state,
    }  # fmt: skip
    return {"plant": x, **control, **battery_state, **measured, "ground_point": point}, record


def _ground_height(x: Expression, surface: Values) -> Expression:
    """World z of the ground under the vehicle, m."""
    normal, point = surface["ground_normal"], surface["ground_point"]
    return point[2] - (normal[0] * (x[0] - point[0]) + normal[1] * (x[1] - point[1])) / normal[2]


def _control(count: int, state: Values, command: Values, constants: Values) -> tuple[dict[str, Expression], Expression]:
    """The inner loop's own states after the step, and the motor signals that it commands."""
    attitude = _estimated_attitude(state["plant"], state)
    rates = inner_loop.rate_setpoint(
        attitude,
        command["attitude"],
        command["yaw_rate"],
        gain=constants["attitude_gain"],
        yaw_weight=constants["yaw_weight"],
    )
    limited = ca.fmin(ca.fmax(rates, -constants["rate_limit"]), constants["rate_limit"])
    setpoint = ca.if_else(command["holds_attitude"], state["rate_setpoint_queue"][-3:], command["rate"])
    setpoint = ca.if_else(command["axis_free"], state["rate"], setpoint)
    error = setpoint - state["rate"]
    torque = inner_loop.rate_control(error, setpoint, state["rate_acceleration"], state["integral"], constants)
    yaw = inner_loop.low_pass(torque[2], state["yaw_torque"], constants["yaw_torque_cutoff"], DT)
    demand = ca.vertcat(torque[0:2], yaw, command["thrust"])
    motors = allocation.allocate(ca.reshape(constants["mixer"], count, 4), demand)
    allocated = ca.reshape(constants["unmixer"], 4, count) @ motors
    integral = inner_loop.next_integral(state["integral"], error, state["unallocated"], constants, DT)
    integral = ca.if_else(command["landed"], state["integral"], integral)
    signal = ca.if_else(command["armed"], allocation.signal_for_thrust(motors, constants["thrust_model_factor"]), 0)
    memory = {"integral": integral, "unallocated": demand[0:3] - allocated[0:3], "yaw_torque": yaw}
    after = {name: ca.if_else(command["armed"], value, 0) for name, value in memory.items()}
    after["rate_setpoint_queue"] = ca.vertcat(limited, state["rate_setpoint_queue"][:-3])
    after["signal_queue"] = ca.vertcat(signal, state["signal_queue"][:-count])
    return after, signal


def _fly(
    model: Model, x: Expression, speed: Expression, environment: Expression, constants: Values, noise: Expression
) -> Expression:
    white = noise / DT**0.5
    # constant over the step: the ground is soft enough, and it is the most expensive part
    linear, angular = _contact(x, constants)
    contact = ca.vertcat(ca.SX.zeros(3), linear, ca.SX.zeros(4), angular, ca.SX.zeros(model.hidden_count))

    def field(state: Expression) -> Expression:
        return model.derivative(state, speed, constants["model"], environment, white) + contact

    return with_unit_attitude(rk4(field, x, DT, steps=required_steps(model, DT)))


def _contact(x: Expression, constants: Values) -> tuple[Expression, Expression]:
    points = ca.reshape(constants["feet"], 3, constants["feet"].shape[0] // 3)
    linear, angular = ground.contact_acceleration(x, points, constants["mass_over_inertia"], constants)
    hand, twist = ground.hand_acceleration(x, constants["held_at"])
    return linear + constants["held"] * hand, angular + constants["held"] * twist


def _observe(
    model: Model, x: Expression, speed: Expression, environment: Expression, constants: Values
) -> dict[str, Expression]:
    """Specific force and angular acceleration, rotor speeds, the ground's upward force per unit of mass.

    Ground contact is in the first two as well.
    """
    force, angular, rotor_speed = model.observe(x, speed, constants["model"], environment)
    support, turning = _contact(x, constants)
    return {
        "specific_force": force + quaternion.rotate_inverse(x[ATTITUDE], support),
        "angular_acceleration": angular + turning,
        "rotor_speed": rotor_speed,
        "ground_force": support[2],
    }


def _measure(
    x: Expression,
    read: Sequence[Expression],
    turning: Expression,
    state: Values,
    constants: Values,
    noise: Values,
) -> tuple[dict[str, Expression], Expression]:
    """States of sensors and estimator after the step, and the estimate without its delay: (13,) as the truth.

    read: outputs of the model's `measure`, as the sensors would read them without noise.
    turning: whether the rotors turn, whose vibration is most of the inertial sensors' noise.
    """
    force_read, rate_read, *_, arm, gyro_axes, _ = read
    gyro_noise = ca.if_else(turning, constants["gyro_noise"], constants["gyro_rest_noise"])
    force_noise = ca.if_else(turning, constants["accelerometer_noise"], constants["accelerometer_rest_noise"])
    gyro = quaternion.rotate_inverse(gyro_axes, rate_read) + constants["gyro_bias"] + gyro_noise * noise["gyro"]
    rate, memory = inner_loop.butterworth(gyro, state["gyro_memory"], constants["gyro_cutoff"], DT)
    acceleration = inner_loop.low_pass(
        (rate - state["rate"]) / DT, state["rate_acceleration"], constants["acceleration_cutoff"], DT
    )
    jitter = force_noise * noise["accelerometer"]
    force = force_read + constants["accelerometer_bias"] + jitter
    inertial = next_inertial_error(
        state["inertial_error"], quaternion.rotate(x[ATTITUDE], jitter)[2], constants["inertial_forgetting"], DT
    )
    states = {
        "gyro_memory": memory,
        "rate": rate,
        "rate_acceleration": acceleration,
        "force_integral": state["force_integral"] + force * DT,
        "gyro_integral": state["gyro_integral"] + gyro * DT,
        "inertial_error": inertial,
        **_estimate_errors(turning, state, constants, noise["estimate"]),
    }
    position = x[POSITION] + quaternion.rotate(x[ATTITUDE], arm)
    velocity = x[VELOCITY] + quaternion.rotate(x[ATTITUDE], ca.cross(x[RATE], arm))
    error = states["estimate_error"] + states["wander"] + states["offset"]
    error = error + ca.vertcat(0, 0, inertial[1], 0, 0, inertial[0], 0, 0, 0)
    return states, ca.vertcat(position + error[0:3], velocity + error[3:6], _estimated_attitude(x, states), rate)


def _estimate_errors(turning: Expression, state: Values, constants: Values, noise: Expression) -> dict[str, Expression]:
    """States of the estimate's errors after the step: fast and smooth ones, and offsets that drift. (9,) each."""
    driving = noise * ca.if_else(turning, 1, constants["wander_rest"])
    wander, rate = next_wander(state["wander"], state["wander_rate"], driving, constants, DT)
    return {
        "estimate_error": next_estimate_error(state["estimate_error"], driving, constants, DT),
        "wander": wander,
        "wander_rate": rate,
        "offset": state["offset"] + DT * constants["drift"],
    }


def _estimated_attitude(x: Expression, errors: Values) -> Expression:
    """(4,) fast errors turn about body axes, the others about the world's."""
    true = quaternion.multiply(x[ATTITUDE], quaternion.exponential(errors["estimate_error"][6:9]))
    return quaternion.multiply(quaternion.exponential((errors["wander"] + errors["offset"])[6:9]), true)


def _discharge(state: Values, rotor_speed: Expression, constants: Values) -> tuple[dict[str, Expression], Expression]:
    """Charge and voltage after the step, and the current drawn in it, A."""
    current = battery.current_drawn(rotor_speed, constants["torque_constant"], state["voltage"])
    charge = ca.fmax(state["charge"] - current * DT / constants["capacity"], 0)
    return {"charge": charge, "voltage": battery.next_voltage(charge, current, constants)}, current
