"""PX4 ULog files, of today's topic names and of those before: NED and FRD become ENU and FLU.

Every topic keeps its own clock: the sample's time where it is logged, or else that of publication.
"""

from __future__ import annotations

import datetime
import io
import mmap
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pyulog.core
from pyulog import ULog
from pyulog.core import ULogException

from dynamics import frames, quaternion
from dynamics.arrays import Floats
from dynamics.errors import DataError
from flights.assembly import Assembly
from flights.events import px4_mode
from flights.log import LogContent
from flights.pose_source import AIDING
from flights.readers import ulog_rotors
from flights.readers.ulog_topics import TOPIC_ALIASES, Topic, Topics
from flights.source import Source

AIRFRAME, UTC_START = "sys_uuid", "utc_start"  # of the metadata
_MIN_UTC = 1e15  # us since 1970; receivers without a fix count from zero or from an old firmware's date
_MAGIC = b"ULog\x01\x12\x35"
_ENCRYPTED_MAGIC = b"ULogEnc"
_HEADER_BYTES = 16
_MAX_BACK = 64 << 20  # bytes in all that pyulog may step back around damage
_SYNC = b"\x2f\x73\x13\x20\x25\x0c\xbb\x12"
_ARMED_STATE = 2
_FAR_FASTER = 2.0  # times the samples of the usual source, from which another one is used before it
_NO_OFFSET = 2_147_483_647  # accelerometer_timestamp_relative of a sample that is none
# vehicle_odometry.velocity_frame since PX4 1.14 and before; 3 has been body FRD all along
_VELOCITY_NED, _OLD_VELOCITY_NED, _VELOCITY_BODY = 1, 0, 3
_FRD_OF_ANY_HEADING = 2  # of pose_frame and velocity_frame: a world frame, whose north is where the vehicle began
_EXTERNAL = ("vehicle_visual_odometry", "vehicle_mocap_odometry")
# parameters whose bits say what of it is fused: today's, and vision's position, yaw and velocity before PX4 1.14
_EXTERNAL_AIDING = {"EKF2_EV_CTRL": 0b1111, "EKF2_AID_MASK": 0b1_0001_1000}
TOPICS = (
    "vehicle_local_position", "vehicle_odometry", "vehicle_visual_odometry", "vehicle_attitude",
    "vehicle_angular_velocity", "sensor_combined", "vehicle_acceleration",
    "vehicle_imu", "sensor_accel", "actuator_armed", "vehicle_status", "vehicle_land_detected",
    "battery_status", "trajectory_setpoint", "vehicle_local_position_setpoint", "vehicle_attitude_setpoint",
    "vehicle_rates_setpoint", "vehicle_mocap_odometry", "vehicle_gps_position", "sensor_gps",
    *ulog_rotors.TOPICS, *(old for names in TOPIC_ALIASES.values() for old in names),
)  # fmt: skip


def _unprinted(*_: object, **__: object) -> None:
    """In place of `print` in pyulog, which prints errors; sys.stdout is of all threads, and stays as it is."""


pyulog.core.print = _unprinted


def matches(source: Source) -> bool:
    """Whether it begins as a ULog does, an encrypted one as well."""
    return source.head.startswith((_MAGIC, _ENCRYPTED_MAGIC))


def read(source: Source) -> LogContent:
    """The streams of a ULog. Raises DataError when even its header cannot be read, and for an encrypted one."""
    if source.head.startswith(_ENCRYPTED_MAGIC):
        raise DataError(
            "this ULog is encrypted: decrypt it with PX4's Tools/decrypt_ulog.py and the private key of the vehicle's "
            "exchange key (SDLOG_EXCH_KEY), and give the .ulg file."
        )
    assembly = Assembly()
    log = _parse(source, assembly)
    topics = Topics(log.data_list, assembly)
    numbers = {name: value for name, value in log.initial_parameters.items() if isinstance(value, int | float)}
    assembly.parameters.update({name: float(value) for name, value in numbers.items()})
    vehicle_type = _describe(log, topics, assembly)
    add_topics(assembly, topics, vehicle_type)
    _messages(log, assembly)
    return assembly.finish()


