"""Health channels of a PX4 ULog: estimator, inertial sensors, failure detector, failsafe, receiver, ESCs.

Field names: PX4's message definitions (docs.px4.io, uORB message reference) of 1.9 to 1.17.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pyulog import ULog
from pyulog.core import ULogException

from dynamics.errors import DataError
from flights.events import px4_mode
from flights.health.answer import HealthEvent
from flights.health.record import AutopilotSeries, Series

TOPICS = (
    "estimator_status", "estimator_selector_status", "estimator_status_flags", "vehicle_imu_status", "vehicle_status",
    "failure_detector_status", "failsafe_flags", "vehicle_status_flags", "battery_status", "vehicle_gps_position",
    "esc_status", "actuator_armed", "vehicle_local_position", "vehicle_land_detected",
)  # fmt: skip
RATIOS = {"velocity": "vel_test_ratio", "position": "pos_test_ratio", "height": "hgt_test_ratio",
          "heading": "hdg_test_ratio", "magnetometer": "mag_test_ratio"}  # fmt: skip
# estimator_status.innovation_check_flags: bits of rejected measurements
REJECTIONS = {"velocity": 0b1, "position": 0b10, "height": 0b100, "magnetometer": 0b111000, "heading": 0b1000000}
FAILURES = {"fd_roll": "roll beyond FD_FAIL_R", "fd_pitch": "pitch beyond FD_FAIL_P", "fd_alt": "altitude",
            "fd_ext": "external", "fd_arm_escs": "ESCs at arming", "fd_battery": "battery",
            "fd_imbalanced_prop": "imbalanced propeller", "fd_motor": "motor"}  # fmt: skip
FAILSAFES = {
    "manual_control_signal_lost": "the remote control was lost", "rc_signal_lost": "the remote control was lost",
    "gcs_connection_lost": "the ground station was lost", "data_link_lost": "the ground station was lost",
    "offboard_control_signal_lost": "the offboard setpoints stopped", "battery_unhealthy": "the battery is unhealthy",
    "battery_low_remaining_time": "the battery is too low to return", "geofence_breached": "the geofence was breached",
    "local_position_invalid": "the position became invalid", "local_velocity_invalid": "the velocity became invalid",
    "global_position_invalid": "the global position became invalid", "attitude_invalid": "the attitude became invalid",
    "angular_velocity_invalid": "the body rates became invalid", "local_altitude_invalid": "the height became invalid",
    "fd_motor_failure": "the failure detector reports a motor", "fd_esc_arming_failure": "an ESC did not arm",
    "fd_critical_failure": "the failure detector reports loss of attitude",
    "position_accuracy_low": "the position is inaccurate",
    "fd_imbalanced_prop": "the failure detector reports an imbalanced propeller",
    "wind_limit_exceeded": "too much wind",
}  # fmt: skip

Columns = Mapping[str, NDArray[Any]]


class _Topics:
    """Topics of a log by name and instance, in the log's time. origin: the log's time 0, us."""

    def __init__(self, log: ULog, origin: float) -> None:
        self._data = {(item.name, item.multi_id): item.data for item in log.data_list}
        self._origin = origin

    def instances(self, name: str) -> list[int]:
        return sorted(multi for topic, multi in self._data if topic == name)

    def columns(self, name: str, instance: int = 0) -> Columns:
        columns: Columns = self._data.get((name, instance), {})
        return columns

    def series(self, name: str, field: str, instance: int = 0) -> Series | None:
        """One field; None where it was not logged."""
        columns = self.columns(name, instance)
        if field not in columns:
            return None
        stamps = columns["timestamp"].astype(float)
        order = np.argsort(stamps, kind="stable")
        suffix = f"[{instance}]" if instance else ""
        values = columns[field].astype(float)
        return Series(stamps[order] * 1e-6 - self._origin, values[order], f"{name}{suffix}.{field}")


def read(file: Path, start: float) -> AutopilotSeries:
    """The channels of an unpacked ULog. start: the log's time 0 on the file's clock, s. Raises DataError."""
    try:
        log = ULog(str(file), message_name_filter_list=list(TOPICS))
    except (ULogException, AttributeError, KeyError, IndexError, TypeError, ValueError, OSError) as error:
        raise DataError(f"this ULog cannot be read: {error}. Its header is cut off or damaged.") from None
    topics = _Topics(log, start)
    instance = topics.series("estimator_selector_status", "primary_instance")
    used = 0 if instance is None or not len(instance.values) else int(np.median(instance.values))
    flags = _flags(topics)
    fix, accuracy = (topics.series("vehicle_gps_position", name) for name in ("fix_type", "eph"))
    cells = topics.series("battery_status", "cell_count")
    uses = topics.series("estimator_status_flags", "cs_gps", used) or topics.series(
        "estimator_status_flags", "cs_gnss_pos", used
    )
    return AutopilotSeries(
        vibration=_each(topics, "vehicle_imu_status", "accel_vibration_metric"),
        clipping=tuple(_clipping(topics)),
        test_ratios={
            name: series for name, field in RATIOS.items() if (series := topics.series("estimator_status", field, used))
        },
        rejected=_rejected(topics, used),
        jumps=_jumps(topics),
        instance=instance,
        gps_fix=fix,
        gps_satellites=topics.series("vehicle_gps_position", "satellites_used"),
        gps_accuracy=accuracy,
        pack_voltage=topics.series("battery_status", "voltage_v"),
        cells=0 if cells is None or not len(cells.values) else int(np.median(cells.values)),
        battery_warning=topics.series("battery_status", "warning"),
        flags=flags,
        esc_failures=_esc_failures(topics),
        events=tuple(_events(topics)),
        uses_gps=_uses_gps(topics, used) if uses is None else bool((uses.values != 0).any()),
    )


def _uses_gps(topics: _Topics, used: int) -> bool | None:
    """Whether bit 2 of estimator_status.control_mode_flags (GPS fusion) was ever set."""
    flags = topics.series("estimator_status", "control_mode_flags", used)
    return None if flags is None else bool((flags.values.astype(np.int64) & 0b100).any())


def _each(topics: _Topics, name: str, field: str) -> tuple[Series, ...]:
    instances = (topics.series(name, field, instance) for instance in topics.instances(name))
    return tuple(series for series in instances if series is not None)


def _clipping(topics: _Topics) -> Iterator[Series]:
    """Sum over the axes of the count of clipped samples, by accelerometer."""
    for instance in topics.instances("vehicle_imu_status"):
        axes = [topics.series("vehicle_imu_status", f"accel_clipping[{axis}]", instance) for axis in range(3)]
        logged = [axis for axis in axes if axis is not None]
        if logged:
            total = np.sum([axis.values for axis in logged], axis=0)
            yield Series(logged[0].time, total, logged[0].channel.removesuffix("[0]"))


def _rejected(topics: _Topics, used: int) -> dict[str, Series]:
    """Innovation test failures, 1 while measurements of a quantity are rejected."""
    flags = topics.series("estimator_status", "innovation_check_flags", used)
    if flags is None:
        return {}
    bits = flags.values.astype(np.int64)
    return {
        name: Series(flags.time, ((bits & mask) != 0).astype(float), flags.channel) for name, mask in REJECTIONS.items()
    }


def _jumps(topics: _Topics) -> dict[str, Series]:
    """Sizes of the estimator's resets, m, m/s and rad, at their times."""
    by_name = {}
    for name, counter, deltas in (
        ("position", "xy_reset_counter", ("delta_xy[0]", "delta_xy[1]")),
        ("height", "z_reset_counter", ("delta_z",)),
        ("velocity", "vxy_reset_counter", ("delta_vxy[0]", "delta_vxy[1]")),
    ):
        count = topics.series("vehicle_local_position", counter)
        parts = [topics.series("vehicle_local_position", delta) for delta in deltas]
        logged = [part.values for part in parts if part is not None]
        if count is None or len(logged) != len(deltas):
            continue
        rows = np.flatnonzero(np.diff(count.values) != 0) + 1
        size = np.linalg.norm(np.stack(logged, axis=1), axis=1)
        by_name[name] = Series(count.time[rows], size[rows], f"vehicle_local_position.{counter}")
    return by_name


