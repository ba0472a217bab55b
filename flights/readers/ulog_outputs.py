"""Motor outputs of a ULog: which instance of actuator_outputs they are on, on which of its channels, in which range.

PX4 numbers instances in the order in which drivers start: main and auxiliary pins and UAVCAN may be any of them. A
parameter names the function of a port's channel since PX4 1.13, and no instance; before, channel n is motor n.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from dynamics.arrays import Floats
from flights.assembly import Assembly
from flights.movement import moves, moving_columns
from flights.readers.px4_rotors import FIRST_MOTOR_FUNCTION, LAST_MOTOR_FUNCTION
from flights.readers.ulog_topics import Topic, Topics
from flights.rotor_ranges import MAX_ABOVE, PULSES, PX4_DSHOT, PX4_KINDS, UAVCAN, CommandRange, Thrust, infer_range

OUTPUTS = "actuator_outputs"
_FUNCTION = re.compile(r"(\w+)_FUNC(\d+)$")
_MAX_OUTPUTS = 16
_DSHOT_TIMERS = range(-5, -1)  # PWM_MAIN_TIMn of DShot 150 to 1200; -1 is OneShot, which is logged as pulses
_UAVCAN_ESCS = 3  # UAVCAN_ENABLE: sensors and motors


@dataclass(frozen=True, eq=False)
class _Reading:
    """One way to read motors from one instance.

    port: of the parameters, empty for firmware that names no functions.
    channels: of each motor.
    values: (n, motors), as logged.
    """

    topic: Topic
    port: str
    channels: tuple[int, ...]
    values: Floats

    @property
    def moving(self) -> int:
        """Number of motors whose output moves."""
        return len(moving_columns(self.values))


def motor_outputs(assembly: Assembly, topics: Topics, count: int, thrust: Thrust | None) -> tuple[Topic, Floats] | None:
    """actuator_outputs as commands of 0 to 1 by motor, of the instance whose motors move; others are kept as unused.

    count: of motors by the vehicle's type, 0 where it tells none.
    """
    logged = [topic for n in topics.instances(OUTPUTS) if (topic := topics.get(OUTPUTS, n)) is not None]
    motors = _motors(assembly.parameters, count)
    readings = [
        _Reading(topic, port, channels, np.stack([topic[f"output[{channel}]"] for channel in channels], axis=1))
        for topic in logged
        for port, channels in motors.items()
        if topic.has(*(f"output[{channel}]" for channel in channels))
    ]
    best, result, ranged = _best(readings, thrust), None, None
    if best is not None:
        ranged = infer_range(best.topic.time, best.values, _stated(assembly.parameters, best), PX4_KINDS, thrust)
    if best is not None and ranged is not None:
        result = best.topic, ranged.scaled(best.values)
        assembly.infer(_described(best, ranged))
    for topic in logged:
        used = best.channels if result is not None and best is not None and topic is best.topic else ()
        _keep(assembly, topic, used, _reason(topic, best, ranged, motors, assembly.parameters))
    return result


def _described(best: _Reading, ranged: CommandRange) -> str:
    if best.port:
        named = ", ".join(str(channel + 1) for channel in best.channels)
        return f"rotor commands are {best.topic.label}, channels {named} by {best.port}_FUNCn: {ranged}"
    return f"the log names no output functions: output n of {best.topic.label} is taken for motor n: {ranged}"


def _reason(
    topic: Topic,
    best: _Reading | None,
    ranged: CommandRange | None,
    motors: Mapping[str, Sequence[int]],
    parameters: Mapping[str, float],
) -> str:
    if best is None and motors:
        return "the outputs that should be motors are zero"
    if best is None and _names_functions(parameters):
        return "no function names them as a motor, or the motors are spread over several ports"
    if best is None:
        return "no function names them, and the log tells neither a multirotor nor its number of motors"
    if topic is not best.topic:
        return f"the motors are read from {best.topic.label}"
    return "no motor is on them" if ranged is not None else "their range is none that is known"


def _keep(assembly: Assembly, topic: Topic, used: Sequence[int], reason: str) -> None:
    """Keep the channels of an instance that are not used: those that move, or all that have a value."""
    fields = [f"output[{n}]" for n in range(_MAX_OUTPUTS) if n not in used and topic.has(f"output[{n}]")]
    if not fields:
        return
    table = topic.stack(*fields)
    shown = [index for index, column in enumerate(table.T) if np.any(column != 0.0) or not used]
    if used:  # beside the motors only what moves may be anything
        shown = [index for index in shown if moves(table[:, index])]
    if shown:
        assembly.leave_out("rotor_command", topic.label, [fields[index] for index in shown], table[:, shown], reason)


def _best(readings: Sequence[_Reading], thrust: Thrust | None) -> _Reading | None:
    """The reading of which most motors move, of several the one that goes with the thrust; else one that is not 0."""
    count = max((reading.moving for reading in readings), default=0)
    if count:
        moving = [reading for reading in readings if reading.moving == count]
        return moving[0] if thrust is None else max(moving, key=lambda reading: _goes_with(reading, thrust))
    return next((reading for reading in readings if (np.nan_to_num(reading.values) != 0.0).any(axis=0).all()), None)


def _goes_with(reading: _Reading, thrust: Thrust) -> float:
    """Correlation of the outputs' mean with the thrust."""
    time = reading.topic.time
    force = np.interp(time, thrust.time, thrust.force)
    mean = np.mean(reading.values, axis=1)
    valid = np.isfinite(force) & np.isfinite(mean)
    if np.count_nonzero(valid) < 2 or np.ptp(force[valid]) == 0.0 or np.ptp(mean[valid]) == 0.0:
        return 0.0
    return float(np.corrcoef(force[valid], mean[valid])[0, 1])


