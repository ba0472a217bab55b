"""Parameters that a model followed in flight, from a recording: values over time, with deviations."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import msgspec
import numpy as np
from mcap.records import Attachment, Channel, Chunk, McapRecord, Message, Metadata
from mcap.stream_reader import StreamReader

from dynamics.arrays import Floats
from dynamics.decoding import decode_json
from dynamics.errors import DataError, RequestError
from dynamics.mcap_chunks import records_of
from flights.readers.mcap import MAGIC, TORN
from flights.source import sha256

VEHICLE_TEXT = "vehicle.toml"  # attachment of a recording
FOLLOWED, PHASE, OBSERVATION, SETPOINT = "/followed", "/phase", "/observation", "/setpoint"
NETWORK_VALUES = 5  # of a network's last layer in a row
TRACKED = "track"  # the phase in which the reference is flown

Numbers = list[float | None]


class _Followed(msgspec.Struct):
    time: float
    staying: Numbers
    fading: Numbers
    trust: Numbers
    names: str
    value: Numbers
    deviation: Numbers
    effectiveness_deviation: float | None = None
    network_change: Numbers = []
    network_errors: Numbers = []


class _Timed(msgspec.Struct):
    time: float
    phase: str = ""


class _Setpoint(msgspec.Struct):
    time: float
    effectiveness: float | None = None


class _Adaptation(msgspec.Struct):
    mode: str = ""


class _Controller(msgspec.Struct):
    adaptation: _Adaptation = msgspec.field(default_factory=_Adaptation)


class FollowedValue(NamedTuple):
    """A followed parameter at the end of tracking.

    std: standard deviation. start_std: before the flight, of its prior; infinite for one that was named in flight.
    """

    value: float
    std: float
    start_std: float


@dataclass(frozen=True, eq=False)
class FollowedFlight:
    """Parameters that a model followed in a flight. k: parameters.

    path: of the recording. sha256: of the file.
    vehicle: text of the vehicle file that flew.
    mode: "on", or "shadow" where it was estimated and not flown.
    time: (n,) s since the first tick.
    names: of the parameters, such as "wind.x" or "weak_rotor[2].loss".
    value, deviation: (n, k) SI, NaN where a parameter was not followed yet.
    disturbance: (n, 6) m/s^2 world ENU, rad/s^2 body FLU.
    trust: (n, 2) share of what was estimated that is flown: linear and parameters, angular.
    effectiveness: (n,) thrust per modelled thrust, NaN before the first setpoint.
    effectiveness_deviation: (n,) its standard deviation; NaN in a recording of an older version.
    tracked: (n,) whether the reference was flown.
    network: (n, 5) m/s^2, of a network's last layer the RMS change over the training's inputs by axis, then errors of
        forecasts with the change and without; NaN where it does not follow.
    """

    path: Path
    sha256: str
    vehicle: str
    mode: str
    time: Floats
    names: tuple[str, ...]
    value: Floats
    deviation: Floats
    disturbance: Floats
    trust: Floats
    effectiveness: Floats
    effectiveness_deviation: Floats
    tracked: np.ndarray[tuple[int], np.dtype[np.bool_]]
    network: Floats

    @property
    def last(self) -> int:
        """Row at the end of tracking, or else of the recording: what comes later is landing and ground."""
        rows = np.flatnonzero(self.tracked)
        return int(rows[-1]) if len(rows) else len(self.time) - 1

    @property
    def values(self) -> dict[str, FollowedValue]:
        """The parameters at the end of tracking, by name; those that were followed by then."""
        here = self.last
        return {
            name: FollowedValue(float(self.value[here, i]), float(self.deviation[here, i]), float(start))
            for i, (name, start) in enumerate(zip(self.names, self._start_stds, strict=True))
            if np.isfinite(self.value[here, i])
        }

    @property
    def _start_stds(self) -> Floats:
        """(k,) of the first row."""
        return np.where(np.isfinite(self.deviation[0]), self.deviation[0], np.inf)

    def range_of(self, name: str, max_unshown: float) -> tuple[FollowedValue, FollowedValue] | None:
        """Its lowest and highest value while it was shown and tracked; None where it never was.

        max_unshown: deviation over that before the flight, up to which it is shown.
        """
        place = self.names.index(name)
        value, deviation, start = self.value[:, place], self.deviation[:, place], float(self._start_stds[place])
        rows = np.flatnonzero(self.tracked & (deviation <= max_unshown * start))
        if not len(rows):
            return None
        ends = rows[np.argmin(value[rows])], rows[np.argmax(value[rows])]
        low, high = (FollowedValue(float(value[i]), float(deviation[i]), start) for i in ends)
        return low, high


def read_followed(path: str | Path) -> FollowedFlight | None:
    """Followed parameters of a recording; None for a log of another kind, or a flight whose model did not follow.

    Read up to where a recording is cut off. Raises RequestError for a file that cannot be read.
    """
    path = Path(path)
    try:
        with path.open("rb") as stream:
            is_mcap = stream.read(len(MAGIC)) == MAGIC
        if not is_mcap:
            return None
        content = _content(path)
    except OSError as error:
        raise RequestError(f"cannot read {path}: {error.strerror}. Give a .mcap file that `alula fly` wrote.") from None
    return _flight(path, content) if content.rows else None


def require_followed(path: str | Path) -> FollowedFlight:
    """Followed parameters of a recording. Raises DataError, too, for a log whose model did not follow."""
    followed = read_followed(path)
    if followed is None:
        raise DataError(
            f"{path} is no recording of a flight whose model followed. Fly with --adapt shadow or --adapt on and "
            "--record; `alula add` without --from-flight fits effects on any log."
        )
    return followed


@dataclass
class _Content:
    """Messages of a recording about followed parameters. start: of the first tick, s of the daemon's clock."""

    rows: list[_Followed]
    phases: list[_Timed]
    setpoints: list[_Setpoint]
    start: float | None = None
    vehicle: str = ""
    mode: str = ""


