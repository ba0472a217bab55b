"""The messages that the mock can send, by identifier: each is built from a snapshot."""

from __future__ import annotations

from collections.abc import Callable

from sitl_mock.wire import motion_messages, status_messages
from sitl_mock.wire.dialect import EscInfo, EscStatus, Message, ProtocolVersion, mavlink
from sitl_mock.wire.snapshot import Snapshot

ODOMETRY = mavlink.MAVLINK_MSG_ID_ODOMETRY

Built = Message | list[Message] | None
BUILDERS: dict[int, Callable[[Snapshot], Built]] = {
    mavlink.MAVLINK_MSG_ID_HEARTBEAT: status_messages.heartbeat,
    mavlink.MAVLINK_MSG_ID_ATTITUDE: motion_messages.attitude,
    mavlink.MAVLINK_MSG_ID_ATTITUDE_QUATERNION: motion_messages.attitude_quaternion,
    mavlink.MAVLINK_MSG_ID_ODOMETRY: motion_messages.odometry,
    mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED: motion_messages.local_position,
    mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: motion_messages.global_position,
    mavlink.MAVLINK_MSG_ID_GPS_RAW_INT: motion_messages.gps_raw,
    mavlink.MAVLINK_MSG_ID_HIGHRES_IMU: motion_messages.highres_imu,
    mavlink.MAVLINK_MSG_ID_ALTITUDE: motion_messages.altitude,
    mavlink.MAVLINK_MSG_ID_VFR_HUD: motion_messages.vfr_hud,
    mavlink.MAVLINK_MSG_ID_SERVO_OUTPUT_RAW: status_messages.servo_output_raw,
    mavlink.MAVLINK_MSG_ID_ACTUATOR_OUTPUT_STATUS: status_messages.actuator_output_status,
    EscStatus.id: status_messages.esc_status,
    EscInfo.id: status_messages.esc_info,
    mavlink.MAVLINK_MSG_ID_ATTITUDE_TARGET: motion_messages.attitude_target,
    mavlink.MAVLINK_MSG_ID_POSITION_TARGET_LOCAL_NED: motion_messages.position_target,
    mavlink.MAVLINK_MSG_ID_BATTERY_STATUS: status_messages.battery_status,
    mavlink.MAVLINK_MSG_ID_SYS_STATUS: status_messages.sys_status,
    mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: status_messages.extended_sys_state,
    mavlink.MAVLINK_MSG_ID_SYSTEM_TIME: status_messages.system_time,
    mavlink.MAVLINK_MSG_ID_ESTIMATOR_STATUS: status_messages.estimator_status,
    mavlink.MAVLINK_MSG_ID_HOME_POSITION: status_messages.home_position,
    mavlink.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN: status_messages.global_origin,
    mavlink.MAVLINK_MSG_ID_SCALED_PRESSURE: motion_messages.scaled_pressure,
    mavlink.MAVLINK_MSG_ID_VIBRATION: motion_messages.vibration,
    mavlink.MAVLINK_MSG_ID_TIMESYNC: status_messages.timesync_request,
    mavlink.MAVLINK_MSG_ID_PING: status_messages.ping,
    mavlink.MAVLINK_MSG_ID_MISSION_CURRENT: status_messages.mission_current,
    mavlink.MAVLINK_MSG_ID_DISTANCE_SENSOR: motion_messages.distance_sensor,
    mavlink.MAVLINK_MSG_ID_FLIGHT_INFORMATION: status_messages.flight_information,
    mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION: status_messages.autopilot_version,
    ProtocolVersion.id: status_messages.protocol_version,
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
