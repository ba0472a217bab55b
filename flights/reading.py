"""Reading of logs of any format; the format is detected by content, never by the file's name."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from dynamics.errors import AlulaError, DataError, RequestError
from flights import archive, pose_source
from flights.events import Event
from flights.hypotheses import Hypothesis, explain, in_words
from flights.log import Log, LogContent, Provenance, Stream
from flights.mapping import read_mapping, read_repairs
from flights.readers import (
    betaflight,
    blackbox_csv,
    crazyflie,
    crazyflie_csv,
    csv,
    dataflash,
    mapped_csv,
    mcap,
    parquet,
    rosbag,
    tlog,
    ulog,
)
from flights.readers.table_head import table_head
from flights.source import Source, TimeSpan, opened, sha256
from flights.stream_repair import TIME, StreamRepair, repaired


@dataclass(frozen=True)
class Format:
    """A format of logs.

    declares_frames: whether its specification fixes units and frames; else a contradiction refuses the log.
    reads_spans: whether its reader can read a span of a file; the others hold all of a flight's quantities.
    """

    label: str
    matches: Callable[[Source], bool]
    read: Callable[[Source], LogContent]
    declares_frames: bool
    reads_spans: bool = True


# In the order of detection: formats with a signature first, text last; of a table all columns of a shipped mapping say
# more than a few names that the flight CSV has too.
FORMATS: Mapping[str, Format] = {
    "ulog": Format("PX4 ULog", ulog.matches, ulog.read, True, reads_spans=False),
    "mcap": Format("Alula's recording (MCAP)", mcap.matches, mcap.read, True),
    "rosbag": Format("ROS bag", rosbag.matches, rosbag.read, False),
    "blackbox_csv": Format("Betaflight blackbox CSV", blackbox_csv.matches, blackbox_csv.read, True, reads_spans=False),
    "mapped_csv": Format("CSV or Parquet with a column mapping", mapped_csv.matches, mapped_csv.read, False),
    "parquet": Format("Parquet flight table", parquet.matches, parquet.read, False),
    "crazyflie_csv": Format("CSV of Crazyflie log variables", crazyflie_csv.matches, crazyflie_csv.read, True),
    "crazyflie": Format("Crazyflie micro-SD log", crazyflie.matches, crazyflie.read, True),
    "dataflash": Format("ArduPilot DataFlash log", dataflash.matches, dataflash.read, True, reads_spans=False),
    "betaflight": Format("Betaflight blackbox log", betaflight.matches, betaflight.read, True, reads_spans=False),
    "tlog": Format("MAVLink tlog", tlog.matches, tlog.read, True),
    "csv": Format("flight CSV", csv.matches, csv.read, False),
}


class ContradictedLogError(DataError):
    """A log whose columns are not what they declare. hypotheses: about what they are, with repairs."""

    def __init__(self, message: str, hypotheses: tuple[Hypothesis, ...] = ()) -> None:
        super().__init__(message)
        self.hypotheses = hypotheses


def read_log(path: str | Path, *, mapping: str | Path | None = None, pose: str | None = None) -> Log:
    """The streams of any log, gzipped or not.

    mapping: column-mapping TOML for a foreign CSV.
    pose: where the pose comes from, "mocap" or "estimator"; by default as the log tells.

    Raises RequestError for a path, mapping or pose that is wrong or an unknown format, DataError for a log that cannot
    be read or contradicts its units and frames.
    """
    path, divided = Path(path), _divided(mapping)
    with opened_log(path, divided.columns) as source:
        name = _format_name(source)
        content = repaired(_read(source, name), divided.repairs)
        log = _checked_log(source, name, sha256(path), content)
    return replace(log, metadata=pose_source.with_source(log.metadata, pose))


def found_hypotheses(path: str | Path, *, mapping: str | Path | None = None) -> tuple[Hypothesis, ...]:
    """Hypotheses about the columns of a log, with their repairs; also of one that `read_log` refuses for them.

    mapping: column-mapping TOML. Raises what `read_log` raises, but for contradictions of units and frames.
    """
    path, divided = Path(path), _divided(mapping)
    with opened_log(path, divided.columns) as source:
        content = repaired(_read(source, _format_name(source)), divided.repairs)
    return explain(content.streams)


@dataclass(frozen=True)
class _Divided:
    """A mapping file as the readers need it: the mapping of columns, if it has one, and the repairs of streams."""

    columns: Path | None
    repairs: tuple[StreamRepair, ...]


def _divided(mapping: str | Path | None) -> _Divided:
    if mapping is None:
        return _Divided(None, ())
    maps_columns, repairs = read_repairs(Path(mapping))
    return _Divided(Path(mapping) if maps_columns else None, repairs)


def read_chunks(path: str | Path, seconds: float, *, mapping: str | Path | None = None) -> Iterator[Log]:
    """A log that is larger than memory as consecutive logs of so many seconds; chunks without data are skipped.

    The file is read once, and only one chunk of it is held; of a ULog and a DataFlash log all of the flight's own
    quantities are held, which are a small part of the file.

    Raises what `read_log` raises, and RequestError for seconds that are not positive.
    """
    if not seconds > 0:
        raise RequestError(f"a chunk cannot last {seconds} s; give a positive number of seconds.")
    path, divided = Path(path), _divided(mapping)
    with opened_log(path, divided.columns) as source:
        name, digest = _format_name(source), sha256(path)
        content = None if FORMATS[name].reads_spans else _read(source, name)
        span = TimeSpan(0.0, seconds)
        while True:
            chunk = _read(replace(source, span=span), name) if content is None else _cut(content, span)
            if chunk.streams or not (span.start or span.more):
                there = {stream.name for stream in chunk.streams} | {TIME}
                repairs = [repair for repair in divided.repairs if repair.quantity in there]
                yield _checked_log(source, name, digest, repaired(chunk, repairs))
            if not span.more:
                return
            span = span.next(seconds)


@contextmanager
def opened_log(path: Path, mapping: Path | None = None) -> Iterator[Source]:
    """The log at a path, while the block lasts; of a zip file the one log in it.

    Raises RequestError and DataError as `opened` does, SeveralLogsError for a zip file with several logs.
    """
    if not archive.is_zip(path):
        with opened(path, mapping) as source:
            yield source
        return
    with tempfile.TemporaryDirectory(prefix="alula-") as name:
        folder = Path(name)
        archive.unpack(path, folder)
        files = list(logs_below(folder))
        logs = [file for file in files if not archive.is_zip(file) and _is_known(file, mapping)]
        log = archive.only_log(path, logs, [file for file in files if file not in logs], folder)
        with opened(log, mapping) as source:
            yield replace(source, path=path)


def _is_known(file: Path, mapping: Path | None) -> bool:
    """Whether an unpacked file is a log, or a table of the mapping's columns."""
    try:
        with opened(file) as source:
            if mapping is not None and mapped_csv.has_columns(source, read_mapping(mapping)):
                return True
            sniff(source)
            return True
    except DataError:
        return file.stat().st_size > 0
    except RequestError:
        return False


