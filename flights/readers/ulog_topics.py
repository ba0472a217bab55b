"""Topics of a ULog by current names of topics and fields, for logs of any firmware."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dynamics.arrays import Floats
from flights.assembly import Assembly

# Current name of a field, as topic.field, to its older names.
FIELD_ALIASES: Mapping[str, tuple[str, ...]] = {
    "vehicle_angular_velocity.xyz[0]": ("rollspeed", "x"),
    "vehicle_angular_velocity.xyz[1]": ("pitchspeed", "y"),
    "vehicle_angular_velocity.xyz[2]": ("yawspeed", "z"),
    "vehicle_attitude_setpoint.q_d[0]": ("q[0]",),
    "vehicle_attitude_setpoint.q_d[1]": ("q[1]",),
    "vehicle_attitude_setpoint.q_d[2]": ("q[2]",),
    "vehicle_attitude_setpoint.q_d[3]": ("q[3]",),
    "vehicle_attitude.quat_reset_counter": ("quat_reset_counter", "reset_counter"),
    "trajectory_setpoint.position[0]": ("x",),
    "trajectory_setpoint.position[1]": ("y",),
    "trajectory_setpoint.position[2]": ("z",),
    "trajectory_setpoint.velocity[0]": ("vx",),
    "trajectory_setpoint.velocity[1]": ("vy",),
    "trajectory_setpoint.velocity[2]": ("vz",),
    "battery_status.voltage_v": ("voltage_filtered_v",),
}
# Current name of a topic to its older names.
TOPIC_ALIASES: Mapping[str, tuple[str, ...]] = {
    "vehicle_visual_odometry": ("vehicle_vision_odometry",),
    "vehicle_mocap_odometry": ("att_pos_mocap",),
    "esc_status": ("esc_report",),
}


class Topic:
    """One topic's columns. time: (n,) s, of the sample where that was logged."""

    def __init__(self, name: str, columns: Mapping[str, NDArray[Any]], time: Floats, instance: int = 0) -> None:
        self.name = name
        self.label = f"{name}[{instance}]"
        self.source = self.label if instance else name
        self.time = time
        self._columns = columns

    def _find(self, field: str) -> str | None:
        names = (field, *FIELD_ALIASES.get(f"{self.name}.{field}", ()))
        return next((name for name in names if name in self._columns), None)

    def has(self, *fields: str) -> bool:
        """Whether all of these fields were logged, by this name or an older one."""
        return all(self._find(field) is not None for field in fields)

    def __getitem__(self, field: str) -> Floats:
        """(n,) one field."""
        return np.asarray(self._columns[self._find(field) or field], dtype=float)

    def flag(self, field: str) -> NDArray[np.bool_]:
        """(n,) a field of validity; true throughout where it is not logged."""
        return self[field] != 0 if self.has(field) else np.ones(len(self.time), dtype=bool)

    def array(self, field: str, length: int) -> Floats:
        """(n, length) the elements of an array field."""
        return self.stack(*(f"{field}[{index}]" for index in range(length)))

    def stack(self, *fields: str) -> Floats:
        """(n, k) several fields."""
        return np.stack([self[field] for field in fields], axis=1)


class Topics:
    """The topics of a log. data: pyulog's data_list."""

    def __init__(self, data: Iterable[Any], assembly: Assembly) -> None:
        self._assembly = assembly
        current = {old: name for name, olds in TOPIC_ALIASES.items() for old in olds}
        self._data: dict[tuple[str, int], list[Any]] = {}
        for item in sorted(data, key=lambda item: item.data["timestamp"][0]):
            self._data.setdefault((current.get(item.name, item.name), item.multi_id), []).append(item)

    def instances(self, name: str) -> list[int]:
        """The instances of a topic that were logged, in order."""
        return sorted(instance for topic, instance in self._data if topic == name)

    def get(self, name: str, instance: int = 0) -> Topic | None:
        """A topic's instance, None where it was not logged. A topic that was logged in several parts is joined."""
        parts = self._data.get((name, instance))
        if not parts:
            return None
        columns: dict[str, NDArray[Any]] = {
            field: np.concatenate([part.data[field] for part in parts])
            for field in parts[0].data
            if all(field in part.data for part in parts)
        }
        return Topic(name, columns, self._assembly.seconds(_sample_time(columns), 1_000_000), instance)


def _sample_time(columns: Mapping[str, NDArray[Any]]) -> NDArray[np.int64]:
    """Stamps in microseconds: of the sample where it is logged and not after publication."""
    published = np.asarray(columns["timestamp"]).astype(np.int64)
    if "timestamp_sample" not in columns:
        return published
    sampled = np.asarray(columns["timestamp_sample"]).astype(np.int64)
    valid = (sampled > 0) & (sampled <= published)
    return sampled if valid.all() else published if not valid.any() else np.where(valid, sampled, published)
