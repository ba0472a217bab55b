"""One function per message that the mock streams: what PX4 puts into it, from a snapshot."""

from __future__ import annotations

import math
from collections.abc import Callable

from sitl_mock.wire.dialect import EscInfo, EscStatus, Message, ProtocolVersion, mavlink
from sitl_mock.wire.snapshot import (
    ALSO_HEALTHY,
    ORIGIN_ALTITUDE,
    PREARM_CHECK,
    PRESSURE_AT_SEA,
    RADIO,
    SCALE_HEIGHT,
    SENSORS,
    Snapshot,
    latitude_longitude,
)

BODY_FRD, LOCAL_NED = 12, 1
ODOMETRY = mavlink.MAVLINK_MSG_ID_ODOMETRY
AUTOPILOT_PX4 = 12
POSE_COVARIANCE = [0.0] * 21
for _index, _variance in ((0, 0.0008), (6, 0.0008), (11, 0.0055), (15, 0.0004), (18, 0.0004), (20, 0.0045)):
    POSE_COVARIANCE[_index] = _variance
VELOCITY_COVARIANCE = [0.0] * 21
for _index, _variance in ((0, 0.0036), (6, 0.0035), (11, 0.0024)):
    VELOCITY_COVARIANCE[_index] = _variance
NO_ORIGIN_OFFSET = [0.0, 0.0, 0.0, 0.0]
NO_CELL, NO_MISSION = 0xFFFF, 0xFFFF
LIDAR_RANGE = 10_000  # cm
ALL_BUT_AIRSPEED = 0x1BFF  # HIGHRES_IMU fields
DISARMED_PWM, PWM_MIN, PWM_RANGE = 900, 1000, 1000
RPM_PER_RADIAN = 60.0 / (2 * math.pi)


def heartbeat(s: Snapshot) -> Message:
    """HEARTBEAT: type, mode, state."""
    return mavlink.MAVLink_heartbeat_message(
        s.status.vehicle_type,
        AUTOPILOT_PX4,
        s.status.base_mode,
        s.status.custom_mode,
        s.status.system_status,
        3,
    )


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
        s.estimate_us, 3, *latitude_longitude(s.motion.position), altitude, 70, 110, speed, course, 10,
        altitude, 900, 1780, 400, 0, 0,
    )  # fmt: skip


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


def servo_output_raw(s: Snapshot) -> Message:
    """SERVO_OUTPUT_RAW: pulse widths, us, in PX4's motor order; 900 while disarmed."""
    pulses = [PWM_MIN + round(PWM_RANGE * min(max(signal, 0.0), 1.0)) for signal in s.motor_signal]
    pulses = pulses if s.status.base_mode & 128 else [DISARMED_PWM] * len(pulses)
    pulses = [*pulses[:16], *[DISARMED_PWM] * (16 - len(pulses))]
    return mavlink.MAVLink_servo_output_raw_message(s.now_us & 0xFFFFFFFF, 0, *pulses)


def actuator_output_status(s: Snapshot) -> Message:
    """ACTUATOR_OUTPUT_STATUS: motor signals 0..1 in PX4's motor order."""
    outputs = [*s.motor_signal[:32], *[0.0] * (32 - len(s.motor_signal))]
    return mavlink.MAVLink_actuator_output_status_message(s.now_us, len(s.motor_signal), outputs)


def esc_status(s: Snapshot) -> list[Message]:
    """ESC_STATUS: rotor speeds in rpm in PX4's motor order, four rotors to a message."""
    rpm = [round(speed * RPM_PER_RADIAN) for speed in s.rotor_speed]
    share = s.battery.current / max(len(rpm), 1)
    return [
        EscStatus(first, s.now_us, rpm[first : first + 4], [s.battery.voltage] * len(rpm[first : first + 4]),
                  [share] * len(rpm[first : first + 4]))
        for first in range(0, len(rpm), 4)
    ]  # fmt: skip


def esc_info(s: Snapshot) -> list[Message]:
    """ESC_INFO: all speed controllers online."""
    count = len(s.rotor_speed)
    return [EscInfo(first, s.now_us, int(s.now) & 0xFFFF, count) for first in range(0, count, 4)]


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


def battery_status(s: Snapshot) -> Message:
    """BATTERY_STATUS: voltage in mV, current in cA, charge in %."""
    return mavlink.MAVLink_battery_status_message(
        0, 1, 1, 32767, [_millivolts(s), *[NO_CELL] * 9], round(s.battery.current * 100), -1, -1, _percent(s), 0, 1
    )


