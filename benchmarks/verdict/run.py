"""A run of the judge: its folder of answers, one JSON a case, which a later run goes on with."""

from __future__ import annotations

import datetime
import hashlib
import subprocess
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import msgspec

from benchmarks.verdict.asking import ask, killed
from benchmarks.verdict.cases import Case
from benchmarks.verdict.posing import TOGETHER
from benchmarks.verdict.record import Record
from dynamics.decoding import decode_json
from dynamics.errors import RequestError
from dynamics.files import make_folder, write_json
from flights.parallel import parallel_map

ROOT = Path(__file__).parents[2]
RUN = "run.json"
FLOWN_TOGETHER = 16  # cases
JUDGED = ("alula", "diagnosis", "dynamics", "flights", "fixtures", "vehicles")  # rooms that decide an answer
SOURCES = (".py", ".c", ".h", ".toml")


class Run(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The questions of a run, and the code that answers them.

    sets, first, limit: as the command has them. commit: of the repository. code: hash of the rooms that decide.
    """

    sets: tuple[str, ...]
    first: int
    limit: int | None
    commit: str
    code: str
    date: str

    @classmethod
    def begun(cls, sets: Sequence[str], first: int, limit: int | None) -> Run:
        """A run that begins now."""
        return cls(tuple(sets), first, limit, commit(), code(), datetime.date.today().isoformat())


def write_run(run: Run, folder: Path) -> None:
    """Begin a folder. Raises RequestError where it cannot be written or holds another run."""
    make_folder(folder, advice="Give another folder.")
    if (folder / RUN).exists():
        raise RequestError(f"{folder} holds a run already. Go on with --resume {folder}, or give another folder.")
    write_json(run, folder / RUN)


def read_run(folder: Path) -> Run:
    """The run of a folder. Raises RequestError where there is none."""
    if not (folder / RUN).exists():
        raise RequestError(f"{folder} holds no run: {RUN} is missing. Leave --resume out to begin one.")
    return decode_json((folder / RUN).read_bytes(), Run)


def finished(cases: Sequence[Case], folder: Path) -> dict[str, Record]:
    """Records that a folder has of these cases, by key."""
    files = {case.key: folder / f"{case.key}.json" for case in cases}
    return {key: decode_json(file.read_bytes(), Record) for key, file in files.items() if file.exists()}


def answer(
    cases: Sequence[Case], run: Run, folder: Path, *, processes: int, note: Callable[[Record], None]
) -> list[Record]:
    """Records of all cases in their order; asked are those that the folder lacks, each kept once it is answered.

    note: called with each record as it is made. Raises RequestError where the code is no more the run's.
    """
    done = finished(cases, folder)
    absent = [case for case in cases if case.key not in done]
    if absent and run.code != code():
        raise RequestError(
            f"{folder} has answers of commit {run.commit}, and the code has changed since. Begin another run, or go "
            "back to that commit."
        )
    for _ in parallel_map(fly, _companies(absent), jobs=processes, killed=_unflown):
        pass
    for place, record in parallel_map(ask, absent, jobs=processes, killed=killed):
        write_json(record, folder / f"{absent[place].key}.json")
        done[absent[place].key] = record
        note(record)
    return [done[case.key] for case in cases]


def fly(company: Sequence[Case]) -> None:
    """Fly cases of one source side by side; their flights are on the disk then."""
    TOGETHER[company[0].entry.source](company)


def _unflown(_: Sequence[Case]) -> None:
    """Each is flown by itself when it is asked."""


def _companies(cases: Sequence[Case]) -> list[list[Case]]:
    """Cases that are flown side by side."""
    by_source: dict[str, list[Case]] = defaultdict(list)
    for case in cases:
        if case.entry.source in TOGETHER:
            by_source[case.entry.source].append(case)
    return [some[i : i + FLOWN_TOGETHER] for some in by_source.values() for i in range(0, len(some), FLOWN_TOGETHER)]


def commit() -> str:
    """The repository's commit, with "+" where files differ from it."""
    try:
        name = _git("rev-parse", "--short", "HEAD")
        return f"{name}+" if _git("status", "--porcelain", "--untracked-files=no") else name
    except (OSError, subprocess.CalledProcessError):
        return "unknown"


def _git(*arguments: str) -> str:
    return subprocess.check_output(["git", *arguments], cwd=ROOT, text=True, stderr=subprocess.DEVNULL).strip()


def code() -> str:
    """Hash of the sources that decide an answer."""
    digest = hashlib.sha256()
    for path in _sources():
        digest.update(path.relative_to(ROOT).as_posix().encode() + b"\0" + path.read_bytes())
    return digest.hexdigest()[:16]


def _sources() -> Iterator[Path]:
    for room in JUDGED:
        yield from sorted(path for path in (ROOT / room).rglob("*") if path.suffix in SOURCES)
