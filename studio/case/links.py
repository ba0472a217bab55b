"""Logs that lie outside of their case: the user's own list of them, which no case and no archive holds.

A case names the files of its folder alone. A log of the command line stays where it is: its case names the place that
it would have, and this list, in the configuration folder, has the file for it. So a case that somebody sent names no
file of this computer.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import msgspec

from dynamics.decoding import decode_json
from dynamics.errors import RequestError
from dynamics.field_errors import described
from dynamics.own_folder import configuration_folder, locked, make_own_folder, read_own, replace_own
from studio.case.state import CaseLog

NAME = "linked_logs.json"
MAX_BYTES = 64 << 20
ADVICE = "Make the folder writable, or copy the log into the case's folder and add it from there."


class LinkedLog(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A log outside of its case.

    case: the case's folder. log: path by which `case.json` names it. sha256: of the log there. path: of the file.
    """

    case: str
    log: str
    sha256: str
    path: str

    def is_of(self, log: CaseLog) -> bool:
        """Whether a case's entry is this log: by its content as well, which a stranger's case cannot know."""
        return self.log == log.path and self.sha256 == log.sha256


def links_of(case: Path) -> tuple[LinkedLog, ...]:
    """The linked logs of a case's folder. Raises RequestError for a list that others may have written."""
    return tuple(link for link in _read() if link.case == str(case))


def set_links(case: Path, links: Sequence[LinkedLog]) -> None:
    """Replace the linked logs of a case's folder. Raises RequestError where the list cannot be kept."""
    if tuple(links) == links_of(case):
        return

    def edited(before: tuple[LinkedLog, ...]) -> list[LinkedLog]:
        others = [link for link in before if link.case != str(case) and Path(link.case).is_dir()]
        return [*others, *links]

    _change(edited)


def _path() -> Path:
    return configuration_folder() / NAME


def _read() -> tuple[LinkedLog, ...]:
    try:
        path = _path()
    except RuntimeError:  # a user without a home
        return ()
    content = read_own(path, MAX_BYTES, _unusable)
    if content is None:
        return ()
    try:
        return decode_json(content, tuple[LinkedLog, ...])
    except msgspec.MsgspecError as error:
        raise _unusable(path, f"it is damaged: {described(error)}") from None


def _change(edited: Callable[[tuple[LinkedLog, ...]], list[LinkedLog]]) -> None:
    """Write the list anew, whole, one process at a time."""
    try:
        path = _path()
        make_own_folder(path.parent, _unusable)
        with locked(path.parent):
            replace_own(path, msgspec.json.format(msgspec.json.encode(edited(_read())), indent=1) + b"\n")
    except RuntimeError:
        raise RequestError("this user has no home folder. Set XDG_CONFIG_HOME to a folder of yours.") from None
    except OSError as error:
        raise RequestError(f"cannot note in {path} where a log lies: {error.strerror or error}. {ADVICE}") from error


def _unusable(path: Path, reason: str) -> RequestError:
    advice = "Make it yours alone, or remove it: `alula studio LOG... --case FOLDER` links a case's logs again."
    return RequestError(f"{path} has the logs outside of your cases, and cannot be used: {reason}. {advice}")
