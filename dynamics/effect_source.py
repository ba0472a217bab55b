"""Python files with effects of a user's own as data: text with its hash, which nothing here runs.

A vehicle file names them; whatever leaves its folder (recordings, checkpoints, a worker's task) carries them as tables
`[[effect_files]]` with path, sha256 and text. `dynamics.trust` decides what may run.
"""

from __future__ import annotations

import hashlib
import os
import stat
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path, PurePosixPath
from typing import Any

import msgspec

from dynamics.errors import RequestError
from dynamics.inside import path_inside

ENDING = ".py"
MAX_BYTES = 1 << 20  # of a file; one with hundreds of effects has a tenth of it
CONTROLS = frozenset("\t\n\r\f")  # control characters that program text has
EXAMPLE = "See examples/my_effects.py."
KEY = "effect_files"  # in vehicle files


class EffectFile(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A Python file with effects of one's own, as text.

    path: whole, of the file that was read; the name alone where something else carries the text.
    sha256: of the text in UTF-8, by which a user approves it.
    text: as it was read, once.
    """

    path: str
    sha256: str
    text: str

    def __post_init__(self) -> None:
        """Refuse a text of another hash: it is damaged, or was edited."""
        if sha256_of(self.text) != self.sha256:
            raise RequestError(
                f"the text of {self.path!r} is not that of its sha256 {self.sha256[:16]}: it was edited or damaged. "
                "Take an intact copy."
            )

    @property
    def name(self) -> str:
        """The file's name."""
        return PurePosixPath(self.path).name

    @property
    def is_carried(self) -> bool:
        """Whether something else carries the text: a recording, a checkpoint, a vehicle file."""
        return not os.path.isabs(self.path)


def sha256_of(text: str) -> str:
    """Hash of a text in UTF-8, which is that of its file."""
    return hashlib.sha256(text.encode("utf-8", "surrogatepass")).hexdigest()


def effect_file(path: str, text: str) -> EffectFile:
    """A text with its hash."""
    return EffectFile(path, sha256_of(text), text)


def read_effect_file(path: str | Path) -> EffectFile:
    """An effect file that the user names. Raises RequestError for anything but a plain text file that ends in .py."""
    try:
        return _read(Path(path), Path(path).resolve(strict=True))
    except OSError as error:
        raise _no_file(path, error.strerror or str(error)) from None


def read_effect_file_below(folder: Path, name: str) -> EffectFile:
    """An effect file that a vehicle file or a case names, which must lie in its folder or below it.

    Raises RequestError for a name that leads elsewhere, by `..`, by a whole path or by a link, and as
    `read_effect_file`.
    """
    path = path_inside(folder, str(PurePosixPath(name)))
    if path is None:
        raise _elsewhere(folder, name)
    try:
        resolved = path.resolve(strict=True)
    except OSError:
        raise _no_file(path, "there is none") from None
    try:
        return _read(path, resolved)
    except OSError as error:
        raise _no_file(path, error.strerror or str(error)) from None


def entries_of(table: Mapping[str, Any]) -> list[Any]:
    """Entries of a vehicle's table under `effect_files`: names, or tables with texts; empty where it is no list."""
    entries = table.get(KEY, [])
    return entries if isinstance(entries, list) else []


def carried_files(entries: Iterable[Any]) -> list[EffectFile]:
    """The tables with texts among the entries. Raises RequestError for one that is none, or of another hash."""
    try:
        return [msgspec.convert(entry, EffectFile) for entry in entries if isinstance(entry, dict)]
    except msgspec.ValidationError as error:
        raise RequestError(f"{KEY}: {error}. Wanted are names of files, or path, sha256 and text of each.") from error


def as_carried(files: Iterable[EffectFile]) -> list[EffectFile]:
    """The files by their names alone: where the texts came from, their paths mean nothing here."""
    return [msgspec.structs.replace(file, path=file.name) for file in files]


def without_duplicates(files: Iterable[EffectFile]) -> list[EffectFile]:
    """Every content once, in the order in which it comes first."""
    of_content: dict[str, EffectFile] = {}
    for file in files:
        of_content.setdefault(file.sha256, file)
    return list(of_content.values())


def tables_toml(files: Sequence[EffectFile]) -> str:
    """The tables `[[effect_files]]`, to stand at the end of a vehicle file."""
    tables = []
    for file in files:
        keys = f"path = {_quoted(file.path)}\nsha256 = {_quoted(file.sha256)}\ntext = {_block(file.text)}\n"
        tables.append(f"\n[[{KEY}]]\n{keys}")
    return "".join(tables)


def printable(text: str) -> str:
    """A text of unknown origin as a terminal may show it, without control and direction characters."""
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text.expandtabs(4))


def _read(shown: Path, resolved: Path) -> EffectFile:
    """A file, opened once: what is checked, hashed and run later are the same bytes. Raises OSError, RequestError."""
    if shown.suffix != ENDING or resolved.suffix != ENDING:
        raise _no_file(shown, f"its name does not end in {ENDING}")
    # a pipe would wait for its writer, and a link may have been put there after the path was resolved
    descriptor = os.open(resolved, os.O_RDONLY | os.O_NONBLOCK | os.O_NOFOLLOW | os.O_CLOEXEC)
    with os.fdopen(descriptor, "rb") as file:
        if not stat.S_ISREG(os.fstat(descriptor).st_mode):
            raise _no_file(shown, "it is no regular file")
        content = file.read(MAX_BYTES + 1)
    if len(content) > MAX_BYTES:
        raise _no_file(shown, f"it has more than {MAX_BYTES >> 20} MB")
    try:
        text = content.decode("utf-8")
    except UnicodeDecodeError:
        raise _no_file(shown, "it is not UTF-8") from None
    if strange := next((c for c in text if ord(c) < 32 and c not in CONTROLS), None):
        raise _no_file(shown, f"it holds the byte {ord(strange)}, which no program text has")
    return effect_file(str(resolved), text)


def _no_file(path: str | Path, reason: str) -> RequestError:
    shown = printable(str(path))
    return RequestError(
        f"{shown} is no file with effects: {reason}. Give a plain text file {ENDING} that defines EFFECT. {EXAMPLE}"
    )


def _elsewhere(folder: Path, name: str) -> RequestError:
    return RequestError(
        f"{KEY} names {printable(name)!r}, which does not lie beside the vehicle file or below it ({folder}). Copy the "
        "file there and give its name, or leave it out and give --effects FILE."
    )


def _quoted(text: str) -> str:
    """A TOML basic string, in which JSON's escapes mean the same; TOML escapes the delete character as well."""
    return msgspec.json.encode(text).decode().replace("\x7f", "\\u007f")


def _block(text: str) -> str:
    """A text as TOML that reads as the very same text: lines as they are where TOML keeps them so."""
    plain = all(c in "\t\n" or (c >= " " and c != "\x7f") for c in text)
    return f"'''\n{text}'''" if plain and "'''" not in text and not text.endswith("'") else _quoted(text)
