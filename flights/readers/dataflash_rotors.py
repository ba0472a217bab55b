"""Rotor commands and speeds of an ArduPilot log: outputs of the motors, their range, and whose each ESC is."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from dynamics.arrays import Floats
from dynamics.autopilot_frames import FRAMES, QUAD_X_ORDER, ardupilot_frame
from dynamics.units import RPM
from flights.assembly import Assembly
from flights.movement import moves, moving_columns
from flights.readers.dataflash_messages import Messages
from flights.readers.px4_rotors import in_our_order
from flights.rotor_ranges import ALL_KINDS, ONESHOT, PULSES, CommandRange, Thrust, infer_range

MESSAGES = ("RCOU", "RCO2", "RCO3")  # outputs 1 to 14, 15 to 18, 19 to 32
_FIRST_OUTPUT = {"RCOU": 1, "RCO2": 15, "RCO3": 19}
_MAX_OUTPUTS = 32
_MOTOR_FUNCTIONS = {**{33 + motor: motor for motor in range(8)}, **{82 + motor: 8 + motor for motor in range(4)}}
_MOTORS_OF_CLASS = {1: 4, 2: 6, 3: 8, 4: 8, 5: 6}  # FRAME_CLASS: quad, hexa, octa, octaquad, Y6
_COPTER_COUNTS = (8, 6, 4)
_CLASS_OF_COUNT = {4: 1, 6: 2, 8: 3}
_THROTTLE = 3  # RCMAP_THROTTLE: the stick whose range is the motors' where MOT_PWM_MIN and MAX are 0


def add_rotors(assembly: Assembly, collected: Mapping[str, Messages], escs: Mapping[int, Messages]) -> None:
    """Add rotor commands and speeds. collected: messages by name. escs: those of ESC by instance."""
    outputs = _outputs(collected)
    channels, why = _motor_outputs(assembly.parameters, outputs)
    order = _order(assembly, len(channels))
    if channels:
        time = assembly.seconds(collected["RCOU"].integers("TimeUS"), 1_000_000)
        pulses = np.stack([outputs[channel] for channel in channels], axis=1)
        force = assembly.stream("specific_force")
        thrust = None if force is None else Thrust(force.time, force.values[:, 2])
        ranged = infer_range(time, pulses, list(_stated(assembly.parameters, len(channels))), ALL_KINDS, thrust)
        if ranged is not None:
            assembly.infer(f"rotor commands are outputs {_numbers(channels)} of RCOU{why}: {ranged}")
            assembly.add("rotor_command", time, in_our_order(ranged.scaled(pulses), order), "RCOU")
        else:
            why, channels = "their range is none that is known", []
    _keep(assembly, outputs, channels, why)
    _add_speeds(assembly, channels, escs, order)


def _numbers(channels: Sequence[int]) -> str:
    return ", ".join(map(str, channels))


def _outputs(collected: Mapping[str, Messages]) -> dict[int, Floats]:
    """Pulses of each output that was logged, by its number from 1, at the times of RCOU."""
    if "RCOU" not in collected:
        return {}
    stamps = collected["RCOU"].integers("TimeUS")
    pulses: dict[int, Floats] = {}
    for kind in MESSAGES:
        rows = collected.get(kind)
        if rows is None or not len(rows.rows):
            continue
        for output in range(1, _MAX_OUTPUTS + 1):
            if rows.has(f"C{output}") and output >= _FIRST_OUTPUT[kind]:
                field = f"C{output}"
                pulses[output] = rows.numbers(field) if kind == "RCOU" else nearest(rows, field, stamps)
    return pulses


def nearest(rows: Messages, field: str, stamps: NDArray[np.int64]) -> Floats:
    """(n,) a field at the messages that are nearest to stamps (n,), of which some may be lost."""
    own = np.maximum.accumulate(rows.integers("TimeUS"))
    middles = own[:-1] + np.diff(own) // 2
    return rows.numbers(field)[np.searchsorted(middles, stamps)]


def _motor_outputs(parameters: Mapping[str, float], outputs: Mapping[int, Floats]) -> tuple[list[int], str]:
    """The outputs of the motors in their order, with a word on how they are known; or none, and why."""
    functions = {n: int(parameters[f"SERVO{n}_FUNCTION"]) for n in range(1, 33) if f"SERVO{n}_FUNCTION" in parameters}
    if not functions:
        return _first_outputs(parameters, outputs)
    motors = {_MOTOR_FUNCTIONS[function]: n for n, function in functions.items() if function in _MOTOR_FUNCTIONS}
    if not motors:
        return [], "no SERVOn_FUNCTION names them as motors"
    lacking = [n for n in motors.values() if n not in outputs]
    if lacking or sorted(motors) != list(range(len(motors))):
        return (
            [],
            f"SERVOn_FUNCTION names the motors {[motor + 1 for motor in sorted(motors)]} only, or not all are logged",
        )
    channels = [motors[motor] for motor in range(len(motors))]
    if not any(moves(outputs[n]) for n in channels) and any(moves(values) for values in outputs.values()):
        still = f"while the outputs {_numbers(channels)}, which it names, stand still"
        return [], f"no SERVOn_FUNCTION names them as motors, {still}"
    return channels, " by SERVOn_FUNCTION"


def _first_outputs(parameters: Mapping[str, float], outputs: Mapping[int, Floats]) -> tuple[list[int], str]:
    """Motors of a Copter before 3.5, which names no functions: motor n is on output n."""
    moving = next((n - 1 for n in range(1, 10) if n not in outputs or not moves(outputs[n])), 8)
    stated = _MOTORS_OF_CLASS.get(int(parameters.get("FRAME_CLASS", 0)), 0)
    count = stated if 0 < stated <= moving else next((n for n in _COPTER_COUNTS if n <= moving), 0)
    if not count:
        return [], "no SERVOn_FUNCTION names the motors' outputs, and the first outputs do not move together"
    return list(
        range(1, count + 1)
    ), ", output n taken for motor n as of Copter before 3.5, since no SERVOn_FUNCTION is logged"


def _order(assembly: Assembly, count: int) -> tuple[int, ...] | None:
    """Motors in our order by the frame. count: of motors, which tells the class where FRAME alone is logged."""
    parameters = assembly.parameters
    if "FRAME_CLASS" in parameters:
        frame = ardupilot_frame(int(parameters["FRAME_CLASS"]), int(parameters.get("FRAME_TYPE", -1)))
    else:  # Copter before 3.5: the class was the firmware's
        frame = ardupilot_frame(_CLASS_OF_COUNT.get(count, 0), int(parameters.get("FRAME", -1)))
    order = QUAD_X_ORDER if frame is not None and FRAMES[frame].order == QUAD_X_ORDER else None
    named = (frame or "").replace("_", " ")
    assembly.note(f"motors put in our order as ArduPilot's {named}" if order else "motors left in ArduPilot's order")
    return order


def _stated(parameters: Mapping[str, float], count: int) -> Iterator[CommandRange]:
    """Ranges of the motors' pulses that the parameters state, each with its eighth, which OneShot125 is."""
    stick = f"RC{int(parameters.get('RCMAP_THROTTLE', _THROTTLE))}"
    low, high = parameters.get("MOT_PWM_MIN", 0.0), parameters.get("MOT_PWM_MAX", 0.0)
    pairs = [("MOT_PWM_MIN and MAX", low, high)]
    pairs.append((f"{stick}_MIN and MAX", parameters.get(f"{stick}_MIN", 0.0), parameters.get(f"{stick}_MAX", 0.0)))
    for basis, lowest, highest in pairs:
        if 0.0 < lowest < highest:
            yield CommandRange.of(PULSES[0], lowest, highest, count, basis)
            yield CommandRange.of(ONESHOT[0], lowest / 8, highest / 8, count, f"an eighth of {basis}")


