"""The user's own folders for configuration and state: written whole, by one process at a time, by nobody else."""

from __future__ import annotations

import fcntl
import os
import stat
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

NAME = "alula"
Refuse = Callable[[Path, str], Exception]  # the error for a path and what is wrong with it


def configuration_folder() -> Path:
    """$XDG_CONFIG_HOME/alula, where that is a whole path, else ~/.config/alula. Raises RuntimeError without a home."""
    return _folder("XDG_CONFIG_HOME", ".config")


def state_folder() -> Path:
    """$XDG_STATE_HOME/alula, where that is a whole path, else ~/.local/state/alula. Raises RuntimeError likewise."""
    return _folder("XDG_STATE_HOME", ".local/state")


def _folder(variable: str, usual: str) -> Path:
    configured = os.environ.get(variable, "")
    return (Path(configured) if os.path.isabs(configured) else Path.home() / usual) / NAME


def make_own_folder(folder: Path, refuse: Refuse) -> None:
    """Make a folder for this user alone. Raises OSError, and `refuse` for one that others own or may write."""
    folder.parent.mkdir(parents=True, exist_ok=True)
    folder.mkdir(mode=0o700, exist_ok=True)
    require_own(folder, os.stat(folder), refuse)


def read_own(path: Path, max_bytes: int, refuse: Refuse) -> bytes | None:
    """The content of a file that nobody else may have written, None where there is none. Raises `refuse`."""
    try:
        descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_NOFOLLOW | os.O_CLOEXEC)
    except (FileNotFoundError, NotADirectoryError):
        return None
    except OSError as error:
        raise refuse(path, error.strerror or str(error)) from None
    try:
        require_own(path.parent, os.stat(path.parent), refuse)
        require_own(path, os.fstat(descriptor), refuse)
        with os.fdopen(descriptor, "rb", closefd=False) as file:
            return file.read(max_bytes)
    except OSError as error:  # a folder in its place
        raise refuse(path, error.strerror or str(error)) from None
    finally:
        os.close(descriptor)


def replace_own(path: Path, content: bytes) -> None:
    """Write a file anew, whole and on the disk before its old content is gone, with mode 600. Raises OSError."""
    descriptor, part = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}-")  # of mode 600
    try:
        with os.fdopen(descriptor, "wb") as file:
            file.write(content)
            file.flush()
            os.fsync(descriptor)
        os.replace(part, path)
    except OSError:
        os.unlink(part)
        raise


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Keep other processes that lock the folder waiting. Raises OSError."""
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX)
        yield
    finally:
        os.close(descriptor)


def require_own(path: Path, status: os.stat_result, refuse: Refuse) -> None:
    """Raise `refuse` for what another user owns or may change."""
    if status.st_uid not in (os.geteuid(), 0):
        raise refuse(path, "it belongs to another user")
    if status.st_mode & (stat.S_IWGRP | stat.S_IWOTH):
        raise refuse(path, f"others may write it. Look through it, then: chmod go-w {path}")
