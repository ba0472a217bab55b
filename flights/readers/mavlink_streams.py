"""MAVLink messages of a flight as streams: NED and FRD become ENU and FLU, every stamp the vehicle's own time."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from pymavlink.dialects.v20 import development as mavlink

from dynamics import frames, quaternion
from dynamics.arrays import Floats
from dynamics.units import RPM
from flights.assembly import Assembly
from flights.movement import moving_columns
from flights.readers.px4_rotors import QUAD_X, QUADROTOR, add_servo_outputs, in_our_order, join_groups

# Upstream's ESC_STATUS, which pymavlink's definitions lack: payload as it travels, and its CRC_EXTRA.
ESC_STATUS = np.dtype(
    [("time_usec", "<u8"), ("rpm", "<i4", (4,)), ("voltage", "<f4", (4,)), ("current", "<f4", (4,)), ("index", "u1")]
)
ESC_STATUS_EXTRA = 10
_ESC_STATUS_ID = 291

_SLICE = 5.0  # s over which the message with the least delay gives the clocks' offset
_IGNORE_ATTITUDE, _IGNORE_THRUST, _IGNORE_ROLL_PITCH_YAW_RATE = 128, 64, 7
_IGNORE_POSITION, _IGNORE_VELOCITY = 7, 56


@dataclass(frozen=True)
class Received:
    """All messages of one kind.

    time: (n,) s of the vehicle's clock.
    fields: (n,) structured.
    """

    time: Floats
    fields: NDArray[np.void]

    def __getitem__(self, name: str) -> Floats:
        return np.asarray(self.fields[name], dtype=float)

    def stack(self, *names: str) -> Floats:
        """(n, k) of several fields."""
        return np.stack([self[name] for name in names], axis=1)


Arrived = Mapping[int, tuple[NDArray[np.int64], NDArray[np.void]]]
_STAMPS = (("time_usec", 1), ("time_boot_ms", 1000))  # field, microseconds of one tick


def add_streams(assembly: Assembly, arrived: Arrived) -> None:
    """Add the streams of a flight's messages. arrived: message number to arrivals, unix us, and fields."""
    clock = _VehicleClock(arrived)
    if not clock.is_known:
        assembly.note("no message has the vehicle's time: times are those of arrival")
    for number, convert in _CONVERTERS.items():
        if number in arrived:
            convert(assembly, Received(clock.times(number, *arrived[number]), arrived[number][1]))