def _format_name(source: Source) -> str:
    return "mapped_csv" if source.mapping is not None else sniff(source)


def _read(source: Source, name: str) -> LogContent:
    try:
        with np.errstate(all="ignore"):  # numbers of damaged bytes; `Assembly` masks what is no value
            return FORMATS[name].read(source)
    except AlulaError as error:
        raise type(error)(_naming(source.path, str(error))) from error
    except OSError:
        raise
    except MemoryError as error:
        megabytes = source.path.stat().st_size / 1e6
        raise DataError(
            f"{source.path} ({megabytes:.0f} MB) is a {FORMATS[name].label}, and to read it whole needs more memory "
            "than there is. Give a shorter log, or more memory (in the studio: `alula studio --memory`). A small file "
            "that asks for so much is damaged."
        ) from error
    except Exception as error:  # third-party parsers; what damaged bytes make them raise is not documented
        raise DataError(
            f"{source.path} is a {FORMATS[name].label}, but so damaged that it cannot be read ({error!r})."
        ) from error


def _cut(content: LogContent, span: TimeSpan) -> LogContent:
    """A span of content whose time starts at 0; the result's time does so too."""
    rows_by_stream = [(stream, span.mask(stream.time)) for stream in content.streams]
    start = min((float(stream.time[rows][0]) for stream, rows in rows_by_stream if rows.any()), default=0.0)
    streams = tuple(
        Stream(stream.name, stream.time[rows] - start, stream.values[rows], stream.source)
        for stream, rows in rows_by_stream
        if rows.any()
    )
    events = tuple(Event(e.time - start, e.kind, e.text) for e in content.events if span.start <= e.time < span.end)
    return replace(content, streams=streams, start=content.start + start, events=events)


