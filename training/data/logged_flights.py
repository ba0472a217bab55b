"""Flights to learn from: reading logs, and setting some aside for validation."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from pyarrow import ArrowException
from pyarrow import parquet as pa_parquet

from dynamics.errors import DataError, RequestError
from dynamics.references.campaign import paper_campaign
from flights.aligned import read_aligned
from flights.exclusion import free_flight
from flights.flight import Flight
from flights.folder import CAMPAIGN, folder_content
from flights.hold_out import cuts_in_time, matching
from flights.source import sha256
from flights.tables import decode_notes

VALIDATION_SHARE = 0.1
VALIDATION_TIME_SHARE = 0.2  # of the only flight
MIN_SEGMENT = 1.0  # s; shorter segments are not used
SIMULATED = "alula.lockstep"  # reader in the notes of a campaign's flights
TEST_FLIGHTS = frozenset(flight.name for flight in paper_campaign() if flight.split == "test")


@dataclass(frozen=True, eq=False)
class LoggedFlight:
    """One flight's segments of free flight without a gap, all at one rate. name: of its file (`names_of`)."""

    name: str
    sha256: str
    segments: tuple[Flight, ...]

    @property
    def rows(self) -> int:
        """Rows in all segments."""
        return sum(len(segment) for segment in self.segments)


@dataclass(frozen=True, eq=False)
class Split:
    """Flights by their use.

    training: to learn from.
    validation: to choose the best step by.
    notes: what the user should know.
    """

    training: tuple[LoggedFlight, ...]
    validation: tuple[LoggedFlight, ...]
    notes: tuple[str, ...]


def find_logs(paths: Sequence[str | Path], mapping: str | Path | None = None) -> tuple[Path, ...]:
    """Files as they are, the training flights of a campaign's folder, all logs below any other folder.

    mapping: column mapping (TOML) of tables. Raises RequestError for what is not there.
    """
    logs: list[Path] = []
    for path in map(Path, paths):
        if not path.is_dir():
            logs.append(path)
            continue
        inside = folder_content(path, mapping).logs
        if not inside:
            raise RequestError(f"{path} holds no logs. Give logs, a folder of logs, or a campaign's folder.")
        logs += inside
    if not logs:
        raise RequestError("no log was given. Give logs, a folder of logs, or a campaign's folder.")
    return tuple(logs)


def read_logged_flights(
    paths: Sequence[Path], *, dt: float, mapping: Path | None = None, may_be_tests: bool = False
) -> tuple[LoggedFlight, ...]:
    """Flights with a row every dt seconds. Time stamps of streams are aligned, except a campaign's, which are exact.

    may_be_tests: whether the campaign's test flights may be among them, which no training may use. Raises
    RequestError for test flights and for what cannot be found, DataError for logs without free flight.
    """
    if not may_be_tests:
        _require_no_tests(paths)
    named_paths = zip(names_of(paths), paths, strict=True)
    flights = [_read(name, path, 1 / dt, mapping) for name, path in named_paths]
    flown = [flight for flight in flights if flight.segments]
    if not flown:
        raise DataError(
            f"{', '.join(path.name for path in paths[:3])}: nowhere {MIN_SEGMENT:g} s of free flight without a gap. "
            "`alula inspect` lists what each log lacks."
        )
    same: dict[str, str] = {}
    for flight in flown:
        if flight.sha256 in same:
            raise RequestError(f"{flight.name} and {same[flight.sha256]} are the same flight. Give it once.")
        same[flight.sha256] = flight.name
    return tuple(flown)


def names_of(paths: Sequence[Path]) -> tuple[str, ...]:
    """Names of flights: their files' names, or with folders as well where several have the same name."""
    names = [path.name for path in paths]
    return tuple(name if names.count(name) == 1 else str(path) for name, path in zip(names, paths, strict=True))


def left_out(paths: Sequence[Path], flights: Sequence[LoggedFlight]) -> tuple[str, ...]:
    """A note on the logs from which `read_logged_flights` took nothing."""
    read = {flight.name for flight in flights}
    missing = [name for name in names_of(paths) if name not in read]
    if not missing:
        return ()
    return (f"left out, nowhere {MIN_SEGMENT:g} s of free flight without a gap: {', '.join(missing)}",)


