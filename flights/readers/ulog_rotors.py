"""Rotor speeds and commands of a ULog, by motor function and in our rotor order."""

from __future__ import annotations

import re

import numpy as np

from dynamics.arrays import Floats
from dynamics.units import RPM
from flights.assembly import Assembly
from flights.readers.px4_rotors import (
    FIRST_MOTOR_FUNCTION,
    LAST_MOTOR_FUNCTION,
    QUADROTOR,
    in_our_order,
    rotor_order,
)
from flights.readers.ulog_topics import Topic, Topics

TOPICS = ("actuator_motors", "actuator_outputs", "actuator_controls_0", "esc_status")

THRUST_MODEL = "THR_MDL_FAC"  # share of a motor's thrust that PX4 takes to go with the square of its signal
_ROTORS_OF_TYPE = {2: 4, 13: 6, 14: 8}  # MAV_TYPE: quadrotor, hexarotor, octorotor
_LOW_PWM, _HIGH_PWM = 1000.0, 2000.0  # PX4's defaults, microseconds
# PX4's quad x mixer, one row a motor: roll, pitch, yaw
_QUAD_X_MIXER = np.array(
    [[-1.0, 1.0, np.sqrt(2)], [1.0, -1.0, np.sqrt(2)], [1.0, 1.0, -np.sqrt(2)], [-1.0, -1.0, -np.sqrt(2)]]
) * np.sqrt(0.5)


def add_streams(assembly: Assembly, topics: Topics, vehicle_type: int | None) -> None:
    """Rotor speeds, and of all sources of rotor commands the fastest first. vehicle_type: MAV_TYPE."""
    order, why = rotor_order(assembly.parameters, vehicle_type)
    speeds = _esc_speeds(assembly, topics)
    if speeds is not None:
        assembly.add("rotor_speed", speeds[0].time, in_our_order(speeds[1], order), "esc_status")
    factor = assembly.parameters.get(THRUST_MODEL, 0.0)
    commands = [
        source
        for source in (
            _of_thrust(_motors(topics), factor, assembly),
            _outputs(assembly, topics, vehicle_type),
            _of_thrust(_mixed(assembly, topics, vehicle_type), factor, assembly),
        )
        if source is not None
    ]
    for topic, motors in sorted(commands, key=lambda pair: -len(pair[0].time)):
        assembly.add("rotor_command", topic.time, in_our_order(motors, order), topic.name)
    if speeds is not None or commands:
        assembly.note(why)


def _esc_speeds(assembly: Assembly, topics: Topics) -> tuple[Topic, Floats] | None:
    """Speeds by motor, rad/s; esc[i] is the motor that its actuator_function names."""
    topic = topics.get("esc_status")
    if topic is None or not topic.has("esc[0].esc_rpm"):
        return None
    present = [esc for esc in range(8) if topic.has(f"esc[{esc}].esc_rpm")]
    functions = {esc: _function(topic, esc) for esc in present}
    motors = {
        function - FIRST_MOTOR_FUNCTION: esc
        for esc, function in functions.items()
        if FIRST_MOTOR_FUNCTION <= function <= LAST_MOTOR_FUNCTION
    }
    if not motors:
        count = int(np.max(topic["esc_count"])) if topic.has("esc_count") else len(present)
        motors = {esc: esc for esc in present[: count or len(present)]}
        assembly.note("esc_status names no actuator_function: esc n is taken for motor n")
    if sorted(motors) != list(range(len(motors))):
        assembly.note(f"esc_status has the motors {sorted(motors)} only, so its speeds are left out")
        return None
    rpm = np.stack([np.abs(topic[f"esc[{motors[motor]}].esc_rpm"]) for motor in range(len(motors))], axis=1)
    return topic, rpm * RPM


def _function(topic: Topic, esc: int) -> int:
    field = f"esc[{esc}].actuator_function"
    return int(np.max(topic[field])) if topic.has(field) else 0


def _motors(topics: Topics) -> tuple[Topic, Floats] | None:
    """actuator_motors: 0..1 by motor, NaN for those that do not exist."""
    topic = topics.get("actuator_motors")
    if topic is None:
        return None
    control = topic.array("control", 12)
    missing = np.flatnonzero(~np.isfinite(control).any(axis=0))
    count = int(missing[0]) if len(missing) else control.shape[1]
    return (topic, control[:, :count]) if count else None