def add_topics(assembly: Assembly, topics: Topics, vehicle_type: int | None) -> None:
    """Add the streams of PX4's topics, of a ULog or of another recording. vehicle_type: MAV_TYPE, None: not known."""
    for add in _MOTION:
        add(assembly, topics)
    ulog_rotors.add_streams(assembly, topics, vehicle_type)
    for add in _REST:
        try:
            add(assembly, topics)
        except (KeyError, ValueError, IndexError) as error:  # fields that another version of PX4 has otherwise
            assembly.repair("stream_left_out", f"{add.__name__.strip('_')}: its topic is left out ({error!r})")


class _Guarded(io.BufferedReader):
    """A file that refuses to be read over and over: around some damage pyulog steps back without end."""

    _stepped_back = 0

    def seek(self, target: int, whence: int = 0) -> int:
        """As any file's, but back only by a limited number of bytes in all."""
        before = self.tell()
        after = super().seek(target, whence)
        self._stepped_back += max(0, before - after)
        if self._stepped_back > _MAX_BACK:
            raise ULogException("it is damaged in too many places")
        return after


def _parse(source: Source, assembly: Assembly) -> ULog:
    try:
        with _Guarded(io.FileIO(source.file)) as stream:
            log = ULog(stream, message_name_filter_list=list(TOPICS))
    except (ULogException, AttributeError, KeyError, IndexError, TypeError, ValueError, OSError) as error:
        raise DataError(f"this ULog cannot be read: {error}. Its header is cut off or damaged.") from None
    if log.file_corruption:
        assembly.repair("damaged_messages", "parts of the ULog are damaged; read around them")
    if _is_torn(source.file):
        assembly.repair("torn_end", "the ULog ends within a message; read up to there")
    if log.dropouts:
        lost = sum(dropout.duration for dropout in log.dropouts) * 1e-3
        assembly.note(f"the logger dropped out {len(log.dropouts)} times, {lost:.2f} s in all")
    return log


def _is_torn(file: Path) -> bool:
    """Whether the last message is incomplete, followed from the last sync point or else from the start."""
    size = file.stat().st_size
    with file.open("rb") as stream, mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ) as data:
        sync = data.rfind(_SYNC)
        position = sync + len(_SYNC) if sync >= 0 else _HEADER_BYTES
        while position + 3 <= size:
            position += 3 + (data[position] | data[position + 1] << 8)
    return position != size


def _describe(log: ULog, topics: Topics, assembly: Assembly) -> int | None:
    """Add metadata. Returns MAV_TYPE, None where the log has none."""
    for key in ("sys_name", AIRFRAME, "ver_hw", "ver_sw"):
        if key in log.msg_info_dict:
            assembly.metadata[key] = str(log.msg_info_dict[key])
    if date := _utc_start(topics):
        assembly.metadata[UTC_START] = date
    if isinstance(log.msg_info_dict.get("ver_sw_release"), int) and (version := log.get_version_info_str()):
        assembly.metadata["version"] = version
    status = topics.get("vehicle_status")
    kind = int(status["system_type"][0]) if status is not None and status.has("system_type") else None
    if kind is None and "MAV_TYPE" in assembly.parameters:
        kind = int(assembly.parameters["MAV_TYPE"])
    if kind is not None:
        assembly.metadata["vehicle_type"] = str(kind)
    return kind


def _modes(assembly: Assembly, topics: Topics) -> None:
    """Add the changes of mode."""
    status = topics.get("vehicle_status")
    if status is None or not status.has("nav_state"):
        return
    states = status["nav_state"]
    for row in np.flatnonzero(np.diff(states, prepend=np.nan)).tolist():
        assembly.event(float(status.time[row]), "mode", px4_mode(int(states[row])))


