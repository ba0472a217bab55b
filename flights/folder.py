"""The logs of a folder, and its files that are none: notes, vehicle files, results beside the logs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from dynamics.errors import AlulaError, DataError, RequestError
from flights import archive
from flights import mapping as mappings
from flights.mapping import Mapping
from flights.quantities import quantity_of
from flights.readers import dataflash, mapped_csv
from flights.readers.table_head import names_of
from flights.reading import logs_below, opened_log, sniff
from flights.source import opened
from flights.tables import TIME

CAMPAIGN, TRAINING_FLIGHTS = (
    "campaign.json",
    "train",
)  # a campaign's recipe, and the folder of its flights to learn from
# By such a name an empty file is a damaged log, not something else.
LOGGED = (".ulg", ".ulge", ".mcap", ".bag", ".db3", ".bin", ".bbl", ".bfl", ".tlog")  # names that nothing else has
SUFFIXES = (*LOGGED, ".csv", ".parquet", ".log")


@dataclass(frozen=True)
class FolderContent:
    """Files below a folder. logs: in the order of their names. others: files that are no logs."""

    logs: tuple[Path, ...]
    others: tuple[Path, ...]


def folder_content(folder: Path, mapping: str | Path | None = None) -> FolderContent:
    """The logs below a folder; of a campaign's folder its training flights.

    A tlog beside a recording of the same name holds the same flight and is left out. A log that is damaged is a log.
    mapping: column mapping (TOML) of its tables. Raises RequestError for a folder or a mapping that cannot be read.
    """
    columns = None
    if mapping is not None and mappings.read_repairs(Path(mapping))[0]:
        columns = mappings.read_mapping(Path(mapping))
    is_campaign = (folder / CAMPAIGN).is_file() and (folder / TRAINING_FLIGHTS).is_dir()
    try:
        files = list(logs_below(folder / TRAINING_FLIGHTS if is_campaign else folder))
    except OSError as error:
        place = error.filename or folder
        raise RequestError(
            f"cannot read the folder {place}: {error.strerror or error}. Give one that can be read."
        ) from error
    files = [file for file in files if not (file.suffix == ".tlog" and file.with_suffix(".mcap").exists())]
    logs = tuple(file for file in files if is_log(file, columns))
    return FolderContent(logs, tuple(file for file in files if file not in set(logs)))


def is_log(path: Path, mapping: Mapping | None = None) -> bool:
    """Whether a file is a log of a known format, whole or damaged, or a table of the mapping's columns."""
    try:
        with opened_log(path) as source:
            if mapping is not None and mapped_csv.has_columns(source, mapping):
                return True
            sniff(source)
            return True
    except DataError:
        *inner, outer = [suffix.lower() for suffix in path.suffixes] or [""]
        return outer in (*SUFFIXES, ".gz") or (outer == ".zip" and bool(inner) and inner[-1] in SUFFIXES)
    except archive.SeveralLogsError:
        return True
    except RequestError:
        return _is_readable(path) is False or _needs_advice(path)


def _needs_advice(path: Path) -> bool:
    """Whether a file is a log in a form that is not read: ArduPilot's as text, or a table of a flight's columns."""
    try:
        with opened(path) as source:
            if dataflash.is_text(source):
                return True
            line = source.first_line()
    except AlulaError:
        return False
    names: Sequence[str] = max((names_of(line, separator) for separator in ",;\t"), key=len)
    return TIME in names and any(quantity_of(name) is not None for name in names)


def _is_readable(path: Path) -> bool:
    try:
        with path.open("rb"):
            return True
    except IsADirectoryError:
        return True
    except OSError:
        return False
