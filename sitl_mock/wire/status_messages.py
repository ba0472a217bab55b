"""One function per message about the vehicle's state, power and identity: the content that PX4 sends."""

from __future__ import annotations

import math

from sitl_mock.wire.dialect import EscInfo, EscStatus, Message, ProtocolVersion, mavlink
from sitl_mock.wire.snapshot import (
    ALSO_HEALTHY,
    ORIGIN_ALTITUDE,
    PREARM_CHECK,
    RADIO,
    SENSORS,
    Snapshot,
    latitude_longitude,
)

AUTOPILOT_PX4 = 12
NO_CELL, NO_MISSION = 0xFFFF, 0xFFFF
DISARMED_PWM, PWM_MIN, PWM_RANGE = 900, 1000, 1000
# ESTIMATOR_STATUS flags
HORIZONTAL = 2 | 8 | 16 | 256 | 512  # velocity, relative and absolute position, their predictions
CONSTANT_POSITION = 128
GNSS_GLITCH = 1024
EVERYTHING = 0b1111111111 & ~CONSTANT_POSITION
CONSTANT_POSITION_UNTIL = 9.0  # s since boot
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
        EscStatus(
            first,
            s.now_us,
            rpm[first : first + 4],
            [s.battery.voltage] * len(rpm[first : first + 4]),
            [share] * len(rpm[first : first + 4]),
        )
        for first in range(0, len(rpm), 4)
    ]


def esc_info(s: Snapshot) -> list[Message]:
    """ESC_INFO: all speed controllers online."""
    count = len(s.rotor_speed)
    return [EscInfo(first, s.now_us, int(s.now) & 0xFFFF, count) for first in range(0, count, 4)]


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
        SENSORS,
        SENSORS | RADIO,
        healthy,
        140,
        _millivolts(s),
        round(s.battery.current * 100),
        _percent(s),
        0,
        0,
        0,
        0,
        0,
        0,
        0,
        0,
        1,
    )


def extended_sys_state(s: Snapshot) -> Message:
    """EXTENDED_SYS_STATE: on the ground, in the air, taking off or landing."""
    return mavlink.MAVLink_extended_sys_state_message(0, s.status.landed_state)


def system_time(s: Snapshot) -> Message:
    """SYSTEM_TIME: unix time and time since boot."""
    return mavlink.MAVLink_system_time_message(int((s.status.epoch + s.now) * 1e6), int(s.now * 1e3) & 0xFFFFFFFF)


def estimator_status(s: Snapshot) -> Message:
    """ESTIMATOR_STATUS: everything observed, without horizontal aiding all but that, or nothing.

    Test ratios and accuracies as recorded; an estimator that has just started reports a constant position as well.
    """
    flags = EVERYTHING if s.position_valid else EVERYTHING & ~HORIZONTAL
    flags |= CONSTANT_POSITION if s.now < CONSTANT_POSITION_UNTIL else 0
    flags |= GNSS_GLITCH if s.gnss_glitch else 0
    ratios = (0.04, 0.035, 0.02, 0.07, 0.005, math.nan)
    accuracy = 0.3 if s.position_valid else 10.0
    return mavlink.MAVLink_estimator_status_message(s.now_us, flags if s.estimate_valid else 0, *ratios, accuracy, 0.07)


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


def protocol_version(_: Snapshot) -> Message:
    """PROTOCOL_VERSION."""
    return ProtocolVersion()
