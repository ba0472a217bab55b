"""The date of a log, by its own clock, its name, or the file's time of change."""

from __future__ import annotations

import re
from datetime import UTC, datetime
from pathlib import Path, PurePath

from flights.log import Log
from flights.readers.ulog import UTC_START
from studies.fleet.flight import DateSource

EPOCH = 1e9, 4e9  # s since 1970 (2001 to 2096): a clock that shows the date, and not the time since power was on
_DAY = r"(?<!\d)(20\d\d)[-_.]?([01]\d)[-_.]?([0-3]\d)"
_CLOCK = r"([0-2]\d)[-_.:h]?([0-5]\d)[-_.:m]?([0-5]\d)(?!\d)"
_STAMP = re.compile(rf"{_DAY}(?:[-_ T]?{_CLOCK})?")
_TIME_OF_DAY = re.compile(rf"^{_CLOCK}")


def log_date(log: Log | None, name: str, path: Path) -> tuple[str, DateSource]:
    """The date of a log (ISO 8601, without a time zone) and where it is from.

    By the log's own clock (UTC) where that shows the date, else by its name in the fleet's folder, as PX4
    (2026-03-01/10_15_00.ulg) and recorders (20260301-101500.mcap) write it, else by the file's time of change (UTC).
    log: None for one that could not be read.
    """
    if log is not None:
        if EPOCH[0] <= log.start < EPOCH[1]:
            return _iso(log.start), "log"
        if UTC_START in log.metadata:
            return log.metadata[UTC_START], "log"
    if written := date_in_name(name):
        return written, "name"
    try:
        return _iso(path.stat().st_mtime), "file"
    except OSError:
        return "", ""


def date_in_name(name: str) -> str:
    """The date in a path, the file's own name before its folders'; empty where there is none."""
    parts = PurePath(name).parts[::-1]
    for place, part in enumerate(parts):
        for match in _STAMP.finditer(part):
            numbers = [int(number) for number in match.groups() if number is not None]
            if len(numbers) == 3 and place and (clock := _TIME_OF_DAY.match(parts[0])):
                numbers += [int(number) for number in clock.groups()]
            try:
                return datetime(*numbers).isoformat()  # type: ignore[arg-type]
            except ValueError:
                continue  # a number that only looks like a date
    return ""


def day_of(date: str) -> float:
    """Days since 1970 of an ISO date."""
    return datetime.fromisoformat(date).replace(tzinfo=UTC).timestamp() / 86_400.0


def _iso(seconds: float) -> str:
    return datetime.fromtimestamp(seconds, tz=UTC).replace(tzinfo=None).isoformat(timespec="seconds")