def _flags(topics: _Topics) -> dict[str, Series]:
    """Reports of the failure detector and the failsafe, by the name of the field."""
    by_name: dict[str, Series] = {}
    for topic in ("failsafe_flags", "vehicle_status_flags"):
        for field in FAILSAFES:
            if field not in by_name and (series := topics.series(topic, field)) is not None:
                by_name[field] = series
    for field in FAILURES:
        if (series := topics.series("failure_detector_status", field)) is not None:
            by_name[field] = series
    old = topics.series("vehicle_status", "failure_detector_status")
    if old is not None and not any(name in by_name for name in FAILURES):
        bits = old.values.astype(np.int64)
        for bit, field in enumerate(FAILURES):
            by_name[field] = Series(old.time, ((bits >> bit) & 1).astype(float), old.channel)
    if (failsafe := topics.series("vehicle_status", "failsafe")) is not None:
        by_name["failsafe"] = failsafe
    return by_name


def _esc_failures(topics: _Topics) -> dict[int, Series]:
    by_motor = {}
    for esc in range(12):
        series = topics.series("esc_status", f"esc[{esc}].failures")
        if series is not None and (series.values != 0).any():
            function = topics.series("esc_status", f"esc[{esc}].actuator_function")
            motor = esc + 1 if function is None else int(np.max(function.values)) - 100
            by_motor[motor] = series
    return by_motor


def _events(topics: _Topics) -> Iterator[HealthEvent]:
    """Changes of mode, arming, landing, failsafe and failure detector, the first value excepted."""
    for time, value, source in _steps(topics.series("vehicle_status", "nav_state")):
        yield HealthEvent(time, "mode", f"mode {px4_mode(int(value))}", source)
    armed = topics.series("actuator_armed", "armed")
    if armed is None and (state := topics.series("vehicle_status", "arming_state")) is not None:
        armed = Series(state.time, (state.values == 2).astype(float), state.channel)
    for time, value, source in _steps(armed):
        yield HealthEvent(time, "armed" if value else "disarmed", "armed" if value else "disarmed", source)
    for time, value, source in _steps(topics.series("vehicle_land_detected", "landed")):
        yield HealthEvent(time, "landed" if value else "takeoff", "landed" if value else "took off", source)
    for field, text in (("manual_lockdown", "kill switch"), ("kill", "kill switch"), ("lockdown", "lockdown"),
                        ("termination", "flight termination"), ("force_failsafe", "flight termination")):  # fmt: skip
        for time, value, source in _steps(topics.series("actuator_armed", field)):
            yield HealthEvent(time, field, f"{text} {'engaged' if value else 'released'}", source)
    for field, series in _flags(topics).items():
        text = f"the failure detector reports {FAILURES[field]}" if field in FAILURES else FAILSAFES.get(field, field)
        for time, value, source in _steps(series):
            if value:
                shown = "failsafe begins" if field == "failsafe" else text
                yield HealthEvent(time, field, shown, source)


def _steps(series: Series | None) -> Iterator[tuple[float, float, str]]:
    """Time, new value and channel of each change."""
    if series is None:
        return
    for row in np.flatnonzero(np.diff(series.values) != 0) + 1:
        yield float(series.time[row]), float(series.values[row]), series.channel
