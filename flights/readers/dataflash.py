"""ArduPilot DataFlash logs (.bin), read by pymavlink: NED and FRD become ENU and FLU."""

from __future__ import annotations

import contextlib
import os
from array import array
from collections.abc import Mapping, Sequence

import numpy as np
from pymavlink.DFReader import DFReader_binary

from dynamics import frames, quaternion
from dynamics.arrays import Floats
from dynamics.autopilot_frames import FRAMES, QUAD_X_ORDER, ardupilot_frame
from dynamics.errors import DataError
from dynamics.units import RPM
from flights.assembly import Assembly
from flights.library_output import captured_output
from flights.log import LogContent
from flights.readers.px4_rotors import in_our_order
from flights.source import Source

# the message with which every log begins: FMT (128), which describes itself as 89 bytes long
_MAGIC = b"\xa3\x95\x80\x80\x59FMT\0"
_PWM_LOW, _PWM_HIGH = 1000.0, 2000.0  # microseconds, ArduPilot's MOT_PWM_MIN and MAX by default
_LATEST_STAMP = 4_102_444_800_000_000  # microseconds: the year 2100, for clocks that count from 1970
_MOTOR_1 = 33  # SERVOn_FUNCTION

# Message to its fields; instances other than the first are left out where the message has an instance field.
_FIELDS: Mapping[str, tuple[str, ...]] = {
    "XKF1": ("PN", "PE", "PD", "VN", "VE", "VD"),
    "NKF1": ("PN", "PE", "PD", "VN", "VE", "VD"),
    "XKQ": ("Q1", "Q2", "Q3", "Q4"),
    "NKQ": ("Q1", "Q2", "Q3", "Q4"),
    "ATT": ("Roll", "Pitch", "Yaw"),
    "IMU": ("GyrX", "GyrY", "GyrZ", "AccX", "AccY", "AccZ"),
    "RATE": ("RDes", "PDes", "YDes"),
    "RCOU": ("C1", "C2", "C3", "C4", "C5", "C6", "C7", "C8"),
    "BAT": ("Volt", "Curr"),
    "CURR": ("Volt", "Curr"),
    "ARM": ("ArmState",),
}
_INSTANCES = ("C", "I", "Instance", "Inst")


def matches(source: Source) -> bool:
    """Whether it begins with a FMT message."""
    return source.head.startswith(_MAGIC)


def read(source: Source) -> LogContent:
    """The streams of a DataFlash log. Raises DataError when it cannot be read."""
    assembly = Assembly()
    with captured_output() as printed:  # pymavlink prints a line for every damaged byte
        log = DFReader_binary.__new__(DFReader_binary)  # in two steps: one that fails would leave its file open
        try:
            log.__init__(os.fspath(source.file), zero_time_base=True)
            collected, speeds = _collect(log, assembly)
        except (OSError, ValueError, KeyError, IndexError, TypeError, AttributeError, ZeroDivisionError) as error:
            raise DataError(f"this DataFlash log cannot be read ({error!r}): it is cut off or damaged.") from None
        finally:
            for held in ("data_map", "filehandle"):
                with contextlib.suppress(AttributeError, BufferError):  # never opened, or still viewed by the error
                    getattr(log, held).close()
    if printed.first_line:
        assembly.repair("damaged_messages", f"pymavlink skipped damaged parts: {printed.first_line}")
    _add_streams(assembly, collected)
    _add_rotors(assembly, collected, speeds)
    return assembly.finish()


class _Rows:
    """Rows of one message: microseconds since boot and numbers."""

    def __init__(self) -> None:
        self.stamps = array("q")
        self.numbers = array("d")

    def add(self, stamp: int, numbers: Sequence[float]) -> None:
        self.stamps.append(stamp)
        self.numbers.extend(float(number) for number in numbers)

    @property
    def table(self) -> Floats:
        return np.array(self.numbers).reshape(len(self.stamps), -1)