def _messages(log: ULog, assembly: Assembly) -> None:
    """Add what the autopilot's log says."""
    for message in log.logged_messages:
        time = float(assembly.seconds([message.timestamp], 1_000_000)[0])
        assembly.event(time, "message", f"{message.log_level_str()}: {message.message}")


def _utc_start(topics: Topics) -> str:
    """Date and time of the first fix of a satellite receiver (ISO 8601, UTC), empty where the log has none."""
    for name in ("vehicle_gps_position", "sensor_gps"):
        topic = topics.get(name)
        if topic is None or not topic.has("time_utc_usec"):
            continue
        stamps = topic["time_utc_usec"]
        fixed = stamps[stamps > _MIN_UTC]
        if len(fixed):
            date = datetime.datetime.fromtimestamp(float(fixed[0]) * 1e-6, tz=datetime.UTC)
            return date.replace(tzinfo=None).isoformat(timespec="seconds")
    return ""


def _local_position(assembly: Assembly, topics: Topics) -> None:
    topic = topics.get("vehicle_local_position")
    if topic is None:
        return
    for name, parts, flags in (
        ("position", "xyz", ("xy_valid", "z_valid")),
        ("velocity", ("vx", "vy", "vz"), ("v_xy_valid", "v_z_valid")),
    ):
        if topic.has(*parts):
            valid = [topic.flag(flag) for flag in (flags[0], *flags)]
            ned = np.stack([np.where(ok, topic[part], np.nan) for part, ok in zip(parts, valid, strict=True)], axis=1)
            assembly.add(name, topic.time, frames.enu_from_ned(ned), topic.name)
    for name, counters in (
        ("position", ("xy_reset_counter", "z_reset_counter")),
        ("velocity", ("vxy_reset_counter", "vz_reset_counter")),
    ):
        if topic.has(*counters):
            # as one number that changes whenever either does
            assembly.add(f"{name}_reset_counter", topic.time, topic[counters[0]] * 256 + topic[counters[1]], topic.name)


def _attitude(assembly: Assembly, topics: Topics) -> None:
    topic = topics.get("vehicle_attitude")
    if topic is None or not topic.has("q[0]"):
        return
    assembly.add("attitude", topic.time, frames.attitude_enu_flu(topic.array("q", 4)), topic.name)
    if topic.has("quat_reset_counter"):
        assembly.add("attitude_reset_counter", topic.time, topic["quat_reset_counter"], topic.name)


def _rates(assembly: Assembly, topics: Topics) -> None:
    """Body rates of every topic that has them, the one with the highest rate first."""
    rates: list[tuple[Topic, Floats]] = []
    topic = topics.get("vehicle_angular_velocity")
    if topic is not None and topic.has("xyz[0]"):
        rates.append((topic, topic.array("xyz", 3)))
    topic = topics.get("sensor_combined")
    if topic is not None and topic.has("gyro_rad[0]"):
        rates.append((topic, topic.array("gyro_rad", 3)))
    topic = topics.get("vehicle_attitude")
    if topic is not None and topic.has("rollspeed", "pitchspeed", "yawspeed"):
        rates.append((topic, topic.stack("rollspeed", "pitchspeed", "yawspeed")))
    for topic, rate in sorted(rates, key=lambda pair: -len(pair[0].time)):
        assembly.add("rate", topic.time, frames.flu_from_frd(rate), topic.name)


