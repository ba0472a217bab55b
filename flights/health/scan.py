"""One line about a log for `alula scan`: its health, and the columns that PX4's Flight Review keeps of a log.

Columns: the table LogsGenerated of Flight Review's database (PX4/flight_review, app/setup_db.py); `file`, `outcome` and
`error`: the NDJSON records of PX4/flight-review-rs.
"""

from __future__ import annotations

import math
from typing import Any

import msgspec

from dynamics.errors import AlulaError
from flights.events import PX4_MODES
from flights.health.reading import read_health
from flights.log import Log
from flights.reading import read_log

MAV_TYPES = {"2": "Quadrotor", "13": "Hexarotor", "14": "Octorotor", "3": "Coaxial", "4": "Helicopter",
             "15": "Tricopter", "22": "VTOL", "1": "Fixed Wing", "10": "Ground Rover"}  # fmt: skip
ERROR_LEVELS = ("EMERGENCY", "ALERT", "CRITICAL", "ERROR")
ESTIMATORS = {0: "Q attitude estimator", 1: "Q attitude estimator", 2: "EKF2"}  # PX4's SYS_MC_EST_GROUP, before 1.14


def scanned(path: str) -> dict[str, Any]:
    """The line of a log, or of the reason why it cannot be read."""
    try:
        log = read_log(path)
        health = read_health(log)
    except (AlulaError, OSError) as error:
        return {"file": path, "outcome": "error", "error": str(error), **dict.fromkeys(_columns(None)), "health": None}
    line = {"file": path, "outcome": "ok", "error": None, **_columns(log), "health": msgspec.to_builtins(health)}
    return {name: _finite(value) for name, value in line.items()}


def _columns(log: Log | None) -> dict[str, Any]:
    """Flight Review's columns, None where the log has none of it."""
    if log is None:
        return dict.fromkeys(
            ("Duration", "MavType", "Estimator", "AutostartId", "Hardware", "Software", "SoftwareVersion", "UUID",
             "NumLoggedErrors", "NumLoggedWarnings", "FlightModes", "FlightModeDurations", "StartTime")
        )  # fmt: skip
    metadata, messages = log.metadata, [event.text for event in log.events if event.kind == "message"]
    durations = _mode_durations(log)
    kind = metadata.get("vehicle_type", "")
    start = log.parameters.get("SYS_AUTOSTART")
    return {
        "Duration": round(log.duration),
        "MavType": MAV_TYPES.get(kind, kind or None),
        "Estimator": ESTIMATORS.get(int(log.parameters.get("SYS_MC_EST_GROUP", 2))) if start is not None else None,
        "AutostartId": None if start is None else int(start),
        "Hardware": metadata.get("ver_hw"),
        "Software": metadata.get("ver_sw"),
        "SoftwareVersion": metadata.get("version"),
        "UUID": metadata.get("sys_uuid"),
        "NumLoggedErrors": sum(text.startswith(ERROR_LEVELS) for text in messages),
        "NumLoggedWarnings": sum(text.startswith("WARNING") for text in messages),
        "FlightModes": ",".join(str(mode) for mode in dict.fromkeys(mode for mode, _ in durations)),
        "FlightModeDurations": ",".join(f"{mode}:{seconds}" for mode, seconds in durations),
        "StartTime": metadata.get("utc_start"),
    }


def _mode_durations(log: Log) -> list[tuple[int | str, int]]:
    """Each mode, by PX4's number where it has one, and its seconds, in the order of time."""
    numbers = {name: number for number, name in PX4_MODES.items()}
    modes = [event for event in log.events if event.kind == "mode"]
    ends = [*(event.time for event in modes[1:]), log.duration][: len(modes)]
    return [
        (numbers.get(event.text, event.text), max(0, round(end - max(event.time, 0.0))))
        for event, end in zip(modes, ends, strict=True)
    ]


def _finite(value: Any) -> Any:
    """A value without numbers that JSON does not have."""
    if isinstance(value, dict):
        return {name: _finite(part) for name, part in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(part) for part in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
