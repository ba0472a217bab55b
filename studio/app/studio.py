"""The cases that a server has open, and where new ones are made."""

from __future__ import annotations

import hashlib
import os
import threading
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from dynamics.files import make_folder
from studio.app.opened import OpenCase
from studio.app.replays import Replays
from studio.case.archive import unpack_archive
from studio.case.case import Case, is_case
from studio.case.state_file import ADVICE
from studio.example import NAME, VEHICLE, example_logs
from studio.pages.shown import ResultReader
from studio.work.worker import Worker

MAX_WORKERS = 2  # of all cases, beside the one that waits; each holds a case's flights
SPARE_DELAY = 8.0  # s


@dataclass(frozen=True)
class CaseEntry:
    """A case of the list on the first page. changed: s since the epoch."""

    folder: Path
    name: str
    changed: float


class Studio:
    """Cases by the short names that their pages' addresses have.

    root: folder in which new cases are made.
    reader: of results that lie on disk.
    memory: bytes that a working process may take, None for a share of all.
    results: paths of the results that were opened, by their names in addresses.
    replays: of recordings among them.
    """

    def __init__(self, root: Path, reader: ResultReader, *, memory: int | None = None) -> None:
        self.root, self.reader = root, reader
        self._memory = memory
        self._cases: dict[str, OpenCase] = {}
        self._lock = threading.Lock()
        self._closed = False
        self.results: dict[str, Path] = {}
        self.replays = Replays()
        self._spare: Worker | None = Worker(memory)  # has loaded its libraries when the first case needs it

    def open(self, folder: Path, *, logs: Sequence[Path] = (), mapping: Path | None = None) -> str:
        """Open the case of a folder, or find it open. Returns its name in addresses.

        logs, mapping: see `Case.open`. Raises RequestError.
        """
        name = name_of(folder)
        with self._lock:
            if name not in self._cases:
                self._cases[name] = OpenCase(Case.open(folder, logs=logs, mapping=mapping), self._worker)
        return name

    def create(self, folder: Path | None = None, *, name: str = "") -> str:
        """Make a case, by default in the root. Returns its name in addresses. Raises RequestError."""
        folder = folder or self._free_folder(name or "case")
        case = Case.create(folder, name=name)
        with self._lock:
            self._cases[name_of(folder)] = OpenCase(case, self._worker)
        return name_of(folder)

    def open_example(self) -> str:
        """Make a case with the bundled logs and their vehicle, and begin to read it. Returns its name in addresses."""
        name = self.create(name=NAME)
        opened = self._cases[name]
        opened.case.add_logs(example_logs())
        opened.case.set_vehicle(VEHICLE)
        opened.start("check")
        return name

    def open_result(self, path: Path) -> str:
        """Open a result that lies on disk. Returns its name in addresses. Raises RequestError for what is none."""
        path = path.expanduser().resolve()
        self.reader.stamp(path)
        self.results[name_of(path)] = path
        return name_of(path)

    def unpack(self, archive: Path, name: str) -> str:
        """Make a case of an archive. Returns its name in addresses. Raises RequestError for one that holds none."""
        folder = unpack_archive(archive, self._free_folder(name))
        return self.open(folder)

    def case(self, name: str) -> OpenCase | None:
        """An open case; one of the root that is not open yet is opened. None where there is none."""
        if name in self._cases:
            return self._cases[name]
        for entry in self.entries():
            if name_of(entry.folder) == name:
                return self._cases[self.open(entry.folder)]
        return None

    def entries(self) -> list[CaseEntry]:
        """The cases of the root and those that are open, the newest first."""
        folders = {p for p in self.root.iterdir() if p.is_dir() and is_case(p)} if self.root.is_dir() else set()
        folders = {p.resolve() for p in folders} | {o.case.folder for o in self._cases.values()}
        entries = [CaseEntry(f, f.name, (f / "case.json").stat().st_mtime) for f in folders if is_case(f)]
        return sorted(entries, key=lambda entry: -entry.changed)

    def close(self) -> None:
        """End all work and close all cases."""
        with self._lock:
            self._closed = True
        for opened in self._cases.values():
            opened.close()
        self._cases.clear()
        self.replays.close()
        if self._spare is not None:
            self._spare.close()

    def _worker(self) -> Worker:
        """A process for a case: the one that waits, with another one to wait in its place."""
        with self._lock:
            worker, self._spare = self._spare, None
            idle = [opened for opened in self._cases.values() if opened.has_idle_worker]
        for opened in idle[: max(0, len(idle) + 1 - MAX_WORKERS)]:
            opened.release()
        timer = threading.Timer(SPARE_DELAY, self._prepare)  # not beside the first work of this one
        timer.daemon = True
        timer.start()
        return worker or Worker(self._memory)

    def _prepare(self) -> None:
        """Have a process ready for the next case."""
        with self._lock:
            if self._spare is None and not self._closed:
                self._spare = Worker(self._memory)

    def _free_folder(self, name: str) -> Path:
        make_folder(self.root, advice=ADVICE)
        words = "".join(c if c.isalnum() or c in "-_." else "_" for c in name).strip(".") or "case"
        folder, number = self.root / words, 1
        while folder.exists():
            number += 1
            folder = self.root / f"{words}_{number}"
        return folder


def name_of(folder: Path) -> str:
    """A case's name in addresses."""
    return hashlib.sha256(str(folder.resolve()).encode()).hexdigest()[:10]


def default_root() -> Path:
    """Where cases are made unless a folder is given: as the XDG base directories say."""
    return Path(os.environ.get("XDG_DATA_HOME") or Path.home() / ".local" / "share") / "alula" / "cases"
