"""The files of a training: a model that is not overwritten by mistake, and the folder of its members' states."""

from __future__ import annotations

import fcntl
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from dynamics.errors import RequestError

STATE = "member_{}.state"
SUFFIX, CARD_SUFFIX = ".pt", ".json"
LOCK = "lock"


def run_folder(out: Path) -> Path:
    """Folder of the members' saved states."""
    return out.with_name(f"{out.name}.run")


@contextmanager
def claimed(out: Path, folder: Path, *, overwrite: bool, resume: bool) -> Iterator[None]:
    """The model's path and the members' folder for this process alone; it stays if members can continue from it.

    Raises RequestError for a model that exists, a training that did not end or still runs, and a folder that cannot be
    written to.
    """
    require_free(out, overwrite=overwrite)
    if not resume and _began(folder):
        raise RequestError(
            f"{folder} holds a training that did not end. Continue with --resume and otherwise the same command, or "
            "delete the folder."
        )
    try:
        folder.mkdir(parents=True, exist_ok=True)
        lock = (folder / LOCK).open("w")
    except OSError as error:
        raise RequestError(f"cannot write to {out.parent}: {error.strerror}. Give another --out.") from error
    with lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            raise RequestError(f"another training is writing {out} now. Wait for it, or give another --out.") from error
        try:
            yield
        except BaseException:
            if not _began(folder):
                shutil.rmtree(folder, ignore_errors=True)
            raise
        shutil.rmtree(folder, ignore_errors=True)


def require_free(out: Path, *, overwrite: bool) -> None:
    """Raises RequestError for a name that is not a model's, and for a model or a card that is there."""
    if out.suffix != SUFFIX:
        raise RequestError(f"--out {out}: required is a name in {SUFFIX}, by which other commands recognise models.")
    for path in (out, out.with_suffix(CARD_SUFFIX)):
        if path.exists() and not overwrite:
            raise RequestError(f"{path} exists. Give another --out, or --overwrite.")


def _began(folder: Path) -> bool:
    return any(folder.glob(STATE.format("*")))