def _collect(log: DFReader_binary, assembly: Assembly) -> tuple[dict[str, _Rows], dict[int, _Rows]]:
    collected: dict[str, _Rows] = {}
    speeds: dict[int, _Rows] = {}
    while (message := log.recv_match(type=[*_FIELDS, "PARM", "ESC"])) is not None:
        kind = message.get_type()
        if kind == "PARM":
            assembly.parameters[str(message.Name)] = float(message.Value)
        elif not hasattr(message, "TimeUS"):
            assembly.note(f"{kind} has no TimeUS, as of ArduPilot before 2015, and is left out")
        elif not 0 <= message.TimeUS < _LATEST_STAMP:
            assembly.repair("damaged_messages", f"{kind}: messages with an impossible time dropped")
        elif kind == "ESC":
            if hasattr(message, "Instance"):
                speeds.setdefault(int(message.Instance), _Rows()).add(message.TimeUS, [message.RPM])
        elif not any(getattr(message, name, 0) for name in _INSTANCES):
            numbers = [getattr(message, field, np.nan) for field in _FIELDS[kind]]
            collected.setdefault(kind, _Rows()).add(message.TimeUS, numbers)
    return collected, speeds


def _add_streams(assembly: Assembly, collected: Mapping[str, _Rows]) -> None:
    def rows(*kinds: str) -> tuple[Floats, Floats, str] | None:
        kind = next((kind for kind in kinds if kind in collected), None)
        if kind is None:
            return None
        return assembly.seconds(np.array(collected[kind].stamps), 1_000_000), collected[kind].table, kind

    if samples := rows("XKF1", "NKF1"):
        time, table, kind = samples
        assembly.add("position", time, frames.enu_from_ned(table[:, :3]), kind)
        assembly.add("velocity", time, frames.enu_from_ned(table[:, 3:]), kind)
    if samples := rows("XKQ", "NKQ"):
        time, table, kind = samples
        assembly.add("attitude", time, frames.attitude_enu_flu(table), kind)
    if samples := rows("ATT"):
        time, table, kind = samples
        angles = np.radians(table)
        attitude = frames.attitude_enu_flu(quaternion.from_euler(angles[:, 0], angles[:, 1], angles[:, 2]))
        assembly.add("attitude", time, attitude, kind)
    if samples := rows("IMU"):
        time, table, kind = samples
        assembly.add("rate", time, frames.flu_from_frd(table[:, :3]), kind)
        assembly.add("specific_force", time, frames.flu_from_frd(table[:, 3:]), kind)
    if samples := rows("RATE"):
        time, table, kind = samples
        assembly.add("rate_setpoint", time, frames.flu_from_frd(np.radians(table)), kind)
    if samples := rows("BAT", "CURR"):
        time, table, kind = samples
        assembly.add("battery_voltage", time, table[:, 0], kind)
        assembly.add("battery_current", time, table[:, 1], kind)
    if samples := rows("ARM"):
        time, table, kind = samples
        assembly.add("armed", time, table[:, 0] != 0, kind)


def _add_rotors(assembly: Assembly, collected: Mapping[str, _Rows], speeds: Mapping[int, _Rows]) -> None:
    parameters = assembly.parameters
    frame = ardupilot_frame(int(parameters.get("FRAME_CLASS", 0)), int(parameters.get("FRAME_TYPE", -1)))
    order = QUAD_X_ORDER if frame is not None and FRAMES[frame].order == QUAD_X_ORDER else None
    named = (frame or "").replace("_", " ")
    assembly.note(f"motors put in our order as ArduPilot's {named}" if order else "motors left in ArduPilot's order")
    if "RCOU" in collected:
        low, high = parameters.get("MOT_PWM_MIN", _PWM_LOW), parameters.get("MOT_PWM_MAX", _PWM_HIGH)
        channels = {
            int(parameters.get(f"SERVO{channel}_FUNCTION", 0)) - _MOTOR_1: channel - 1 for channel in range(1, 9)
        }
        motors = [channels[motor] for motor in range(8) if motor in channels]
        if motors:
            pulses = collected["RCOU"].table[:, motors]
            command = np.clip((pulses - low) / (high - low), 0.0, 1.0)
            time = assembly.seconds(np.array(collected["RCOU"].stamps), 1_000_000)
            assembly.add("rotor_command", time, in_our_order(command, order), "RCOU")
        else:
            assembly.note("no SERVOn_FUNCTION names the motors' outputs: RCOU is left out")
    if speeds and sorted(speeds) == list(range(len(speeds))):
        count = min(len(rows.stamps) for rows in speeds.values())
        time = assembly.seconds(np.array(speeds[0].stamps)[:count], 1_000_000)
        rpm = np.stack([speeds[esc].table[:count, 0] for esc in sorted(speeds)], axis=1)
        assembly.note("the ESCs report one after the other: their speeds share the first one's time stamps")
        assembly.add("rotor_speed", time, in_our_order(rpm * RPM, order), "ESC")
