"""How to log so that the next flight identifies more, for each kind of log."""

from __future__ import annotations

from collections.abc import Mapping

# PX4's logger (src/modules/logger/logged_topics.cpp): default 1, system identification 8, high rate 16. The default
# keeps actuator_motors at 10 Hz and attitude at 20; the other two log motors, gyro and attitude at full rate.
PX4_PROFILE = 25
_PX4 = (
    f"set SDLOG_PROFILE to {PX4_PROFILE} (default, system identification and high rate), which logs actuator_motors, "
    "vehicle_angular_velocity and vehicle_attitude at full rate"
)
_PX4_SPEEDS = "for measured rotor speeds use bidirectional DShot or an ESC with telemetry, so that esc_status is logged"

FASTER_ROTORS: Mapping[str, str] = {
    "PX4 ULog": _PX4,
    "MAVLink tlog": "ask for SERVO_OUTPUT_RAW and ATTITUDE_QUATERNION at 100 Hz or more by "
    f"MAV_CMD_SET_MESSAGE_INTERVAL, or use the ULog of the same flight: {_PX4}",
    "Alula's recording (MCAP)": f"use the vehicle's own ULog of the same flight, joined by time: {_PX4}",
    "ArduPilot DataFlash log": "let LOG_BITMASK include fast attitude and fast IMU, and log ESC telemetry",
    "Crazyflie micro-SD log": "add motor.m1 to motor.m4 to the SD-card deck's configuration at 250 Hz or more",
    "CSV of Crazyflie log variables": "log motor.m1 to motor.m4 in a block of 10 ms, or on the SD-card deck",
    "Betaflight blackbox log": "raise the blackbox rate and log motors",
    "Betaflight blackbox CSV": "raise the blackbox rate and log motors",
    "ROS bag": "record the rotor speeds' topic at 100 Hz or more",
}
MEASURED_SPEEDS: Mapping[str, str] = {
    "PX4 ULog": _PX4_SPEEDS,
    "Betaflight blackbox log": "turn on bidirectional DShot, so that eRPM is logged",
    "Betaflight blackbox CSV": "turn on bidirectional DShot, so that eRPM is logged",
    "ArduPilot DataFlash log": "turn on bidirectional DShot or ESC telemetry, so that ESC messages are logged",
}


def faster_rotors(form: str, parameters: Mapping[str, float]) -> str:
    """Setting that logs rotors fast enough.

    form: the log's format.
    parameters: the vehicle's.
    """
    advice = FASTER_ROTORS.get(form, "log the rotors' speeds or commands at 100 Hz or more")
    profile = parameters.get("SDLOG_PROFILE")
    if form == "PX4 ULog" and profile is not None:
        return advice.replace(f"to {PX4_PROFILE}", f"from {profile:.0f} to {int(profile) | PX4_PROFILE}")
    return advice


UNUSED_ROTORS: Mapping[str, str] = {
    "PX4 ULog": "name the motors' outputs by PWM_MAIN_FUNCn, PWM_AUX_FUNCn or UAVCAN_EC_FUNCn, or the vehicle by "
    "MAV_TYPE, and fly again; or write the flight as a table with these columns",
    "ArduPilot DataFlash log": "name the motors' outputs by SERVOn_FUNCTION 33 to 40 and fly again, or write the "
    "flight as a table with these columns",
    "ROS bag": "publish them as mav_msgs/Actuators or as a message with the fields rpm_0, rpm_1, ..., record types "
    "with their definitions (MCAP), or write the flight as a table and name its columns by a mapping (--mapping)",
    "Crazyflie micro-SD log": "log rpm.m1 to rpm.m4 or motor.m1 to motor.m4, or write the flight as a table and name "
    "its columns by a mapping (--mapping)",
}


def unused_rotors(form: str) -> str:
    """How rotors are made of numbers that a log of this format holds and nothing names."""
    return UNUSED_ROTORS.get(form, "name them in a column mapping (--mapping), with their unit and order")


def measured_speeds(form: str) -> str:
    """How to get measured rotor speeds; empty for a format without advice."""
    return MEASURED_SPEEDS.get(form, "")