def _specific_force(assembly: Assembly, topics: Topics) -> None:
    """Specific force of every topic that has it: sensor_combined first, unless another is logged far more often.

    vehicle_acceleration is filtered, vehicle_imu holds means over its interval; both are calibrated, in body axes.
    """
    forces: list[tuple[Topic, Floats, Floats]] = []
    topic = topics.get("sensor_combined")
    if topic is not None and topic.has("accelerometer_m_s2[0]"):
        time, force = topic.time, topic.array("accelerometer_m_s2", 3)
        if topic.has("accelerometer_timestamp_relative"):
            offset = topic["accelerometer_timestamp_relative"]
            stamped = offset != _NO_OFFSET
            time, force = (time + offset * 1e-6)[stamped], force[stamped]
        forces.append((topic, time, force))
    topic = topics.get("vehicle_acceleration")
    if topic is not None and topic.has("xyz[0]"):
        forces.append((topic, topic.time, topic.array("xyz", 3)))
    topic = topics.get("vehicle_imu")
    if not forces and topic is not None and topic.has("delta_velocity[0]", "delta_velocity_dt"):
        interval = topic["delta_velocity_dt"] * 1e-6
        mean = topic.array("delta_velocity", 3) / np.where(interval > 0, interval, np.nan)[:, None]
        forces.append((topic, topic.time - 0.5 * interval, mean))
    usual = len(forces[0][1]) if forces else 0
    forces.sort(key=lambda entry: -len(entry[1]) if len(entry[1]) > _FAR_FASTER * usual else 0)
    for topic, time, force in forces:
        assembly.add("specific_force", time, frames.flu_from_frd(force), topic.source)
    if not forces:
        _raw_sensors(assembly, topics)


def _raw_sensors(assembly: Assembly, topics: Topics) -> None:
    """Keep accelerometers before calibration and rotation, where the log has nothing else."""
    for instance in topics.instances("sensor_accel"):
        topic = topics.get("sensor_accel", instance)
        if topic is not None and topic.has("x", "y", "z"):
            reason = "they are one sensor's before calibration and the board's rotation; log sensor_combined"
            assembly.leave_out("specific_force", topic.label, ["x", "y", "z"], topic.stack("x", "y", "z"), reason)


def _odometry(assembly: Assembly, topics: Topics) -> None:
    """The estimator's and mocap's odometry, after `vehicle_local_position` and `vehicle_attitude`."""
    for name in ("vehicle_odometry", "vehicle_visual_odometry", "vehicle_mocap_odometry"):
        topic = topics.get(name)
        if topic is None:
            continue
        attitude = frames.attitude_enu_flu(topic.array("q", 4)) if topic.has("q[0]") else None
        if topic.has("position[0]"):
            assembly.add("position", topic.time, frames.enu_from_ned(topic.array("position", 3)), name)
        elif topic.has("x", "y", "z"):
            assembly.add("position", topic.time, frames.enu_from_ned(topic.stack("x", "y", "z")), name)
        if attitude is not None and np.isfinite(attitude).any():
            assembly.add("attitude", topic.time, attitude, name)
        velocity = _odometry_velocity(topic, attitude, assembly)
        if velocity is not None:
            assembly.add("velocity", topic.time, velocity, name)
        if topic.has("reset_counter") and name == "vehicle_odometry":
            assembly.add("reset_counter", topic.time, topic["reset_counter"], name)


def _odometry_velocity(topic: Topic, attitude: Floats | None, assembly: Assembly) -> Floats | None:
    """Velocity in ENU by the frame that the topic names; versions without the field have NED."""
    if topic.has("velocity[0]"):
        velocity_logged = topic.array("velocity", 3)
    elif topic.has("vx", "vy", "vz"):
        velocity_logged = topic.stack("vx", "vy", "vz")
    else:
        return None
    ned = _VELOCITY_NED if topic.has("velocity[0]") else _OLD_VELOCITY_NED
    frame = topic["velocity_frame"] if topic.has("velocity_frame") else np.full(len(velocity_logged), float(ned))
    if not topic.has("velocity_frame"):
        assembly.note(f"{topic.name} has no velocity_frame: its velocity is taken for NED, as of PX4 before 1.11")
    in_body = frame == _VELOCITY_BODY
    if topic.has("velocity[0]", "pose_frame"):  # the pose's own world frame
        own = (frame == _FRD_OF_ANY_HEADING) & (topic["pose_frame"] == _FRD_OF_ANY_HEADING)
        frame = np.where(own, float(ned), frame)
    supported = (frame == ned) | (in_body & np.array(attitude is not None))
    velocity = np.where(supported[:, None], frames.enu_from_ned(velocity_logged), np.nan)
    if in_body.any() and attitude is not None:
        world = quaternion.rotate(attitude, frames.flu_from_frd(velocity_logged))
        velocity = np.where(in_body[:, None], world, velocity)
    if not supported.all():
        assembly.repair(
            "unknown_frame", f"{topic.name}: {np.count_nonzero(~supported)} velocities in other frames masked"
        )
    return velocity