def _content(path: Path) -> _Content:
    content, topics = _Content([], [], []), dict[int, str]()
    for part in _parts(path):
        match part:
            case Channel():
                topics[part.id] = part.topic
            case Message():
                _add(content, topics.get(part.channel_id, ""), part.data)
            case Metadata() if part.name == "alula":
                content.mode = _mode(part.metadata)
            case Attachment() if part.name == VEHICLE_TEXT:
                content.vehicle = part.data.decode()
            case _:
                pass
    return content


def _add(content: _Content, topic: str, data: bytes) -> None:
    """Add a message; one that cannot be decoded is left out, as the reader of logs does."""
    try:
        if topic == FOLLOWED:
            row = decode_json(data, _Followed)
            if len(row.names.split()) == len(row.value) == len(row.deviation):
                content.rows.append(row)
        elif topic == PHASE:
            content.phases.append(decode_json(data, _Timed))
        elif topic == SETPOINT:
            content.setpoints.append(decode_json(data, _Setpoint))
        elif topic == OBSERVATION and content.start is None:
            content.start = decode_json(data, _Timed).time
    except (msgspec.MsgspecError, UnicodeDecodeError):
        return


def _mode(metadata: Mapping[str, str]) -> str:
    try:
        return decode_json(metadata.get("controller", "{}"), _Controller).adaptation.mode
    except (msgspec.MsgspecError, UnicodeDecodeError):
        return ""


def _parts(path: Path) -> Iterator[McapRecord]:
    """Records up to the file's end or to where it is cut off."""
    with path.open("rb") as stream:
        try:
            for part in StreamReader(stream, emit_chunks=True).records:
                yield from records_of(part, path) if isinstance(part, Chunk) else [part]
        except TORN:
            return


def _flight(path: Path, content: _Content) -> FollowedFlight:
    rows = content.rows
    names = tuple(dict.fromkeys(name for row in rows for name in row.names.split()))
    value, deviation = (np.full((len(rows), len(names)), np.nan) for _ in range(2))
    places = {name: place for place, name in enumerate(names)}
    for i, row in enumerate(rows):
        own = [places[name] for name in row.names.split()]
        value[i, own], deviation[i, own] = _floats(row.value), _floats(row.deviation)
    stamps = np.array([row.time for row in rows])
    parts = [[_floats(getattr(row, field)) for row in rows] for field in ("staying", "fading", "trust")]
    return FollowedFlight(
        path=path,
        sha256=sha256(path),
        vehicle=content.vehicle,
        mode=content.mode,
        time=stamps - (stamps[0] if content.start is None else content.start),
        names=names,
        value=value,
        deviation=deviation,
        disturbance=np.array(parts[0]) + np.array(parts[1]),
        trust=np.array(parts[2]),
        effectiveness=_effectiveness(stamps, content.setpoints),
        effectiveness_deviation=_floats([row.effectiveness_deviation for row in rows]),
        tracked=_tracked(stamps, content.phases),
        network=np.array([_network(row) for row in rows]),
    )


def _network(row: _Followed) -> Floats:
    """(5,) of a row; NaN in one of an older version."""
    values = _floats([*row.network_change, *row.network_errors])
    return values if len(values) == NETWORK_VALUES else np.full(NETWORK_VALUES, np.nan)


def _effectiveness(stamps: Floats, setpoints: list[_Setpoint]) -> Floats:
    """(n,) of the last setpoint at each stamp."""
    values = _floats([np.nan, *(setpoint.effectiveness for setpoint in setpoints)])
    return values[np.searchsorted([setpoint.time for setpoint in setpoints], stamps, side="right")]


def _tracked(stamps: Floats, phases: list[_Timed]) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
    tracked = np.zeros(len(stamps), dtype=bool)
    ends = [phase.time for phase in phases[1:]] + [np.inf]
    for phase, end in zip(phases, ends, strict=False):
        if phase.phase == TRACKED:
            tracked |= (stamps >= phase.time) & (stamps < end)
    return tracked


def _floats(numbers: Numbers) -> Floats:
    return np.array([np.nan if number is None else number for number in numbers], dtype=float)
