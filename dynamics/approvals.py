"""The user's own list of code that may run, by its hash: one file in the configuration folder, for this user alone.

What is approved is a content, wherever it lies: a file that was changed is not approved any more, a copy is. Nothing
in the working directory, beside a log or in a vehicle file adds to the list.
"""

from __future__ import annotations

import datetime
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Literal

import msgspec

from dynamics.decoding import decode_json
from dynamics.errors import RequestError
from dynamics.field_errors import described
from dynamics.own_folder import configuration_folder, locked, make_own_folder, read_own, replace_own

NAME = "trusted.json"
MAX_BYTES = 16 << 20
Kind = Literal["effects", "bundle", "library"]  # Python text, a bundle's manifest, a shared library of one


class Approval(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A content that may run.

    name: of the file when it was approved, to recognise it. date: of the approval.
    """

    sha256: str
    kind: Kind
    name: str
    date: str


def store_path() -> Path:
    """The list's file in the configuration folder. Raises RuntimeError for a user without a home."""
    return configuration_folder() / NAME


def read_approvals() -> tuple[Approval, ...]:
    """The approved contents, oldest first. Raises RequestError for a list that others may have written."""
    try:
        path = store_path()
    except RuntimeError:  # a user without a home
        return ()
    content = read_own(path, MAX_BYTES, _unusable)
    if content is None:
        return ()
    try:
        return decode_json(content, tuple[Approval, ...])
    except msgspec.MsgspecError as error:
        raise _unusable(path, f"it is damaged: {described(error)}") from None


def is_listed(kind: Kind, sha256: str) -> bool:
    """Whether the user has approved a content for good."""
    return any(approval.sha256 == sha256 and approval.kind == kind for approval in read_approvals())


def approve(items: Iterable[tuple[Kind, str, str]]) -> None:
    """Approve contents for good, each by kind, sha256 and name. Raises RequestError where the list cannot be kept."""
    today = datetime.datetime.now(tz=datetime.UTC).date().isoformat()
    additions = [Approval(sha256, kind, name, today) for kind, sha256, name in items]

    def added(before: Sequence[Approval]) -> list[Approval]:
        listed = {(approval.kind, approval.sha256) for approval in before}
        return [*before, *(approval for approval in additions if (approval.kind, approval.sha256) not in listed)]

    _change(added)


def withdraw(sha256s: Sequence[str], names: Sequence[str] = ()) -> tuple[Approval, ...]:
    """Take contents off the list, by their hashes, the beginnings of these (8 digits or more), or their names.

    Returns those that were on it.
    """
    removed: list[Approval] = []

    def remaining(before: Sequence[Approval]) -> list[Approval]:
        beginnings = tuple(sha256 for sha256 in sha256s if len(sha256) >= 8)
        removed[:] = [a for a in before if (beginnings and a.sha256.startswith(beginnings)) or a.name in names]
        return [approval for approval in before if approval not in removed]

    _change(remaining)
    return tuple(removed)


def _change(edited: Callable[[Sequence[Approval]], list[Approval]]) -> None:
    """Write the list anew, whole, one process at a time."""
    try:
        path = store_path()
    except RuntimeError:
        raise RequestError("this user has no home folder. Set XDG_CONFIG_HOME to a folder of yours.") from None
    try:
        make_own_folder(path.parent, _unusable)
        with locked(path.parent):
            content = msgspec.json.format(msgspec.json.encode(edited(read_approvals())), indent=1) + b"\n"
            replace_own(path, content)
    except OSError as error:
        raise RequestError(
            f"cannot write {path}: {error.strerror or error}. Set XDG_CONFIG_HOME to a folder of yours."
        ) from error


def _unusable(path: Path, reason: str) -> RequestError:
    return RequestError(f"{path} says which code you have approved, and cannot be used: {reason}.")