def _armed(assembly: Assembly, topics: Topics) -> None:
    topic = topics.get("actuator_armed")
    if topic is not None and topic.has("armed"):
        assembly.add("armed", topic.time, topic["armed"] != 0, topic.name)
    topic = topics.get("vehicle_status")
    if topic is not None and topic.has("arming_state"):
        assembly.add("armed", topic.time, topic["arming_state"] == _ARMED_STATE, topic.name)


def _landed(assembly: Assembly, topics: Topics) -> None:
    topic = topics.get("vehicle_land_detected")
    if topic is not None and topic.has("landed"):
        assembly.add("landed", topic.time, topic["landed"] != 0, topic.name)


def _battery(assembly: Assembly, topics: Topics) -> None:
    topic = topics.get("battery_status")
    if topic is None or not topic.has("voltage_v"):
        return
    connected = topic.flag("connected")
    assembly.add("battery_voltage", topic.time, np.where(connected, topic["voltage_v"], np.nan), topic.name)
    if topic.has("current_a"):
        current = topic["current_a"]
        assembly.add("battery_current", topic.time, np.where(connected & (current >= 0), current, np.nan), topic.name)


def _setpoints(assembly: Assembly, topics: Topics) -> None:
    topic = topics.get("trajectory_setpoint")
    if topic is not None and topic.has("position[0]"):
        assembly.add("position_setpoint", topic.time, frames.enu_from_ned(topic.array("position", 3)), topic.name)
        assembly.add("velocity_setpoint", topic.time, frames.enu_from_ned(topic.array("velocity", 3)), topic.name)
    topic = topics.get("vehicle_local_position_setpoint")
    if topic is not None and topic.has("x", "vx"):
        assembly.add("position_setpoint", topic.time, frames.enu_from_ned(topic.stack("x", "y", "z")), topic.name)
        assembly.add("velocity_setpoint", topic.time, frames.enu_from_ned(topic.stack("vx", "vy", "vz")), topic.name)
    topic = topics.get("vehicle_attitude_setpoint")
    if topic is not None and topic.has("q_d[0]"):
        assembly.add("attitude_setpoint", topic.time, frames.attitude_enu_flu(topic.array("q_d", 4)), topic.name)
    topic = topics.get("vehicle_rates_setpoint")
    if topic is not None and topic.has("roll", "pitch", "yaw"):
        rate = frames.flu_from_frd(topic.stack("roll", "pitch", "yaw"))
        assembly.add("rate_setpoint", topic.time, rate, topic.name)
        thrust = -topic["thrust_body[2]"] if topic.has("thrust_body[2]") else topic["thrust"]
        assembly.add("thrust_setpoint", topic.time, thrust, topic.name)


def _aiding(assembly: Assembly, topics: Topics) -> None:
    """Add the vision and motion capture that the estimator used: it stays an estimator."""
    topic = next((name for name in _EXTERNAL if topics.get(name) is not None), None)
    used = any(int(assembly.parameters.get(name, 0)) & mask for name, mask in _EXTERNAL_AIDING.items())
    if topic is not None and used:
        assembly.metadata[AIDING] = f"an external pose ({topic})"


_Add = Callable[[Assembly, Topics], None]
_MOTION: Sequence[_Add] = (_local_position, _attitude, _rates, _specific_force, _odometry)
_REST: Sequence[_Add] = (_battery, _setpoints, _armed, _landed, _aiding, _modes)