def _of_thrust(source: tuple[Topic, Floats] | None, factor: float, assembly: Assembly) -> tuple[Topic, Floats] | None:
    """Motor signals of commanded thrusts of 0..1, as PX4's outputs have them: the inverse of f s^2 + (1 - f) s.

    factor: f, THR_MDL_FAC; PX4 applies no curve outside 0 to 1. Source: PX4-Autopilot, FunctionMotors.hpp.
    """
    if source is None or not 0.0 < factor <= 1.0:
        return source
    topic, thrust = source
    linear = 1.0 - factor
    signal = (np.sqrt(linear**2 + 4 * factor * np.maximum(thrust, 0.0)) - linear) / (2 * factor)
    assembly.note(
        f"{topic.name} holds thrusts: rotor commands are the motor signals that PX4 makes of them "
        f"({THRUST_MODEL} {factor:.3g})"
    )
    return topic, np.where(thrust > 0.0, signal, thrust)


def _outputs(assembly: Assembly, topics: Topics, vehicle_type: int | None) -> tuple[Topic, Floats] | None:
    """actuator_outputs as 0..1 by motor: pulses scaled by their limits, channels mapped by their function."""
    for instance, port in ((0, "MAIN"), (1, "AUX")):
        topic = topics.get("actuator_outputs", instance)
        if topic is None:
            continue
        motors = _channels_of_motors(assembly, port)
        if motors is None:
            count = _ROTORS_OF_TYPE.get(vehicle_type or 0, 0)
            motors = {motor: motor for motor in range(count)}
            assembly.note(
                "the log names no output functions: output n of actuator_outputs is taken for motor n"
                if count
                else "the log names neither output functions nor a multirotor: actuator_outputs is left out"
            )
        if not motors or sorted(motors) != list(range(len(motors))):
            continue
        columns = [_normalised(topic, motors[motor], port, assembly) for motor in range(len(motors))]
        return topic, np.stack(columns, axis=1)
    return None


def _channels_of_motors(assembly: Assembly, port: str) -> dict[int, int] | None:
    """Motor to output channel by PWM_<port>_FUNCn; None for firmware that has no such parameters."""
    pattern = re.compile(rf"PWM_{port}_FUNC(\d+)$|HIL_ACT_FUNC(\d+)$")
    functions = {name: value for name, value in assembly.parameters.items() if pattern.match(name)}
    if not functions:
        return None
    return {
        int(value) - FIRST_MOTOR_FUNCTION: int(next(filter(None, pattern.match(name).groups()))) - 1  # type: ignore[union-attr]
        for name, value in functions.items()
        if FIRST_MOTOR_FUNCTION <= value <= LAST_MOTOR_FUNCTION
    }


def _normalised(topic: Topic, channel: int, port: str, assembly: Assembly) -> Floats:
    """One output, 0..1; simulators log that already."""
    output = topic[f"output[{channel}]"]
    if np.nanmax(np.abs(output), initial=0.0) <= 1.0:
        return output
    low = _limit(assembly, port, channel, "MIN", _LOW_PWM)
    high = _limit(assembly, port, channel, "MAX", _HIGH_PWM)
    return np.clip((output - low) / (high - low), 0.0, 1.0)


def _limit(assembly: Assembly, port: str, channel: int, end: str, default: float) -> float:
    for name in (f"PWM_{port}_{end}{channel + 1}", f"PWM_{port}_{end}", f"PWM_{end}"):
        value = assembly.parameters.get(name, -1.0)
        if value > 0:
            return value
    return default


def _mixed(assembly: Assembly, topics: Topics, vehicle_type: int | None) -> tuple[Topic, Floats] | None:
    """Rotor commands rebuilt from actuator_controls_0, which old logs hold at a far higher rate than the outputs."""
    topic = topics.get("actuator_controls_0")
    if topic is None or vehicle_type != QUADROTOR or not topic.has("control[3]"):
        return None
    control = topic.array("control", 4)
    mixed = control[:, 3:] + control[:, :3] @ _QUAD_X_MIXER.T
    assembly.note(
        "rotor commands from actuator_controls_0 are rebuilt by PX4's quad x mixer, without its handling of saturation"
    )
    return topic, np.clip(mixed, 0.0, 1.0)
