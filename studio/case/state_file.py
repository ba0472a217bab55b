"""`case.json` as it is read: whole, of this format, and with paths that stay in the case's folder."""

from __future__ import annotations

import fcntl
import os
import stat
from pathlib import Path
from typing import IO, Any

import msgspec

from dynamics.decoding import decode_json
from dynamics.effect_source import printable
from dynamics.errors import RequestError
from dynamics.field_errors import described
from dynamics.inside import path_inside
from studio.case.state import FORMAT, CaseState

STATE_FILE, LOCK_FILE = "case.json", ".lock"
LOGS, VERSIONS, RESULTS, EFFECTS, MAPPINGS = "logs", "versions", "results", "effects", "mappings"
FOLDERS = (LOGS, VERSIONS, RESULTS, EFFECTS, MAPPINGS)
ADVICE = "Give a folder that can be written."


def inside(folder: Path, name: str) -> Path:
    """The path of a case's file, by the name that the case has for it: every use of such a name comes here first.

    Raises RequestError for a name that is no normal path below the case's folder, or that a link leads out of it.
    """
    path = path_inside(folder, name)
    if path is None:
        raise RequestError(
            f"the case in {folder} names {printable(name)!r}, which is not in its folder: it was edited, or made by an "
            "earlier Alula. If that file is yours, `alula studio FILE --case FOLDER` (of a mapping: --mapping FILE) "
            "takes it into the case."
        )
    return path


def result_name(step: str, key: str) -> str:
    """The name of a result's folder in the case's."""
    return f"{RESULTS}/{step.replace(':', '-').replace('/', '-')}-{key}"


def read_state(folder: Path) -> CaseState:
    """The state of a case's folder, whose paths nothing has looked at. Raises RequestError where there is none."""
    path = inside(folder, STATE_FILE)
    try:
        if path.exists() and not path.is_file():
            raise RequestError(f"{path} is no regular file. Give the folder of a case.")
        content = path.read_bytes()
    except OSError as error:
        advice = "Give the folder of a case; `alula studio LOG... --case FOLDER` makes one."
        raise RequestError(f"{folder} holds no case ({STATE_FILE}: {error.strerror or error}). {advice}") from None
    try:
        number = decode_json(content, dict[str, Any]).get("format")
        if number != FORMAT:
            advice = f"This Alula reads format {FORMAT}; its logs and vehicle files are as they were, in {folder}."
            raise RequestError(f"{path} is of format {number!r}. {advice}")
        state = decode_json(content, CaseState)
    except msgspec.MsgspecError as error:
        raise RequestError(
            f"{path} is damaged: {described(error)}. Its logs and vehicle files lie beside it."
        ) from None
    numbers = [version.number for version in state.versions]
    if len(set(numbers)) < len(numbers) or any(not 0 <= v.parent < v.number for v in state.versions):
        raise RequestError(f"{path} is damaged: its versions do not follow each other. They lie beside it.")
    return state


def require_confined(state: CaseState, folder: Path) -> None:
    """Raise RequestError, as `inside`, for a state of which any path leads out of the case's folder.

    Effect files have a refusal of their own, which names what would run, when a vehicle asks for them.
    """
    names = [*(log.path for log in state.logs), *(version.file for version in state.versions)]
    names += [result_name(step, key) for step, key in state.shown.items()]
    names += [state.options.mapping] if state.options.mapping else []
    for name in (*names, *FOLDERS, STATE_FILE, LOCK_FILE):
        inside(folder, name)


def locked(folder: Path) -> IO[str]:
    """A lock on a case's folder, which ends with this process. Raises RequestError where another one has it."""
    try:
        # neither a link nor a pipe that somebody has put there, and nothing is cut off
        flags = os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC
        file = os.fdopen(os.open(folder / LOCK_FILE, flags, 0o600), encoding="utf-8")
    except OSError as error:
        raise RequestError(f"cannot write in {folder}: {error.strerror or error}. {ADVICE}") from error
    if not stat.S_ISREG(os.fstat(file.fileno()).st_mode):
        file.close()
        raise RequestError(f"{folder / LOCK_FILE} is no regular file. Remove it.")
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        file.close()
        raise RequestError(f"{folder} is open in another studio. Close that one first, or use its page.") from None
    return file