class _VehicleClock:
    """The vehicle's time of messages; of those without a stamp by their arrival and the minimum delay around it."""

    def __init__(self, arrived: Arrived) -> None:
        references = [
            (arrival, stamps)
            for number, (arrival, fields) in arrived.items()
            if number in _CLOCK_SOURCES and (stamps := _stamps(fields)) is not None and (stamps > 0).any()
        ]
        self.is_known = bool(references)
        if not references:
            return
        arrival, stamps = max(references, key=lambda pair: len(pair[0]))
        self._start = int(arrival[0])
        since = (arrival - self._start) * 1e-6
        offset = arrival - stamps
        slices = (since // _SLICE).astype(int)
        filled = np.unique(slices)
        self._at = (filled + 0.5) * _SLICE
        self._offset = np.array([int(offset[slices == index].min()) for index in filled], dtype=np.int64)

    def times(self, number: int, arrival: NDArray[np.int64], fields: NDArray[np.void]) -> Floats:
        """Seconds of the vehicle's clock."""
        if not self.is_known:
            return np.asarray(arrival * 1e-6)
        base = self._offset[0]
        drift = np.interp((arrival - self._start) * 1e-6, self._at, (self._offset - base).astype(float))
        by_arrival = (arrival - base - drift) * 1e-6
        stamps = _stamps(fields) if number not in SENT_TO_VEHICLE else None
        if stamps is None:
            return np.asarray(by_arrival)
        by_stamp = stamps * 1e-6
        plausible = np.abs(by_stamp - by_arrival) < 60.0  # else the stamp is of another clock
        return np.asarray(by_stamp if plausible.all() else by_arrival)


def _stamps(fields: NDArray[np.void]) -> NDArray[np.int64] | None:
    """The vehicle's stamps, us, unwrapped where they are 32 bits wide; None for messages without any."""
    for name, ticks in _STAMPS:
        if name in (fields.dtype.names or ()):
            stamps = fields[name].astype(np.int64)
            if fields.dtype[name].itemsize == 4:
                wraps = np.cumsum(np.diff(stamps, prepend=stamps[:1]) < -(1 << 31))
                stamps = stamps + (wraps << 32)
            return np.asarray(stamps * ticks)
    return None


def _odometry(assembly: Assembly, rows: Received) -> None:
    supported = rows["frame_id"] == mavlink.MAV_FRAME_LOCAL_NED
    child = rows["child_frame_id"]
    in_world, in_body = child == mavlink.MAV_FRAME_LOCAL_NED, child == mavlink.MAV_FRAME_BODY_FRD
    if not (supported & (in_world | in_body)).all():
        count = np.count_nonzero(~(supported & (in_world | in_body)))
        assembly.repair("unknown_frame", f"{count} ODOMETRY messages in frames other than NED and FRD dropped")
        keep = supported & (in_world | in_body)
        rows, in_body = Received(rows.time[keep], rows.fields[keep]), in_body[keep]
    attitude = frames.attitude_enu_flu(rows["q"])
    velocity_sent = rows.stack("vx", "vy", "vz")
    velocity = frames.enu_from_ned(velocity_sent)
    if in_body.any():
        velocity = np.where(in_body[:, None], quaternion.rotate(attitude, frames.flu_from_frd(velocity_sent)), velocity)
    assembly.add("position", rows.time, frames.enu_from_ned(rows.stack("x", "y", "z")), "ODOMETRY")
    assembly.add("velocity", rows.time, velocity, "ODOMETRY")
    assembly.add("attitude", rows.time, attitude, "ODOMETRY")
    rate = frames.flu_from_frd(rows.stack("rollspeed", "pitchspeed", "yawspeed"))
    assembly.add("rate", rows.time, rate, "ODOMETRY")
    assembly.add("reset_counter", rows.time, rows["reset_counter"], "ODOMETRY")


def _local_position(assembly: Assembly, rows: Received) -> None:
    assembly.add("position", rows.time, frames.enu_from_ned(rows.stack("x", "y", "z")), "LOCAL_POSITION_NED")
    assembly.add("velocity", rows.time, frames.enu_from_ned(rows.stack("vx", "vy", "vz")), "LOCAL_POSITION_NED")


def _attitude_quaternion(assembly: Assembly, rows: Received) -> None:
    attitude = frames.attitude_enu_flu(rows.stack("q1", "q2", "q3", "q4"))
    assembly.add("attitude", rows.time, attitude, "ATTITUDE_QUATERNION")
    rate = frames.flu_from_frd(rows.stack("rollspeed", "pitchspeed", "yawspeed"))
    assembly.add("rate", rows.time, rate, "ATTITUDE_QUATERNION")


def _attitude(assembly: Assembly, rows: Received) -> None:
    attitude = frames.attitude_enu_flu(quaternion.from_euler(rows["roll"], rows["pitch"], rows["yaw"]))
    assembly.add("attitude", rows.time, attitude, "ATTITUDE")
    rate = frames.flu_from_frd(rows.stack("rollspeed", "pitchspeed", "yawspeed"))
    assembly.add("rate", rows.time, rate, "ATTITUDE")


def _highres_imu(assembly: Assembly, rows: Received) -> None:
    force = frames.flu_from_frd(rows.stack("xacc", "yacc", "zacc"))
    assembly.add("specific_force", rows.time, force, "HIGHRES_IMU")
    assembly.add("rate", rows.time, frames.flu_from_frd(rows.stack("xgyro", "ygyro", "zgyro")), "HIGHRES_IMU")


def _servo_output(assembly: Assembly, rows: Received) -> None:
    """Outputs of the first port whose outputs move. The message has one port's at a time."""
    ports = np.unique(rows["port"]) if "port" in (rows.fields.dtype.names or ()) else np.zeros(1)
    names = [name for n in range(1, 17) if (name := f"servo{n}_raw") in (rows.fields.dtype.names or ())]
    parts = [Received(rows.time[own], rows.fields[own]) for port in ports if (own := _of_port(rows, port)).any()]
    moving = [part for part in parts if moving_columns(part.stack(*names))]
    used = (moving or parts)[0]
    add_servo_outputs(assembly, used.time, used.stack(*names), "SERVO_OUTPUT_RAW")
    for part in parts:
        if part is not used:
            fields = [f"output[{column}]" for column in range(len(names))]
            reason = "the motors are read from another port"
            assembly.leave_out("rotor_command", "SERVO_OUTPUT_RAW", fields, part.stack(*names), reason)


def _of_port(rows: Received, port: float) -> NDArray[np.bool_]:
    if "port" not in (rows.fields.dtype.names or ()):
        return np.ones(len(rows.time), dtype=bool)
    return np.asarray(rows["port"] == port)


def _esc_status(assembly: Assembly, rows: Received) -> None:
    time, rpm = join_groups(rows.time, rows["index"], np.abs(rows["rpm"]))
    if not np.any(rpm):
        fields = [f"rpm[{column}]" for column in range(rpm.shape[1])]
        assembly.leave_out("rotor_speed", "ESC_STATUS", fields, rpm, "no ESC ever turns")
        assembly.note("ESC_STATUS: no ESC ever turns, so its speeds are left out")
        return
    order = QUAD_X if rpm.shape[1] == len(QUAD_X) else None
    assembly.infer(
        "rotor speeds are ESC_STATUS's, taken for rpm of the rotor, ESC n taken for motor n"
        + (" and put in our order as PX4's quad x" if order else f", {rpm.shape[1]} motors left in their order")
    )
    assembly.add("rotor_speed", time, in_our_order(rpm * RPM, order), "ESC_STATUS")


def _sys_status(assembly: Assembly, rows: Received) -> None:
    voltage = rows["voltage_battery"]
    assembly.add("battery_voltage", rows.time, np.where(voltage == 65_535, np.nan, voltage * 1e-3), "SYS_STATUS")
    current = rows["current_battery"]
    assembly.add("battery_current", rows.time, np.where(current < 0, np.nan, current * 1e-2), "SYS_STATUS")


def _heartbeat(assembly: Assembly, rows: Received) -> None:
    armed = (rows.fields["base_mode"] & mavlink.MAV_MODE_FLAG_SAFETY_ARMED) != 0
    assembly.add("armed", rows.time, armed, "HEARTBEAT")
    kind = int(rows.fields["type"][0])
    assembly.metadata["vehicle_type"] = str(kind)
    if kind != QUADROTOR:
        assembly.note(f"the vehicle is of MAV_TYPE {kind}, no quadrotor: its rotors are in no order of ours")


def _extended_state(assembly: Assembly, rows: Received) -> None:
    state = rows["landed_state"]
    landed = np.where(state == 0, np.nan, state == mavlink.MAV_LANDED_STATE_ON_GROUND)
    assembly.add("landed", rows.time, landed, "EXTENDED_SYS_STATE")


def _attitude_target(source: str) -> Callable[[Assembly, Received], None]:
    def convert(assembly: Assembly, rows: Received) -> None:
        mask = rows.fields["type_mask"].astype(int)
        attitude = np.where((mask & _IGNORE_ATTITUDE)[:, None] != 0, np.nan, frames.attitude_enu_flu(rows["q"]))
        rate = frames.flu_from_frd(rows.stack("body_roll_rate", "body_pitch_rate", "body_yaw_rate"))
        rate = np.where((mask & _IGNORE_ROLL_PITCH_YAW_RATE)[:, None] != 0, np.nan, rate)
        thrust = np.where((mask & _IGNORE_THRUST) != 0, np.nan, rows["thrust"])
        assembly.add("attitude_setpoint", rows.time, attitude, source)
        assembly.add("rate_setpoint", rows.time, rate, source)
        assembly.add("thrust_setpoint", rows.time, thrust, source)

    return convert


def _position_target(source: str) -> Callable[[Assembly, Received], None]:
    def convert(assembly: Assembly, rows: Received) -> None:
        mask = rows.fields["type_mask"].astype(int)
        position = frames.enu_from_ned(rows.stack("x", "y", "z"))
        velocity = frames.enu_from_ned(rows.stack("vx", "vy", "vz"))
        no_position, no_velocity = (mask & _IGNORE_POSITION) != 0, (mask & _IGNORE_VELOCITY) != 0
        assembly.add("position_setpoint", rows.time, np.where(no_position[:, None], np.nan, position), source)
        assembly.add("velocity_setpoint", rows.time, np.where(no_velocity[:, None], np.nan, velocity), source)

    return convert


# Of several messages for one quantity the first is used.
_CONVERTERS: Mapping[int, Callable[[Assembly, Received], None]] = {
    mavlink.MAVLINK_MSG_ID_ODOMETRY: _odometry,
    mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED: _local_position,
    mavlink.MAVLINK_MSG_ID_ATTITUDE_QUATERNION: _attitude_quaternion,
    mavlink.MAVLINK_MSG_ID_ATTITUDE: _attitude,
    mavlink.MAVLINK_MSG_ID_HIGHRES_IMU: _highres_imu,
    _ESC_STATUS_ID: _esc_status,
    mavlink.MAVLINK_MSG_ID_SERVO_OUTPUT_RAW: _servo_output,
    mavlink.MAVLINK_MSG_ID_SYS_STATUS: _sys_status,
    mavlink.MAVLINK_MSG_ID_HEARTBEAT: _heartbeat,
    mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: _extended_state,
    mavlink.MAVLINK_MSG_ID_ATTITUDE_TARGET: _attitude_target("ATTITUDE_TARGET"),
    mavlink.MAVLINK_MSG_ID_SET_ATTITUDE_TARGET: _attitude_target("SET_ATTITUDE_TARGET"),
    mavlink.MAVLINK_MSG_ID_POSITION_TARGET_LOCAL_NED: _position_target("POSITION_TARGET_LOCAL_NED"),
}
NUMBERS = tuple(_CONVERTERS)
SENT_TO_VEHICLE = frozenset({mavlink.MAVLINK_MSG_ID_SET_ATTITUDE_TARGET})
_CLOCK_SOURCES = frozenset(
    {
        mavlink.MAVLINK_MSG_ID_ODOMETRY,
        mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED,
        mavlink.MAVLINK_MSG_ID_ATTITUDE_QUATERNION,
        mavlink.MAVLINK_MSG_ID_ATTITUDE,
    }
)
