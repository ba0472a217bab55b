"""One function per message about the vehicle's motion: the content that PX4 sends."""

from __future__ import annotations

import math

from sitl_mock.wire.dialect import Message, mavlink
from sitl_mock.wire.snapshot import (
    ORIGIN_ALTITUDE,
    PRESSURE_AT_SEA,
    SCALE_HEIGHT,
    Snapshot,
    latitude_longitude,
)

BODY_FRD, LOCAL_NED = 12, 1  # MAV_FRAME
POSE_COVARIANCE = [0.0] * 21
for _index, _variance in ((0, 0.0008), (6, 0.0008), (11, 0.0055), (15, 0.0004), (18, 0.0004), (20, 0.0045)):
    POSE_COVARIANCE[_index] = _variance
VELOCITY_COVARIANCE = [0.0] * 21
for _index, _variance in ((0, 0.0036), (6, 0.0035), (11, 0.0024)):
    VELOCITY_COVARIANCE[_index] = _variance
NO_ORIGIN_OFFSET = [0.0, 0.0, 0.0, 0.0]
LIDAR_RANGE = 10_000  # cm
ALL_BUT_AIRSPEED = 0x1BFF  # HIGHRES_IMU fields


def attitude(s: Snapshot) -> Message:
    """ATTITUDE: Euler angles and body rates, FRD in NED."""
    return mavlink.MAVLink_attitude_message(s.boot_ms, *s.motion.euler, *s.motion.rate)


def attitude_quaternion(s: Snapshot) -> Message:
    """ATTITUDE_QUATERNION, continuous in sign."""
    return mavlink.MAVLink_attitude_quaternion_message(s.boot_ms, *s.motion.attitude, *s.motion.rate, NO_ORIGIN_OFFSET)


def odometry(s: Snapshot) -> Message:
    """ODOMETRY; the velocity is NED or, with the option, body FRD, see child_frame_id."""
    velocity = _in_body(s.motion.attitude, s.motion.velocity) if s.status.child_frame == BODY_FRD else s.motion.velocity
    return mavlink.MAVLink_odometry_message(
        s.estimate_us,
        LOCAL_NED,
        s.status.child_frame,
        *s.motion.position,
        s.motion.attitude,
        *velocity,
        *s.motion.rate,
        POSE_COVARIANCE,
        VELOCITY_COVARIANCE,
        s.reset_counter,
        8,
        0,
    )


def _in_body(attitude: list[float], vector: list[float]) -> list[float]:
    w, x, y, z = attitude
    a, b, c = vector
    # v + 2 r x (r x v) - 2 w (r x v), with r the vector part
    s, t, u = 2 * (y * c - z * b), 2 * (z * a - x * c), 2 * (x * b - y * a)
    return [a - w * s + y * u - z * t, b - w * t + z * s - x * u, c - w * u + x * t - y * s]


def local_position(s: Snapshot) -> Message:
    """LOCAL_POSITION_NED."""
    return mavlink.MAVLink_local_position_ned_message(s.boot_ms, *s.motion.position, *s.motion.velocity)


def global_position(s: Snapshot) -> Message:
    """GLOBAL_POSITION_INT: degrees, millimetres, centimetres per second."""
    down, home_down = s.motion.position[2], s.status.home[2]
    return mavlink.MAVLink_global_position_int_message(
        s.boot_ms,
        *latitude_longitude(s.motion.position),
        round((ORIGIN_ALTITUDE - down) * 1e3),
        round((home_down - down) * 1e3),
        *(max(-32768, min(32767, round(speed * 100))) for speed in s.motion.velocity),
        _heading(s),
    )


def _heading(s: Snapshot) -> int:
    return round(math.degrees(s.motion.euler[2]) % 360.0 * 100) % 36000


