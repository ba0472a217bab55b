"""The results of a fleet on disk: a JSON line a flight, written when it is done, and a Parquet table at the end."""

from __future__ import annotations

import errno
import fcntl
import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import msgspec
import pyarrow as pa
import pyarrow.parquet as pq

from diagnosis.models.channels import KINDS
from dynamics.decoding import decode_json
from dynamics.errors import RequestError
from dynamics.files import make_folder, write_answer, write_whole
from studies.fleet.files import ABOUT, LINES, LOCK, TABLE, FleetAbout
from studies.fleet.flight import FleetFlight

ADVICE = "Free some space or give another --out; the same command goes on where this one stood."


class FleetStore:
    """The lines of a fleet in a folder, the newest one of each log. One run at a time writes them."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.file = folder, folder / LINES
        self.flights: dict[str, FleetFlight] = {}

    @contextmanager
    def opened(self) -> Iterator[FleetStore]:
        """Read the lines of earlier runs and hold the folder against other runs.

        Raises RequestError for a folder that cannot be written or that another run holds.
        """
        make_folder(self.folder, advice="Give another --out.")
        try:
            lock = (self.folder / LOCK).open("w")
        except OSError as error:
            raise self._unwritable(error) from error
        with lock:
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError as error:
                raise RequestError(
                    f"another run writes to {self.folder}. Wait for its end, or give another --out."
                ) from error
            self._load()
            yield self

    def append(self, flight: FleetFlight) -> None:
        """Write a line, whole or not at all. Raises RequestError when the disk does not take it."""
        line = _line(flight)
        try:
            descriptor = os.open(self.file, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o666)
            try:
                before = os.fstat(descriptor).st_size
                try:
                    _write_all(descriptor, line)
                except OSError:
                    os.ftruncate(descriptor, before)
                    raise
            finally:
                os.close(descriptor)
        except OSError as error:
            raise self._unwritable(error) from error
        self.flights[flight.log] = flight

    def write_about(self, folder: Path, count: int) -> None:
        """Write what the lines are of. Raises RequestError when it cannot be written."""
        write_answer(FleetAbout(str(folder.resolve()), count), self.folder / ABOUT)

    def drop(self, logs: Sequence[str]) -> None:
        """Remove the lines of logs, whose files or settings have changed. Raises RequestError as `append`."""
        if not logs:
            return
        for log in logs:
            del self.flights[log]
        self._rewrite()

    def write_table(self, flights: Sequence[FleetFlight]) -> Path:
        """Write flights as Parquet. Raises RequestError when it cannot be written."""
        table = fleet_table(flights)
        return write_whole(self.folder / TABLE, lambda part: pq.write_table(table, part), advice=ADVICE)

    def _load(self) -> None:
        """Read the lines; those that a killed run left torn, damaged ones and outdated ones are removed."""
        try:
            text = self.file.read_bytes()
        except FileNotFoundError:
            return
        except OSError as error:
            raise RequestError(f"cannot read {self.file}: {error.strerror or error}. Give another --out.") from error
        self.flights = _flights_of(text)
        if b"\n" in text and not self.flights:
            raise RequestError(f"{self.file} holds no flight of a fleet. Delete it, or give another --out.")
        if text != self._text():
            self._rewrite()

    def _text(self) -> bytes:
        return b"".join(map(_line, self.flights.values()))

    def _rewrite(self) -> None:
        write_whole(self.file, lambda part: part.write_bytes(self._text()), advice=ADVICE)

    def _unwritable(self, error: OSError) -> RequestError:
        return RequestError(f"cannot write {self.file}: {error.strerror or error}. {ADVICE}")


def _write_all(descriptor: int, line: bytes) -> None:
    """Write a line in one piece and wait for the disk. Raises OSError when it takes less."""
    if os.write(descriptor, line) < len(line):
        raise OSError(errno.ENOSPC, "the disk is full")
    os.fsync(descriptor)


def read_flights(folder: Path) -> tuple[FleetFlight, ...]:
    """The lines of a fleet's results, also of a run that writes them now. Raises RequestError where there are none."""
    try:
        flights = _flights_of((folder / LINES).read_bytes())
    except OSError:
        flights = {}
    if not flights:
        raise RequestError(f"{folder} holds no {LINES}. Give the --out of alula diagnose --fleet.")
    return tuple(flights.values())


def _flights_of(text: bytes) -> dict[str, FleetFlight]:
    """The newest whole line of each log."""
    flights: dict[str, FleetFlight] = {}
    for line in text.split(b"\n"):
        try:
            flight = decode_json(line, FleetFlight)
        except (msgspec.MsgspecError, UnicodeDecodeError):
            continue
        flights.pop(flight.log, None)
        flights[flight.log] = flight
    return flights


def _line(flight: FleetFlight) -> bytes:
    """A line that reads back as the same flight: numbers that are not finite have no JSON."""
    line = msgspec.json.encode(flight)
    try:
        decode_json(line, FleetFlight)
    except msgspec.ValidationError:
        failed = msgspec.structs.replace(
            flight, status="failed", verdict="", sentence="", effects=(), channels={}, error="the fit is not finite."
        )
        line = msgspec.json.encode(failed)
    return line + b"\n"


_PARAMETER = pa.struct(
    [("name", pa.string()), ("value", pa.float64()), ("std", pa.float64()), ("low", pa.float64()),
     ("high", pa.float64()), ("unit", pa.string())]
)  # fmt: skip
_EFFECT = pa.struct(
    [("name", pa.string()), ("rotor", pa.int32()), ("confidence", pa.float64()),
     ("ambiguous_with", pa.list_(pa.string())), ("parameters", pa.list_(_PARAMETER))]
)  # fmt: skip
_TEXTS = (
    "log", "status", "sha256", "settings", "vehicle", "vehicle_file", "airframe", "date", "date_from", "inspection",
    "inspected", "verdict", "sentence", "next_flight", "worker", "error",
)  # fmt: skip
_NUMBERS = ("duration", "free_flight", "seconds")
_ERRORS = ("before", "after", "floor", "over_floor")
SCHEMA = pa.schema(
    [
        *((name, pa.string()) for name in _TEXTS),
        *((name, pa.float64()) for name in _NUMBERS),
        ("size", pa.int64()),
        ("modified", pa.int64()),
        ("effects", pa.list_(_EFFECT)),
        *((f"{kind}_{name}", pa.float64()) for kind in KINDS for name in _ERRORS),
        *((f"{kind}_unit", pa.string()) for kind in KINDS),
    ]
)


def fleet_table(flights: Sequence[FleetFlight]) -> pa.Table:
    """Flights as an Arrow table: a row a flight, columns for each kind of channel, null where there is no value."""
    return pa.Table.from_pylist([_row(flight) for flight in flights], schema=SCHEMA)


def _row(flight: FleetFlight) -> Mapping[str, Any]:
    row = {name: getattr(flight, name) for name in (*_TEXTS, *_NUMBERS, "size", "modified")}
    row["effects"] = [
        {
            "name": effect.name,
            "rotor": effect.rotor,
            "confidence": effect.confidence,
            "ambiguous_with": effect.ambiguous_with,
            "parameters": [{"name": name, **msgspec.structs.asdict(p)} for name, p in effect.parameters.items()],
        }
        for effect in flight.effects
    ]
    for kind, channel in flight.channels.items():
        row |= {f"{kind}_{name}": getattr(channel, name) for name in (*_ERRORS, "unit")}
    return row