def _require_no_tests(paths: Sequence[Path]) -> None:
    """Refuse the campaign's test flights by name, and copies of them by the name in their notes or their content."""
    tests = [path.name for path in paths if path.stem in TEST_FLIGHTS]
    if tests:
        raise RequestError(
            f"{', '.join(tests)}: test flights of the campaign, on which models are compared. Leave them out of "
            "training (give the campaign's folder or its train/); a flight of yours with such a name: rename it."
        )
    campaigns = {folder for path in paths if (folder := path.resolve().parent.parent / CAMPAIGN).exists()}
    tests_by_hash = {sha256(test): test for file in campaigns for test in sorted((file.parent / "test").glob("*.*"))}
    for path in paths:
        original = _recorded_as(path)
        if original is None and tests_by_hash and path.is_file():
            same = tests_by_hash.get(sha256(path))
            original = None if same is None else same.stem
        if original in TEST_FLIGHTS:
            raise RequestError(
                f"{path} is a copy of the campaign's test flight {original}, on which models are compared. Leave it "
                "out of training."
            )


def _recorded_as(path: Path) -> str | None:
    """The name under which a campaign flew a Parquet table, None for any other file."""
    try:
        notes = decode_notes(pa_parquet.read_schema(path).metadata) if path.suffix == ".parquet" else None
    except (OSError, ArrowException):
        return None  # reading it will report the error
    return Path(notes.provenance.path).name if notes is not None and notes.provenance.reader == SIMULATED else None


def split_flights(
    flights: Sequence[LoggedFlight], *, validation: str | None = None, hold_out: str | None = None
) -> Split:
    """Flights to learn from and to validate on. validation, hold_out: patterns of file names; hold_out is not used.

    Without a pattern every tenth flight validates, at least one; of a single flight its last fifth. Raises
    RequestError for a pattern that matches none or leaves none.
    """
    notes: list[str] = []
    remaining = list(flights)
    if hold_out is not None:
        places = matching([r.name for r in remaining], hold_out, option="--hold-out")
        out = [r for i, r in enumerate(remaining) if i in places]
        remaining = [r for i, r in enumerate(remaining) if i not in places]
        notes.append(f"held out, not looked at: {', '.join(r.name for r in out)}")
    if validation is not None:
        places = matching([r.name for r in remaining], validation, option="--validation")
        validating = [r for i, r in enumerate(remaining) if i in places]
        learned = [r for i, r in enumerate(remaining) if i not in places]
        return Split(tuple(learned), tuple(validating), tuple(notes))
    if len(remaining) == 1:
        notes.append(
            "one flight only: its last fifth validates, so errors on other flights are unknown. Fly more, and other "
            "manoeuvres."
        )
        first_part, last_part = _cut(remaining[0])
        return Split((first_part,), (last_part,), tuple(notes))
    count = max(1, round(VALIDATION_SHARE * len(remaining)))
    places = frozenset(round((i + 0.5) * len(remaining) / count) for i in range(count))
    validating = [r for i, r in enumerate(remaining) if i in places]
    return Split(tuple(r for r in remaining if r not in validating), tuple(validating), tuple(notes))


def _read(name: str, path: Path, rate: float, mapping: Path | None) -> LoggedFlight:
    if (path.parent.parent / CAMPAIGN).exists():
        flight = Flight.read(path, mapping=mapping, rate=rate)
        segments = free_flight(flight, shortest=MIN_SEGMENT)
    else:
        aligned = read_aligned(path, mapping=mapping, rate=rate)
        flight = aligned.flight
        segments = tuple(part for part in aligned.segments() if part.duration >= MIN_SEGMENT)
    return LoggedFlight(name, flight.provenance.sha256, segments)


def _cut(flight: LoggedFlight) -> tuple[LoggedFlight, LoggedFlight]:
    """The first four fifths of a flight's rows, and the rest."""
    cuts = cuts_in_time([len(segment) for segment in flight.segments], VALIDATION_TIME_SHARE)
    before: list[Flight] = []
    after: list[Flight] = []
    for segment, cut in zip(flight.segments, cuts, strict=True):
        before += [segment.rows(0, cut)] if cut else []
        after += [segment.rows(cut, len(segment))] if cut < len(segment) else []
    return tuple(dataclasses.replace(flight, segments=tuple(part)) for part in (before, after))  # type: ignore[return-value]