def gps_raw(s: Snapshot) -> Message:
    """GPS_RAW_INT: a 3D fix."""
    north, east = s.motion.velocity[:2]
    altitude = round((ORIGIN_ALTITUDE - s.motion.position[2]) * 1e3)
    speed = min(round(math.hypot(north, east) * 100), 65534)
    course = round(math.degrees(math.atan2(east, north)) % 360.0 * 100) % 36000
    return mavlink.MAVLink_gps_raw_int_message(
        s.estimate_us,
        3,
        *latitude_longitude(s.motion.position),
        altitude,
        70,
        110,
        speed,
        course,
        10,
        altitude,
        900,
        1780,
        400,
        0,
        0,
    )


def highres_imu(s: Snapshot) -> Message:
    """HIGHRES_IMU: specific force and rates in FRD, and the pressure at this height."""
    time_usec, force, gyro = s.imu
    altitude = ORIGIN_ALTITUDE - s.motion.position[2]
    pressure = PRESSURE_AT_SEA * math.exp(-altitude / SCALE_HEIGHT)
    field = _in_body(s.motion.attitude, [0.21, 0.01, 0.43])  # gauss, north-east-down near the origin
    return mavlink.MAVLink_highres_imu_message(
        time_usec, *force, *gyro, *field, pressure, 0.0, altitude, 15.0, ALL_BUT_AIRSPEED, 0
    )


def altitude(s: Snapshot) -> Message:
    """ALTITUDE: metres."""
    down, home_down = s.motion.position[2], s.status.home[2]
    above_sea, above_home = ORIGIN_ALTITUDE - down, home_down - down
    return mavlink.MAVLink_altitude_message(s.now_us, above_sea, above_sea, -down, above_home, 0.0, above_home)


def vfr_hud(s: Snapshot) -> Message:
    """VFR_HUD: what a pilot's display shows."""
    north, east, down = s.motion.velocity
    throttle = round(100 * min(max(s.setpoint.thrust, 0.0), 1.0))
    return mavlink.MAVLink_vfr_hud_message(
        math.nan, math.hypot(north, east), _heading(s) // 100, throttle, ORIGIN_ALTITUDE - s.motion.position[2], -down
    )


def attitude_target(s: Snapshot) -> Message:
    """ATTITUDE_TARGET: what the inner loops follow."""
    return mavlink.MAVLink_attitude_target_message(
        s.boot_ms, 0, s.setpoint.attitude, *s.setpoint.rate, s.setpoint.thrust
    )


def position_target(s: Snapshot) -> Message | None:
    """POSITION_TARGET_LOCAL_NED: where a position mode flies to; none otherwise."""
    if s.target_position is None:
        return None
    nothing = [0.0] * 6
    return mavlink.MAVLink_position_target_local_ned_message(
        s.boot_ms, LOCAL_NED, 0, *s.target_position, *nothing, s.motion.euler[2], 0.0
    )


def scaled_pressure(s: Snapshot) -> Message:
    """SCALED_PRESSURE: hPa at this height."""
    pressure = PRESSURE_AT_SEA * math.exp(-(ORIGIN_ALTITUDE - s.motion.position[2]) / SCALE_HEIGHT)
    return mavlink.MAVLink_scaled_pressure_message(int(s.now * 1e3) & 0xFFFFFFFF, pressure, 0.0, 1500)


def vibration(s: Snapshot) -> Message:
    """VIBRATION: almost none."""
    return mavlink.MAVLink_vibration_message(s.now_us, 0.0, 0.01, 0.1, 0, 0, 0)


def distance_sensor(s: Snapshot) -> Message:
    """DISTANCE_SENSOR: a lidar that looks down, cm."""
    height = s.status.home[2] - s.motion.position[2]
    distance = max(0, min(LIDAR_RANGE, round(height * 100)))
    return mavlink.MAVLink_distance_sensor_message(s.now_us // 1000 & 0xFFFFFFFF, 0, LIDAR_RANGE, distance, 0, 0, 25, 0)