def _keep(assembly: Assembly, outputs: Mapping[int, Floats], used: Sequence[int], reason: str) -> None:
    """Keep the outputs that are not used: those that move, or all that have a value where none is used."""
    left = [n for n in outputs if n not in used and np.any(outputs[n] != 0.0) and (moves(outputs[n]) or not used)]
    if left:
        table = np.stack([outputs[n] for n in left], axis=1)
        reason = "no function names them as motors" if used else reason
        assembly.leave_out("rotor_command", "RCOU", [f"C{n}" for n in left], table, reason)


def _add_speeds(
    assembly: Assembly, channels: Sequence[int], escs: Mapping[int, Messages], order: tuple[int, ...] | None
) -> None:
    """Add the speeds of the ESCs that are the motors'. channels: outputs of the motors, from 1."""
    if not escs:
        return
    instances = sorted(escs)
    stamps = escs[instances[0]].integers("TimeUS")
    rpm = np.stack([nearest(escs[esc], "RPM", stamps) for esc in instances], axis=1)
    turning = [instances[column] for column in moving_columns(rpm)]
    chosen = _escs_of_motors(channels, instances, turning)
    left = [esc for esc in instances if esc not in chosen]
    if left:
        reason = "no motor is on their outputs" if chosen else "which motors they turn is not known"
        if not set(left) & set(turning):
            reason = "they never turn"
        table = rpm[:, [instances.index(esc) for esc in left]]
        assembly.leave_out("rotor_speed", "ESC", [f"RPM[{esc}]" for esc in left], table, reason)
    if not chosen:
        return
    stamps = escs[chosen[0]].integers("TimeUS")
    speed = np.stack([nearest(escs[esc], "RPM", stamps) for esc in chosen], axis=1) * RPM
    assembly.note("the ESCs report one after the other: their speeds share the first one's time stamps")
    poles = assembly.parameters.get("SERVO_BLH_POLES", 0.0)
    divided = (
        f"; the autopilot divides electrical speeds by {poles / 2:g} pole pairs (SERVO_BLH_POLES)" if poles else ""
    )
    numbers = _numbers(chosen)
    assembly.infer(f"rotor speeds are those of the ESC messages' instances {numbers}, in rpm of the rotor{divided}")
    assembly.add("rotor_speed", assembly.seconds(stamps, 1_000_000), in_our_order(speed, order), "ESC")


def _escs_of_motors(channels: Sequence[int], instances: Sequence[int], turning: Sequence[int]) -> list[int]:
    """The ESC of each motor: that of its output (ArduPilot 4.5), else in the order of motors; none if unclear."""
    by_output = [channel - 1 for channel in channels]
    if by_output and set(by_output) <= set(instances) and (set(by_output) & set(turning)):
        return by_output
    for some in (turning, instances):
        if some and turning and (len(some) == len(channels) if channels else list(some) == list(range(len(some)))):
            return list(some)
    return [] if channels else list(turning)
