"""Telemetry besides the state estimate, as small frozen structs in SI units and our frames.

Every struct has `time`, when it held, and `received`, when its bytes arrived, both s on our monotonic clock.
"""

from __future__ import annotations

from collections.abc import Callable
from math import nan
from typing import Literal

import msgspec

from dynamics.units import RPM
from runtime.link.dialect import Message, mavlink

_UNKNOWN_VOLTAGE = 65535
_IMU_WINDOW = 0.005  # s over which PX4 averages a sample, which it stamps at the end (IMU_INTEG_RATE 200 Hz)

LandedState = Literal["undefined", "on_ground", "in_air", "taking_off", "landing"]
_LANDED: tuple[LandedState, ...] = ("undefined", "on_ground", "in_air", "taking_off", "landing")

LinkSeverity = Literal["info", "warning", "error"]
Vector = tuple[float, float, float]


class LinkEvent(msgspec.Struct, frozen=True):
    """An event of the link, by name. repeats: how often it was omitted since it was last published."""

    time: float
    name: str
    severity: LinkSeverity
    text: str
    repeats: int = 0


class VehicleStatus(msgspec.Struct, frozen=True):
    """The vehicle's identity and state, as of its latest heartbeat and status messages."""

    system: int = 0
    component: int = 0
    autopilot: str = "unknown"
    kind: str = "unknown"
    armed: bool = False
    mode: str = "unknown"
    main_mode: int = 0
    sub_mode: int = 0
    system_status: str = "unknown"
    landed: LandedState = "undefined"
    battery_voltage: float = nan
    last_heard: float = float("-inf")
    last_heartbeat: float = float("-inf")

    @property
    def is_known(self) -> bool:
        """Whether a vehicle has been heard."""
        return self.system != 0


class RotorSpeeds(msgspec.Struct, frozen=True, gc=False):
    """Rotor speeds from the ESCs, rad/s, in the autopilot's motor order, from motor `first` on."""

    time: float
    received: float
    first: int
    speed: tuple[float, ...]


class MotorOutputs(msgspec.Struct, frozen=True, gc=False):
    """Commands to the autopilot's outputs: PWM in us (SERVO_OUTPUT_RAW) or -1..1 (ACTUATOR_OUTPUT_STATUS)."""

    time: float
    received: float
    source: Literal["SERVO_OUTPUT_RAW", "ACTUATOR_OUTPUT_STATUS"]
    value: tuple[float, ...]


class ImuSample(msgspec.Struct, frozen=True, gc=False):
    """HIGHRES_IMU: specific force, m/s^2, and body rates, rad/s, both body FLU. time: the middle of its average."""

    time: float
    received: float
    specific_force_body: Vector
    rate_body: Vector


class BatterySample(msgspec.Struct, frozen=True, gc=False):
    """The battery: voltage, V, current, A, and remaining charge, 0..1; NaN where it is not measured."""

    time: float
    received: float
    voltage: float
    current: float
    remaining: float


class EstimatorSample(msgspec.Struct, frozen=True, gc=False):
    """ESTIMATOR_STATUS: the estimator's own opinion of itself.

    flags: ESTIMATOR_STATUS_FLAGS.
    ratios: innovation test ratios by name, of velocity, horizontal and vertical position, magnetometer; above 1 the
        measurements are rejected; NaN where they are not used.
    horizontal, vertical: standard deviations of the position, m.
    """

    time: float
    received: float
    flags: int
    ratios: tuple[tuple[str, float], ...]
    horizontal: float
    vertical: float


class HomeSample(msgspec.Struct, frozen=True, gc=False):
    """HOME_POSITION: the vehicle has a home to return to."""

    time: float
    received: float


class Text(msgspec.Struct, frozen=True):
    """A complete STATUSTEXT of the vehicle. severity: MAVLink's, 0 emergency to 7 debug."""

    received: float
    severity: int
    text: str


Telemetry = RotorSpeeds | MotorOutputs | ImuSample | BatterySample | EstimatorSample | HomeSample
ToOurs = Callable[[float, float], float]