def _names_functions(parameters: Mapping[str, float]) -> bool:
    """Whether parameters name the functions of outputs; PX4 1.13 has them and may mix by files as before."""
    return parameters.get("SYS_CTRL_ALLOC", 1) != 0 and any(_FUNCTION.match(name) for name in parameters)


def _motors(parameters: Mapping[str, float], count: int) -> dict[str, tuple[int, ...]]:
    """Channels of the motors by port, of ports that hold them all; of firmware without functions the first ones.

    count: of motors by the vehicle's type, 0 where it tells none.
    """
    if not _names_functions(parameters):
        return {"": tuple(range(count))} if count else {}
    ports: dict[str, dict[int, int]] = {}
    for name, value in parameters.items():
        match = _FUNCTION.match(name)
        if match and FIRST_MOTOR_FUNCTION <= value <= LAST_MOTOR_FUNCTION:
            ports.setdefault(match[1], {})[int(value) - FIRST_MOTOR_FUNCTION] = int(match[2]) - 1
    return {
        port: tuple(channels[motor] for motor in range(len(channels)))
        for port, channels in ports.items()
        if sorted(channels) == list(range(len(channels)))
    }


def _stated(parameters: Mapping[str, float], reading: _Reading) -> list[CommandRange]:
    """Ranges of the motors that the parameters state, the likeliest first."""
    ports = [reading.port] if reading.port else ["PWM_MAIN", "PWM_AUX"]
    if not reading.port and reading.topic.label.endswith("[1]"):
        ports.reverse()
    pulses = [one for port in ports for one in _pulses(parameters, port, reading.channels)]
    dshot, uavcan = list(_dshot(parameters, ports, reading)), list(_uavcan(parameters, ports, reading))
    beyond = np.nanmax(reading.values, initial=0.0) > PX4_DSHOT[2] * (1 + MAX_ABOVE)  # what only UAVCAN reaches
    return [*(uavcan if beyond or reading.port else ()), *dshot, *pulses]


def _pulses(parameters: Mapping[str, float], port: str, channels: Sequence[int]) -> Iterator[CommandRange]:
    if not port.startswith("PWM"):
        return
    ends: list[tuple[float, ...]] = []
    names: set[str] = set()
    for end, default in (("MIN", PULSES[1]), ("MAX", PULSES[2])):
        values = []
        for channel in channels:
            tried = (f"{port}_{end}{channel + 1}", f"{port}_{end}", f"PWM_{end}")
            name = next((name for name in tried if parameters.get(name, -1.0) > 0), "")
            values.append(parameters.get(name, default))
            names |= {name.rstrip("0123456789") + ("n" if name[-1].isdigit() else "")} if name else set()
        ends.append(tuple(values))
    if names:
        yield CommandRange(PULSES[0], ends[0], ends[1], " and ".join(sorted(names, reverse=True)))


def _dshot(parameters: Mapping[str, float], ports: Sequence[str], reading: _Reading) -> Iterator[CommandRange]:
    timers = [
        name
        for port in ports
        for name, value in parameters.items()
        if re.fullmatch(rf"{port}_TIM\d+", name) and int(value) in _DSHOT_TIMERS
    ]
    if parameters.get("DSHOT_CONFIG", 0) > 0:
        timers = ["DSHOT_CONFIG"]
    if timers:
        minimum = parameters.get("DSHOT_MIN", 0.0)
        basis = timers[0] + (" and DSHOT_MIN" if minimum else "")
        yield CommandRange.of(PX4_DSHOT[0], minimum * PX4_DSHOT[2], PX4_DSHOT[2], len(reading.channels), basis)


def _uavcan(parameters: Mapping[str, float], ports: Sequence[str], reading: _Reading) -> Iterator[CommandRange]:
    if ports == ["UAVCAN_EC"]:
        ends = [
            tuple(parameters.get(f"UAVCAN_EC_{end}{channel + 1}", default) for channel in reading.channels)
            for end, default in (("MIN", UAVCAN[1]), ("MAX", UAVCAN[2]))
        ]
        yield CommandRange(UAVCAN[0], ends[0], ends[1], "UAVCAN_EC_MINn and MAXn")
    elif not reading.port and parameters.get("UAVCAN_ENABLE", 0) >= _UAVCAN_ESCS:
        yield CommandRange.of(*UAVCAN, len(reading.channels), "UAVCAN_ENABLE")
