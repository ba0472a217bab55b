"""Rotor speeds and commands of a ULog, by motor function and in our rotor order."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

import numpy as np

from dynamics.arrays import Floats
from dynamics.units import RPM
from flights.assembly import Assembly
from flights.movement import moving_columns
from flights.readers.px4_rotors import (
    FIRST_MOTOR_FUNCTION,
    LAST_MOTOR_FUNCTION,
    QUADROTOR,
    in_our_order,
    rotor_order,
)
from flights.readers.ulog_outputs import OUTPUTS, motor_outputs
from flights.readers.ulog_topics import Topic, Topics
from flights.rotor_ranges import Thrust

TOPICS = ("actuator_motors", OUTPUTS, "actuator_controls_0", "esc_status")

THRUST_MODEL = "THR_MDL_FAC"  # share of a motor's thrust that PX4 takes to go with the square of its signal
_ROTORS_OF_TYPE = {2: 4, 13: 6, 14: 8}  # MAV_TYPE: quadrotor, hexarotor, octorotor
_MAX_ESCS = 8
_POLES = re.compile(r"MOT_POLE_COUNT|DSHOT_MOT_POL\d+")
# PX4's quad x mixer, one row a motor: roll, pitch, yaw
_QUAD_X_MIXER = np.array(
    [[-1.0, 1.0, np.sqrt(2)], [1.0, -1.0, np.sqrt(2)], [1.0, 1.0, -np.sqrt(2)], [-1.0, -1.0, -np.sqrt(2)]]
) * np.sqrt(0.5)


def add_streams(assembly: Assembly, topics: Topics, vehicle_type: int | None) -> None:
    """Rotor speeds, and sources of rotor commands: first what moves, of that the fastest. vehicle_type: MAV_TYPE."""
    order, why = rotor_order(assembly.parameters, vehicle_type)
    count = int(assembly.parameters.get("CA_ROTOR_COUNT", 0)) or _ROTORS_OF_TYPE.get(vehicle_type or 0, 0)
    speeds = _esc_speeds(assembly, topics, count)
    if speeds is not None:
        assembly.add("rotor_speed", speeds[0].time, in_our_order(speeds[1], order), speeds[0].source)
    factor = assembly.parameters.get(THRUST_MODEL, 0.0)
    force = assembly.stream("specific_force")
    thrust = None if force is None else Thrust(force.time, force.values[:, 2])
    commands = [
        source
        for source in (
            _of_thrust(_motors(assembly, topics), factor, assembly),
            motor_outputs(assembly, topics, count, thrust),
            _of_thrust(_mixed(assembly, topics, vehicle_type), factor, assembly),
        )
        if source is not None
    ]
    for topic, motors in sorted(commands, key=lambda pair: (not moving_columns(pair[1]), -len(pair[0].time))):
        assembly.add("rotor_command", topic.time, in_our_order(motors, order), topic.source)
    if speeds is not None or commands:
        assembly.note(why)


def _esc_speeds(assembly: Assembly, topics: Topics, count: int) -> tuple[Topic, Floats] | None:
    """Speeds by motor, rad/s, of the first instance whose ESCs turn; the others are kept as unused.

    count: of rotors by the vehicle, 0 where it tells none.
    """
    chosen: tuple[Topic, Floats] | None = None
    for instance in topics.instances("esc_status"):
        topic = topics.get("esc_status", instance)
        present = [esc for esc in range(_MAX_ESCS) if topic is not None and topic.has(f"esc[{esc}].esc_rpm")]
        if topic is None or not present:
            continue
        rpm = np.abs(topic.stack(*(f"esc[{esc}].esc_rpm" for esc in present)))
        turning = [present[column] for column in moving_columns(rpm)]
        escs, reason = _escs_of_motors(topic, present, turning, count)
        if escs is None or chosen is not None:
            reason = reason or f"the speeds are read from {chosen[0].label if chosen else ''}"
            assembly.leave_out("rotor_speed", topic.label, [f"esc[{esc}].esc_rpm" for esc in present], rpm, reason)
            assembly.note(f"{topic.label}: {reason}, so its speeds are left out")
            continue
        chosen = topic, rpm[:, [present.index(esc) for esc in escs]] * RPM
        poles = _poles(assembly.parameters)
        named = reason or "the motor that its actuator_function names"
        assembly.infer(f"rotor speeds are {topic.label}'s, taken for rpm of the rotor: esc n is {named}{poles}")
    return chosen


def _escs_of_motors(
    topic: Topic, present: Sequence[int], turning: Sequence[int], count: int
) -> tuple[list[int] | None, str]:
    """The ESC of each motor with a word on how it is known, or None and why there are none."""
    motors: dict[int, int] = {}
    for esc in present:
        function = _function(topic, esc)
        if FIRST_MOTOR_FUNCTION <= function <= LAST_MOTOR_FUNCTION:
            motors[function - FIRST_MOTOR_FUNCTION] = esc
    if not turning:
        return None, "no ESC ever turns"
    if not motors:
        logged = int(np.max(topic["esc_count"])) if topic.has("esc_count") else 0
        number = count or logged or len(present)
        escs = list(present[:number])
        if not set(turning) <= set(escs) and len(turning) in (count, number):  # what never turns is no motor
            escs = list(turning)
        elif not count:
            escs = [esc for esc in escs if esc <= max(turning)]
        return escs, "taken for motor n, as it names no actuator_function"
    if sorted(motors) != list(range(len(motors))):
        return None, f"it has the motors {sorted(motors)} only"
    return [motors[motor] for motor in range(len(motors))], ""


def _poles(parameters: Mapping[str, float]) -> str:
    """The magnets by which the autopilot made rotor speeds of electrical ones, for the note on them."""
    poles = {int(value) for name, value in parameters.items() if _POLES.fullmatch(name) and value > 0}
    if not poles:
        return ""
    return f"; the autopilot divides electrical speeds by {' or '.join(f'{n / 2:g}' for n in sorted(poles))} pole pairs"


def _function(topic: Topic, esc: int) -> int:
    field = f"esc[{esc}].actuator_function"
    return int(np.max(topic[field])) if topic.has(field) else 0


def _motors(assembly: Assembly, topics: Topics) -> tuple[Topic, Floats] | None:
    """actuator_motors: 0..1 by motor, NaN for those that do not exist, of the first instance that moves."""
    logged: list[tuple[Topic, Floats]] = []
    for instance in topics.instances("actuator_motors"):
        topic = topics.get("actuator_motors", instance)
        if topic is None or not topic.has("control[0]", "control[11]"):
            continue
        control = topic.array("control", 12)
        missing = np.flatnonzero(~np.isfinite(control).any(axis=0))
        count = int(missing[0]) if len(missing) else control.shape[1]
        if count:
            logged.append((topic, control[:, :count]))
    chosen = next((one for one in logged if moving_columns(one[1])), logged[0] if logged else None)
    for topic, control in logged:
        if chosen is not None and topic is not chosen[0]:
            fields = [f"control[{motor}]" for motor in range(control.shape[1])]
            reason = f"the motors are read from {chosen[0].label}"
            assembly.leave_out("rotor_command", topic.label, fields, control, reason)
    return chosen


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


def _mixed(assembly: Assembly, topics: Topics, vehicle_type: int | None) -> tuple[Topic, Floats] | None:
    """Rotor commands rebuilt from actuator_controls_0, which old logs hold at a far higher rate than the outputs."""
    topic = topics.get("actuator_controls_0")
    if topic is None or not topic.has("control[3]"):
        return None
    control = topic.array("control", 4)
    if vehicle_type != QUADROTOR:
        reason = "they are roll, pitch, yaw and thrust before a mixer, which is known of a quadrotor alone"
        assembly.leave_out("rotor_command", topic.label, [f"control[{n}]" for n in range(4)], control, reason)
        return None
    mixed = control[:, 3:] + control[:, :3] @ _QUAD_X_MIXER.T
    assembly.note(
        "rotor commands from actuator_controls_0 are rebuilt by PX4's quad x mixer, without its handling of saturation"
    )
    return topic, np.clip(mixed, 0.0, 1.0)