def decode_telemetry(message: Message, received: float, to_ours: ToOurs) -> Telemetry | None:
    """The sample in a message, None for messages of other kinds.

    to_ours: (vehicle time since boot, time of reception) to our time, all s.
    """
    decode = _DECODERS.get(message.get_type())
    return decode(message, received, to_ours) if decode is not None else None


def _rotor_speeds(message: Message, received: float, to_ours: ToOurs) -> RotorSpeeds:
    speed = tuple(rpm * RPM for rpm in message.rpm)
    return RotorSpeeds(to_ours(message.time_usec * 1e-6, received), received, int(message.index), speed)


def _servo_outputs(message: Message, received: float, to_ours: ToOurs) -> MotorOutputs:
    value = tuple(float(getattr(message, f"servo{n}_raw")) for n in range(1, 9))
    return MotorOutputs(to_ours(message.time_usec * 1e-6, received), received, "SERVO_OUTPUT_RAW", value)


def _actuator_outputs(message: Message, received: float, to_ours: ToOurs) -> MotorOutputs:
    value = tuple(message.actuator[: max(4, int(message.active).bit_length())])
    return MotorOutputs(to_ours(message.time_usec * 1e-6, received), received, "ACTUATOR_OUTPUT_STATUS", value)


def _imu(message: Message, received: float, to_ours: ToOurs) -> ImuSample:
    return ImuSample(
        to_ours(message.time_usec * 1e-6, received) - _IMU_WINDOW / 2,
        received,
        (message.xacc, -message.yacc, -message.zacc),
        (message.xgyro, -message.ygyro, -message.zgyro),
    )


def _battery(message: Message, received: float, to_ours: ToOurs) -> BatterySample:
    cells = [v for v in (*message.voltages, *message.voltages_ext) if v not in (0, _UNKNOWN_VOLTAGE)]
    return BatterySample(
        received,
        received,
        sum(cells) * 1e-3 if cells else nan,
        message.current_battery * 1e-2 if message.current_battery >= 0 else nan,
        message.battery_remaining * 1e-2 if message.battery_remaining >= 0 else nan,
    )


def _system_battery(message: Message, received: float, to_ours: ToOurs) -> BatterySample:
    return BatterySample(
        received,
        received,
        message.voltage_battery * 1e-3 if message.voltage_battery not in (0, _UNKNOWN_VOLTAGE) else nan,
        message.current_battery * 1e-2 if message.current_battery >= 0 else nan,
        message.battery_remaining * 1e-2 if message.battery_remaining >= 0 else nan,
    )


def _estimator(message: Message, received: float, to_ours: ToOurs) -> EstimatorSample:
    ratios = {
        "velocity": message.vel_ratio,
        "horizontal position": message.pos_horiz_ratio,
        "height": message.pos_vert_ratio,
        "magnetometer": message.mag_ratio,
    }
    time = to_ours(message.time_usec * 1e-6, received)
    accuracy = (message.pos_horiz_accuracy, message.pos_vert_accuracy)
    return EstimatorSample(time, received, message.flags, tuple(ratios.items()), *accuracy)


def _home(message: Message, received: float, to_ours: ToOurs) -> HomeSample:
    return HomeSample(received, received)


_DECODERS: dict[str, Callable[[Message, float, ToOurs], Telemetry]] = {
    "ESC_STATUS": _rotor_speeds,
    "SERVO_OUTPUT_RAW": _servo_outputs,
    "ACTUATOR_OUTPUT_STATUS": _actuator_outputs,
    "HIGHRES_IMU": _imu,
    "BATTERY_STATUS": _battery,
    "SYS_STATUS": _system_battery,
    "ESTIMATOR_STATUS": _estimator,
    "HOME_POSITION": _home,
}


def landed_state(number: int) -> LandedState:
    """The name of a MAV_LANDED_STATE."""
    return _LANDED[number] if 0 <= number < len(_LANDED) else "undefined"


def enum_name(enum: str, number: int, prefix: str) -> str:
    """The lower-case name of a MAVLink enum's value without its prefix, or the number itself when it has none."""
    entry = mavlink.enums[enum].get(number)
    return str(entry.name.removeprefix(prefix).lower()) if entry is not None else str(number)