def _millivolts(s: Snapshot) -> int:
    return max(0, min(65534, round(s.battery.voltage * 1e3)))


def _percent(s: Snapshot) -> int:
    return max(0, min(100, round(s.battery.remaining * 100)))


def sys_status(s: Snapshot) -> Message:
    """SYS_STATUS: sensors' health and the battery; the pre-arm bit is set while arming would be allowed."""
    healthy = (SENSORS if s.estimate_valid else SENSORS & ~1) | ALSO_HEALTHY
    healthy |= PREARM_CHECK if s.status.armable else 0
    return mavlink.MAVLink_sys_status_message(
        SENSORS, SENSORS | RADIO, healthy, 140, _millivolts(s), round(s.battery.current * 100), _percent(s),
        0, 0, 0, 0, 0, 0, 0, 0, 1,
    )  # fmt: skip


def extended_sys_state(s: Snapshot) -> Message:
    """EXTENDED_SYS_STATE: on the ground, in the air, taking off or landing."""
    return mavlink.MAVLink_extended_sys_state_message(0, s.status.landed_state)


def system_time(s: Snapshot) -> Message:
    """SYSTEM_TIME: unix time and time since boot."""
    return mavlink.MAVLink_system_time_message(int((s.status.epoch + s.now) * 1e6), int(s.now * 1e3) & 0xFFFFFFFF)


def estimator_status(s: Snapshot) -> Message:
    """ESTIMATOR_STATUS: everything observed, or nothing."""
    flags = 0b1101111111 if s.estimate_valid else 0
    return mavlink.MAVLink_estimator_status_message(s.now_us, flags, 0.05, 0.05, 0.02, 0.05, 0.02, math.nan, 0.15, 0.05)


def home_position(s: Snapshot) -> Message:
    """HOME_POSITION."""
    home = s.status.home
    altitude, level, approach = round((ORIGIN_ALTITUDE - home[2]) * 1e3), [1.0, 0.0, 0.0, 0.0], [0.0] * 3
    return mavlink.MAVLink_home_position_message(*latitude_longitude(home), altitude, *home, level, *approach, s.now_us)


def global_origin(s: Snapshot) -> Message:
    """GPS_GLOBAL_ORIGIN: where the local frame stands."""
    return mavlink.MAVLink_gps_global_origin_message(
        *latitude_longitude([0.0, 0.0]), round(ORIGIN_ALTITUDE * 1e3), s.now_us
    )


def scaled_pressure(s: Snapshot) -> Message:
    """SCALED_PRESSURE: hPa at this height."""
    pressure = PRESSURE_AT_SEA * math.exp(-(ORIGIN_ALTITUDE - s.motion.position[2]) / SCALE_HEIGHT)
    return mavlink.MAVLink_scaled_pressure_message(int(s.now * 1e3) & 0xFFFFFFFF, pressure, 0.0, 1500)


def vibration(s: Snapshot) -> Message:
    """VIBRATION: almost none."""
    return mavlink.MAVLink_vibration_message(s.now_us, 0.0, 0.01, 0.1, 0, 0, 0)


def timesync_request(s: Snapshot) -> Message:
    """TIMESYNC as PX4 requests it of its companions: tc1 0, ts1 the vehicle's ns."""
    return mavlink.MAVLink_timesync_message(0, int(s.now * 1e9))


def autopilot_version(s: Snapshot) -> Message:
    """AUTOPILOT_VERSION: PX4 1.17 and what it can do over this link."""
    capabilities = 2 | 4 | 8 | 16 | 64 | 128 | 2048 | 8192  # params bytewise, mission and command int, setpoints
    version = 1 << 24 | 17 << 16 | 0 << 8 | 255
    no_revision = [0] * 8
    return mavlink.MAVLink_autopilot_version_message(
        capabilities,
        version,
        version,
        0,
        0,
        no_revision,
        no_revision,
        no_revision,
        0x26AC,
        0x10,
        0x416C756C61,
        [0] * 18,
    )


def flight_information(s: Snapshot) -> Message:
    """FLIGHT_INFORMATION: without times of take-off and landing."""
    return mavlink.MAVLink_flight_information_message(int(s.now * 1e3) & 0xFFFFFFFF, 0, 0, 0)


