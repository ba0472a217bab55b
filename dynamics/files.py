"""Files that are written completely or not at all."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from pathlib import Path

import msgspec

from dynamics.errors import RequestError
from dynamics.version import with_version


def write_whole(path: Path, write: Callable[[Path], object], *, advice: str) -> Path:
    """Write a temporary file in the same folder and rename it, so that the path never holds part of a file.

    write: writes to the path of its argument, raising OSError when it cannot.
    advice: what to do then.

    Raises RequestError.
    """
    part = path.with_name(f"{path.name}.{os.getpid()}.part")  # two processes may write the same file
    try:
        write(part)
        part.replace(path)
    except OSError as error:
        _remove(part)
        raise RequestError(f"cannot write {path}: {error.strerror or error}. {advice}") from error
    except BaseException:
        _remove(part)
        raise
    return path


def make_folder(folder: Path, *, advice: str) -> None:
    """Make a folder where there is none. advice: what to do when it cannot be made. Raises RequestError then."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise RequestError(f"cannot make the folder {folder}: {error.strerror or error}. {advice}") from error


STANDARD_OUTPUT = Path("-")


def write_json(value: object, path: Path) -> None:
    """Write a value as indented JSON; `-` is standard output. Raises RequestError when it cannot be written."""
    text = msgspec.json.format(msgspec.json.encode(value)) + b"\n"
    if path == STANDARD_OUTPUT:
        sys.stdout.buffer.write(text)
        sys.stdout.buffer.flush()
        return
    write_whole(path, lambda part: part.write_bytes(text), advice="Give a folder that can be written.")


def write_answer(value: object, path: Path) -> None:
    """Write an answer that can be sent to somebody, as `write_json`, with the version that gave it."""
    write_json(with_version(value), path)


def _remove(part: Path) -> None:
    try:
        part.unlink(missing_ok=True)
    except OSError:
        return  # a folder that can be read only has nothing of ours in it
