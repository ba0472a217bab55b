"""Files that are there whole or not at all."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from dynamics.errors import RequestError


def write_whole(path: Path, write: Callable[[Path], object], *, advice: str) -> Path:
    """Write beside the path and move there, so that no torn file ever bears the name.

    write: to the path that it is given, raising OSError when it cannot. advice: what to do then. Raises RequestError.
    """
    part = path.with_name(f"{path.name}.part")
    try:
        write(part)
        part.replace(path)
    except OSError as error:
        _leave_nothing(part)
        raise RequestError(f"cannot write {path}: {error.strerror or error}. {advice}") from error
    return path


def _leave_nothing(part: Path) -> None:
    try:
        part.unlink(missing_ok=True)
    except OSError:
        return  # a folder that can be read only has nothing of ours in it