def _checked_log(source: Source, name: str, digest: str, content: LogContent) -> Log:
    """The log of a file's content. Raises DataError when it is empty or contradicts its units and frames."""
    form, path = FORMATS[name], source.path
    if not content.streams:
        remarks = " ".join((*content.notes, *map(str, content.unused)))
        raise DataError(f"{path} is a {form.label} without flight data. {remarks}".rstrip())
    notes = list(content.notes)
    hypotheses = explain(content.streams)
    if hypotheses and not form.declares_frames:
        raise ContradictedLogError(f"{path}: {in_words(hypotheses)}", hypotheses)
    notes += map(str, hypotheses)
    provenance = Provenance(
        str(path),
        digest,
        form.label,
        f"flights.readers.{name}",
        tuple(notes),
        source.repairs + content.repairs,
        content.unused,
        content.inferences,
    )
    metadata = {**content.metadata, pose_source.KEY: pose_source.known_source(name, content)}
    return Log(content.streams, provenance, content.start, metadata, content.parameters, content.events)


def read_folder(folder: str | Path) -> Iterator[tuple[Path, Log | AlulaError]]:
    """Every log below a folder in the order of names, each with its streams or the error that reading it raised.

    Raises RequestError when it is no folder.
    """
    root = Path(folder)
    if not root.is_dir():
        raise RequestError(f"{root} is no folder. Give a folder of logs.")
    for path in logs_below(root):
        try:
            yield path, read_log(path)
        except AlulaError as error:
            yield path, error


def sniff(source: Source) -> str:
    """The name of a log's format. Raises RequestError for an unknown format."""
    name = next((name for name, form in FORMATS.items() if form.matches(source)), None)
    if name is not None:
        return name
    labels = ", ".join(form.label for form in FORMATS.values())
    if source.is_folder:
        raise RequestError(
            f"{source.path} is a folder, and not a bag of ROS 2. Give one log (commands read a folder of logs as well)."
        )
    if dataflash.is_text(source):
        raise RequestError(
            f"{source.path} is an ArduPilot log as text (.log), made of the autopilot's own .bin file; it holds fewer "
            "digits and is not read. Give the .bin file: from the vehicle's card (APM/LOGS), or downloaded again by "
            "the ground station without the conversion to text."
        )
    columns = mapped_csv.header_of(source)
    if columns:
        raise RequestError(
            f"{source.path} is a text table, but its columns ({', '.join(columns[:8])}, ...) are neither those of the "
            "flight CSV nor those of a known mapping. Write a column-mapping TOML as in flights/mappings/ and "
            f"give it as mapping.{_advice_on_lists(source)}"
        )
    raise RequestError(f"{source.path} has no known log format: it begins with {source.head[:8]!r}. Known: {labels}.")


def _advice_on_lists(source: Source) -> str:
    """How a mapping names the numbers of a table whose cells are lists; empty for any other."""
    head = table_head(source)
    lists = [] if head is None else [name for name in head.names if any(c.startswith("[") for c in head.cells(name))]
    if not lists:
        return ""
    return f" The cells of {', '.join(lists[:8])} are lists: name their elements, as {lists[0]}[0], {lists[0]}[1]."


def logs_below(root: Path) -> Iterator[Path]:
    """Files below a folder, a ROS 2 bag's folder as one."""
    if rosbag.is_bag_folder(root):
        yield root
        return
    for path in sorted(root.iterdir()):
        if path.is_dir():
            yield from logs_below(path)
        elif not path.name.startswith("."):
            yield path


def _naming(path: Path, text: str) -> str:
    """An error's text, with the path in front where it does not name it."""
    return text if str(path) in text else f"{path}: {text}"
