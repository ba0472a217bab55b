"""Views of records in Foxglove's own schemas, for its 3D view and log panel without any configuration.

Schemas after https://docs.foxglove.dev/docs/sdk/schemas (PoseInFrame, PosesInFrame, Log), as JSON.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import msgspec
import numpy as np

from dynamics.arrays import Floats
from runtime.record.records import (
    EstimateRecord,
    EventRecord,
    HorizonRecord,
    Record,
    ReferenceRecord,
    StateRecord,
    TextRecord,
)

FRAME = "world"  # ENU
_TIME = {"type": "object", "title": "time", "properties": {"sec": {"type": "integer"}, "nsec": {"type": "integer"}}}


def _numbers(*names: str) -> dict[str, Any]:
    return {"type": "object", "properties": {name: {"type": "number"} for name in names}}


_POSE = {
    "type": "object",
    "title": "foxglove.Pose",
    "properties": {"position": _numbers("x", "y", "z"), "orientation": _numbers("x", "y", "z", "w")},
}


def _schema(title: str, **properties: Any) -> dict[str, Any]:
    return {"title": title, "type": "object", "properties": {"timestamp": _TIME, **properties}}


SCHEMAS: Mapping[str, dict[str, Any]] = {
    "foxglove.PoseInFrame": _schema("foxglove.PoseInFrame", frame_id={"type": "string"}, pose=_POSE),
    "foxglove.PosesInFrame": _schema(
        "foxglove.PosesInFrame", frame_id={"type": "string"}, poses={"type": "array", "items": _POSE}
    ),
    "foxglove.Log": _schema(
        "foxglove.Log",
        level={"type": "integer"},
        message={"type": "string"},
        name={"type": "string"},
        file={"type": "string"},
        line={"type": "integer"},
    ),
}

TOPICS: Mapping[str, str] = {
    "/pose": "foxglove.PoseInFrame",
    "/reference_pose": "foxglove.PoseInFrame",
    "/horizon_poses": "foxglove.PosesInFrame",
    "/log": "foxglove.Log",
}


def _pose(position: Floats, attitude: Floats) -> dict[str, Any]:
    return {
        "position": dict(zip("xyz", position.tolist(), strict=True)),
        "orientation": dict(zip("wxyz", attitude.tolist(), strict=True)),
    }


def _log(severity: int, message: str, name: str) -> dict[str, Any]:
    # Foxglove: 1 debug .. 5 fatal; MAVLink: 0 emergency .. 7 debug
    level = 5 if severity <= 2 else 4 if severity == 3 else 3 if severity == 4 else 2
    return {"level": level, "message": message, "name": name, "file": "", "line": 0}


def view(record: Record) -> tuple[str, dict[str, Any]] | None:
    """Topic and body of a record's view, without its time stamp; None for records without a view."""
    match record:
        case EstimateRecord():
            return "/pose", {"frame_id": FRAME, "pose": _pose(record.position_world, record.attitude)}
        case ReferenceRecord():
            return "/reference_pose", {"frame_id": FRAME, "pose": _pose(record.position_world, record.attitude)}
        case HorizonRecord():
            positions = np.stack([record.position_x, record.position_y, record.position_z], axis=-1)
            level = np.array([1.0, 0.0, 0.0, 0.0])
            return "/horizon_poses", {"frame_id": FRAME, "poses": [_pose(point, level) for point in positions]}
        case EventRecord():
            word = "raised" if record.active else "cleared"
            return "/log", _log(record.severity, f"{record.name} {word}: {record.text}", "events")
        case StateRecord():
            return "/log", _log(5, f"{record.before} -> {record.after}: {record.reason}", "state")
        case TextRecord():
            return "/log", _log(record.severity, record.text, record.source)
        case _:
            return None


def encode(body: Mapping[str, Any], unix_nanoseconds: int) -> bytes:
    """A view with its time stamp as JSON."""
    seconds, nanoseconds = divmod(unix_nanoseconds, 1_000_000_000)
    return msgspec.json.encode({"timestamp": {"sec": seconds, "nsec": nanoseconds}, **body})