def ping(s: Snapshot) -> Message:
    """PING as PX4 sends it to everyone, once a second."""
    return mavlink.MAVLink_ping_message(s.now_us, int(s.now) & 0xFFFFFFFF, 0, 0)


def mission_current(_: Snapshot) -> Message:
    """MISSION_CURRENT: there is no mission, and none is flown."""
    return mavlink.MAVLink_mission_current_message(0, NO_MISSION, 1, 2)


def distance_sensor(s: Snapshot) -> Message:
    """DISTANCE_SENSOR: a lidar that looks down, cm."""
    height = s.status.home[2] - s.motion.position[2]
    distance = max(0, min(LIDAR_RANGE, round(height * 100)))
    return mavlink.MAVLink_distance_sensor_message(s.now_us // 1000 & 0xFFFFFFFF, 0, LIDAR_RANGE, distance, 0, 0, 25, 0)


def protocol_version(_: Snapshot) -> Message:
    """PROTOCOL_VERSION."""
    return ProtocolVersion()


Built = Message | list[Message] | None
BUILDERS: dict[int, Callable[[Snapshot], Built]] = {
    mavlink.MAVLINK_MSG_ID_HEARTBEAT: heartbeat,
    mavlink.MAVLINK_MSG_ID_ATTITUDE: attitude,
    mavlink.MAVLINK_MSG_ID_ATTITUDE_QUATERNION: attitude_quaternion,
    mavlink.MAVLINK_MSG_ID_ODOMETRY: odometry,
    mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED: local_position,
    mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: global_position,
    mavlink.MAVLINK_MSG_ID_GPS_RAW_INT: gps_raw,
    mavlink.MAVLINK_MSG_ID_HIGHRES_IMU: highres_imu,
    mavlink.MAVLINK_MSG_ID_ALTITUDE: altitude,
    mavlink.MAVLINK_MSG_ID_VFR_HUD: vfr_hud,
    mavlink.MAVLINK_MSG_ID_SERVO_OUTPUT_RAW: servo_output_raw,
    mavlink.MAVLINK_MSG_ID_ACTUATOR_OUTPUT_STATUS: actuator_output_status,
    EscStatus.id: esc_status,
    EscInfo.id: esc_info,
    mavlink.MAVLINK_MSG_ID_ATTITUDE_TARGET: attitude_target,
    mavlink.MAVLINK_MSG_ID_POSITION_TARGET_LOCAL_NED: position_target,
    mavlink.MAVLINK_MSG_ID_BATTERY_STATUS: battery_status,
    mavlink.MAVLINK_MSG_ID_SYS_STATUS: sys_status,
    mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: extended_sys_state,
    mavlink.MAVLINK_MSG_ID_SYSTEM_TIME: system_time,
    mavlink.MAVLINK_MSG_ID_ESTIMATOR_STATUS: estimator_status,
    mavlink.MAVLINK_MSG_ID_HOME_POSITION: home_position,
    mavlink.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN: global_origin,
    mavlink.MAVLINK_MSG_ID_SCALED_PRESSURE: scaled_pressure,
    mavlink.MAVLINK_MSG_ID_VIBRATION: vibration,
    mavlink.MAVLINK_MSG_ID_TIMESYNC: timesync_request,
    mavlink.MAVLINK_MSG_ID_PING: ping,
    mavlink.MAVLINK_MSG_ID_MISSION_CURRENT: mission_current,
    mavlink.MAVLINK_MSG_ID_DISTANCE_SENSOR: distance_sensor,
    mavlink.MAVLINK_MSG_ID_FLIGHT_INFORMATION: flight_information,
    mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION: autopilot_version,
    ProtocolVersion.id: protocol_version,
}
# messages that an estimator that has stopped no longer sends
OF_THE_ESTIMATE = frozenset(
    {
        mavlink.MAVLINK_MSG_ID_ATTITUDE,
        mavlink.MAVLINK_MSG_ID_ATTITUDE_QUATERNION,
        mavlink.MAVLINK_MSG_ID_ODOMETRY,
        mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED,
        mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT,
    }
)


def build(identifier: int, snapshot: Snapshot) -> list[Message]:
    """The messages that a stream sends now: none when it has no content or a number does not fit its field."""
    try:
        built = BUILDERS[identifier](snapshot)
    except (ValueError, OverflowError):
        return []  # NaN has no heading and no degrees; PX4 too leaves such fields' messages out
    if built is None:
        return []
    return built if isinstance(built, list) else [built]
