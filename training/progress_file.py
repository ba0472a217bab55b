"""The course of a training on disk: a JSON line for each evaluation of a member, which pages read meanwhile."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import msgspec

from dynamics.decoding import decode_json
from dynamics.errors import RequestError
from training.reports import Report

SUFFIX = ".progress.jsonl"


class Beginning(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The first line: number of members, and the command."""

    members: int
    command: str


@dataclass(frozen=True)
class Course:
    """A training's course. reports: the last one of each member's step, in the order of writing."""

    beginning: Beginning
    reports: tuple[Report, ...]


def progress_file(model: Path) -> Path:
    """Where the course of a model's training is written: `pi_tcn.progress.jsonl` for `pi_tcn.pt`."""
    return model.with_suffix(SUFFIX)


def begin(path: Path, members: int, command: str, *, resume: bool) -> None:
    """Write the first line; a resumed training keeps its lines. Raises RequestError when it cannot be written."""
    if not (resume and path.is_file()):
        _write(path, Beginning(members, command), mode="wb")


def append(path: Path, report: Report) -> None:
    """Write a line. Raises RequestError when it cannot be written."""
    _write(path, report, mode="ab")


def read_course(path: Path) -> Course:
    """A course that is whole or still written. Raises RequestError for a file that holds none."""
    try:
        lines = path.read_bytes().splitlines()
    except OSError as error:
        raise RequestError(f"cannot read {path}: {error.strerror or error}. Give a model of `alula train`.") from error
    beginning: Beginning | None = None
    reports: dict[tuple[int, int], Report] = {}
    for line in lines:
        try:
            beginning = beginning or decode_json(line, Beginning)
            if line is not lines[0]:
                report = decode_json(line, Report)
                reports[report.member, report.step] = report
        except (msgspec.MsgspecError, UnicodeDecodeError):
            continue  # torn by a full disk or a killed process
    if beginning is None:
        raise RequestError(f"{path} is no course of a training. Give a model of `alula train`.")
    return Course(beginning, tuple(reports.values()))


def _write(path: Path, line: Beginning | Report, *, mode: str) -> None:
    try:
        with path.open(mode) as file:
            file.write(msgspec.json.encode(line) + b"\n")
    except OSError as error:
        raise RequestError(
            f"cannot write {path}: {error.strerror or error}. Make room on the disk; the same command with --resume "
            "goes on."
        ) from error
