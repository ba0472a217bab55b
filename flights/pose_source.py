"""Where a flight's pose comes from: motion capture, or an estimator that used the same accelerometer.

Agreement of an estimator's velocity with the accelerometer proves nothing, and its errors are slow where those of
motion capture are white. A log's format or the name of a topic tells which it is; a user may say so; else it is
unknown.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Literal, get_args

from dynamics.errors import RequestError
from flights.log import LogContent, Stream

PoseSource = Literal["motion_capture", "estimator", "unknown"]

KEY = "pose_source"  # in the metadata of a log and of a flight
AIDING = "pose_aiding"  # the same: what an estimator used beside inertial sensors, as far as the log tells
ALIASES: Mapping[str, PoseSource] = {"mocap": "motion_capture"}

_QUANTITIES = ("velocity", "attitude", "position")
_ESTIMATOR = re.compile(
    r"stateestimate|stabilizer|kalman|ctrllee|local_position|/fmu/out/|ekf|estimat|odometry/filtered|/ap/",
    re.IGNORECASE,
)
_MOTION_CAPTURE = re.compile(
    r"vicon|optitrack|mocap|motion_capture|qualisys|natnet|vrpn|ground_?truth|lighthouse|locsrv", re.IGNORECASE
)
_FORMATS_OF_ESTIMATES = ("mcap", "dataflash", "tlog", "betaflight", "blackbox_csv")
_ULOG_INPUTS = {"vehicle_mocap_odometry": "motion_capture", "vehicle_visual_odometry": "unknown"}


def source_of(metadata: Mapping[str, str]) -> PoseSource:
    """The source that a log's or a flight's metadata names."""
    value = metadata.get(KEY, "unknown")
    return next((one for one in get_args(PoseSource) if one == value), "unknown")


def named_source(text: str) -> PoseSource:
    """The source that a user names. Raises RequestError for any other."""
    for one in ("motion_capture", "estimator"):
        if ALIASES.get(text, text) == one:
            return one
    raise RequestError(f"the pose comes from {text!r}? Wanted mocap (motion capture) or estimator.")


def with_source(metadata: Mapping[str, str], source: str | None) -> Mapping[str, str]:
    """The metadata of a log or a flight whose pose comes from where a user says; as it is for None."""
    return metadata if source is None else {**metadata, KEY: named_source(source)}


def known_source(name: str, content: LogContent) -> PoseSource:
    """The source that a format or the names of its topics tell. name: of the format."""
    if KEY in content.metadata:
        return source_of(content.metadata)
    used = [stream for quantity in _QUANTITIES if (stream := _first(content.streams, quantity)) is not None]
    sources = [_source_of_stream(name, stream) for stream in used]
    if "estimator" in sources:  # a velocity or an attitude of an estimator makes the acceleration its own
        return "estimator"
    return "motion_capture" if sources and all(one == "motion_capture" for one in sources) else "unknown"


def _first(streams: Sequence[Stream], quantity: str) -> Stream | None:
    return next((stream for stream in streams if stream.name == quantity), None)


def _source_of_stream(name: str, stream: Stream) -> PoseSource:
    if name in _FORMATS_OF_ESTIMATES:
        return "estimator"
    if name == "ulog":
        return "estimator" if stream.source not in _ULOG_INPUTS else source_of({KEY: _ULOG_INPUTS[stream.source]})
    if name not in ("rosbag", "crazyflie", "crazyflie_csv"):
        return "unknown"
    if _MOTION_CAPTURE.search(stream.source):
        return "motion_capture"
    return "estimator" if _ESTIMATOR.search(stream.source) else "unknown"
