"""Approval of code: the one place that runs a user's Python and loads a shared library, both by the content's hash.

Data never runs. Effects of a user's own are text (`dynamics.effect_source`) until the user has approved that content:
for good (`alula trust FILE`), or for one call (`--effects FILE`, `effect_files=`). The bytes that run are those that
were hashed; no path is opened again. See docs/trust.md.
"""

from __future__ import annotations

import ctypes
import hashlib
import os
import shlex
import sys
import threading
import types
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from dynamics import symbolic
from dynamics.approvals import Kind, is_listed
from dynamics.effect_source import EffectFile, printable, read_effect_file
from dynamics.errors import RequestError

FIRST_LINES = 8  # of what would run, in a refusal
WIDTH = 110  # of such a line, characters
Library = ctypes.CDLL
ROOT = Path(__file__).resolve().parent.parent

_approved: set[tuple[Kind, str]] = set()  # in this process, as the list may change meanwhile
_libraries: dict[str, Library] = {}  # of bundles, by hash
_running = threading.RLock()  # one file at a time: the search path is another one meanwhile


def approve_here(approved: Iterable[tuple[Kind, str]]) -> None:
    """Approve contents in this process: a call's own, or those that the process that started this one has approved."""
    _approved.update(approved)


def approved_here() -> tuple[tuple[Kind, str], ...]:
    """Approvals of this process, for processes that do part of its work."""
    return tuple(sorted(_approved))


def approve_given(paths: Iterable[str | Path] | None) -> None:
    """Approve files that the user names for this call. Raises RequestError for one that is no plain Python text."""
    approve_here(("effects", read_effect_file(path).sha256) for path in paths or ())


def is_approved(kind: Kind, sha256: str) -> bool:
    """Whether the user has approved a content, for good or for this call."""
    if (kind, sha256) not in _approved and is_listed(kind, sha256):
        _approved.add((kind, sha256))
    return (kind, sha256) in _approved


def require_approved(files: Sequence[EffectFile], carrier: str | Path | None = None) -> None:
    """Raise RequestError where a content is not approved: file, hash, first lines, and the command that approves it.

    carrier: the recording, checkpoint or vehicle file that carries the texts without a file of their own.
    """
    unknown = [file for file in files if not is_approved("effects", file.sha256)]
    if not unknown:
        return
    shown = "\n".join(line for file in unknown for line in _shown(file, carrier))
    raise RequestError(f"{shown}\n{_advice(unknown, carrier)}")


def run_effect_file(file: EffectFile) -> dict[str, Any]:
    """The names that an approved file defines; it stands alone, and no folder of a user's is searched for imports.

    Raises RequestError for one that is not approved, and whatever the file raises.
    """
    require_approved([file])
    code = compile(file.text.removeprefix("\ufeff"), file.path, "exec", dont_inherit=True)
    module = types.ModuleType(f"alula_effects_{file.sha256[:16]}")
    module.__file__ = file.path
    with _running, symbolic.importable(), _without_folders(Path(file.path).parent):
        sys.modules[module.__name__] = module  # where dataclasses look for the names of annotations
        try:
            exec(code, module.__dict__)
        finally:
            del sys.modules[module.__name__]
    return module.__dict__


def load_own_library(path: Path) -> Library:
    """A shared library of this installation, or one that was compiled here (`dynamics.codegen`). Raises OSError."""
    return ctypes.CDLL(str(path))


def with_lock(library: Library) -> ctypes.PyDLL:
    """A loaded library whose functions keep the interpreter's lock: for those that take some microseconds.

    One that gives the lock away waits for it afterwards, 0.5 ms and more while another thread computes.
    """
    return ctypes.PyDLL(library._name, handle=library._handle)


def load_given_library(path: Path) -> Library:
    """A shared library that came in a bundle: the very bytes that are approved.

    Raises RequestError where they are not, OSError for what is no library of this machine.
    """
    content = path.read_bytes()
    sha256 = hashlib.sha256(content).hexdigest()
    if not is_approved("library", sha256):
        raise RequestError(
            f"{path} is machine code that would run as you, and you have not approved it (sha256 {sha256}). Approve "
            f"the bundle, if you know who made it: alula trust {quoted(path.parent)}"
        )
    with _running:
        if sha256 not in _libraries:  # a file in memory, which nobody can exchange; open, as its path is its name
            descriptor = os.memfd_create(f"{path.name}-{sha256[:8]}", os.MFD_CLOEXEC)
            with os.fdopen(os.dup(descriptor), "wb") as file:
                file.write(content)
            _libraries[sha256] = ctypes.CDLL(f"/proc/self/fd/{descriptor}")
        return _libraries[sha256]


def quoted(path: str | Path) -> str:
    """A path as a shell takes it, and a terminal may show it."""
    return shlex.quote(printable(str(path)))


@contextmanager
def _without_folders(folder: Path) -> Iterator[None]:
    """Imports search neither a file's folder nor the working directory, whose files nobody has approved."""
    before = list(sys.path)
    refused = {os.path.realpath(folder)} - {str(ROOT)} if folder.is_absolute() else set()
    with suppress(FileNotFoundError):  # a working directory that is gone
        refused |= {os.getcwd()} - {str(ROOT)}
    sys.path[:] = [place for place in before if os.path.isabs(place) and os.path.realpath(place) not in refused]
    try:
        yield
    finally:
        sys.path[:] = before


def _shown(file: EffectFile, carrier: str | Path | None) -> Iterator[str]:
    """Code that would run, for a terminal."""
    if file.is_carried:
        where = f", whose text {printable(str(carrier))} carries," if carrier else ", whose text came with the data,"
    else:
        where = ""
    yield f"{printable(file.path)}{where} is Python that would run as you, and you have not approved it:"
    yield f"  sha256 {file.sha256}"
    lines = file.text.splitlines()
    for number, line in enumerate(lines[:FIRST_LINES], start=1):
        yield f"  {number:>3} | {printable(line)[:WIDTH]}"
    if len(lines) > FIRST_LINES:
        yield f"  ... and {len(lines) - FIRST_LINES} more lines"


def _advice(files: Sequence[EffectFile], carrier: str | Path | None) -> str:
    """The command that approves."""
    own = " ".join(quoted(file.path) for file in files if not file.is_carried)
    if not any(file.is_carried for file in files):
        effects = " ".join(f"--effects {quoted(file.path)}" for file in files)
        return f"Read it; approve it for good with `alula trust {own}`, or for this call with {effects}."
    places = " ".join(filter(None, (quoted(carrier) if carrier else "THE_FILE_THAT_CARRIES_IT", own)))
    return (
        f"`alula trust {places}` shows it whole and approves it; --effects FILE approves your own copy for this call."
    )
