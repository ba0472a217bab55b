"""The one log of a zip file, unpacked within the limits of all compressed files."""

from __future__ import annotations

import zipfile
import zlib
from pathlib import Path, PurePosixPath

from dynamics.errors import DataError, RequestError
from dynamics.unpacking import CHUNK, Unpacking

MAGIC = b"PK\x03\x04"
_EMPTY = b"PK\x05\x06"
_SPREADSHEET = "xl/workbook.xml"
_ENCRYPTED = 1  # bit of a member's flags
_SHOWN = 8
_DAMAGE = (zipfile.BadZipFile, zlib.error, EOFError, NotImplementedError, RuntimeError, ValueError, OverflowError)


class SeveralLogsError(RequestError):
    """A zip file that holds more than one log."""


def is_zip(path: Path) -> bool:
    """Whether a file begins as a zip file does; not for one that cannot be read."""
    try:
        with path.open("rb") as stream:
            return stream.read(len(MAGIC)) in (MAGIC, _EMPTY)
    except OSError:
        return False


def unpack(path: Path, folder: Path) -> None:
    """Unpack a zip file's members below a folder.

    Raises DataError for a damaged, an encrypted or an empty one, for a spreadsheet, and for names that lead out of the
    folder; RequestError beyond the limits.
    """
    size = path.stat().st_size
    unpacking = Unpacking(path, size)
    try:
        with zipfile.ZipFile(path) as packed:
            if _SPREADSHEET in packed.namelist():
                raise DataError(f"{path} is a spreadsheet. Save its table as CSV, and give that.")
            members = [info for info in packed.infolist() if not info.is_dir() and not _is_hidden(info.filename)]
            if not members:
                raise DataError(f"{path} is a zip file without a file in it. Wanted one flight log.")
            packed_bytes = 0
            for member in members:
                packed_bytes += member.compress_size
                unpacking.add_file()
                _write(packed, member, _place_of(member.filename, folder, path), unpacking, packed_bytes)
    except OSError as error:
        raise RequestError(f"cannot unpack {path}: {error.strerror or error}. Unpack it, and give the log.") from error
    except _DAMAGE as error:
        raise DataError(
            f"{path} is a zip file that is damaged or cut off ({error}). Wanted a whole one; copy it again."
        ) from None


def _is_hidden(name: str) -> bool:
    """Whether a member is what macOS and tools leave beside the files."""
    parts = PurePosixPath(name.replace("\\", "/")).parts
    return "__MACOSX" in parts or parts[-1:] == () or parts[-1].startswith(".")


def _place_of(name: str, folder: Path, path: Path) -> Path:
    place = PurePosixPath(name.replace("\\", "/"))
    if place.is_absolute() or ".." in place.parts or ":" in place.parts[0] or "\0" in name:
        raise DataError(f"{path} holds a file {name!r}, whose name leads out of the folder. Pack it again.")
    return folder.joinpath(*place.parts)


def _write(
    packed: zipfile.ZipFile, member: zipfile.ZipInfo, place: Path, unpacking: Unpacking, packed_bytes: int
) -> None:
    """Unpack a member to a place. packed_bytes: of this member and those before it."""
    if member.flag_bits & _ENCRYPTED:
        raise DataError(f"{unpacking.path} is encrypted. Unpack it with its password, and give the log.")
    place.parent.mkdir(parents=True, exist_ok=True)
    with packed.open(member) as source, place.open("wb") as target:
        while part := source.read(CHUNK):
            unpacking.add_bytes(len(part), packed_bytes)
            target.write(part)


def only_log(path: Path, logs: list[Path], others: list[Path], folder: Path) -> Path:
    """The log of a zip file. logs: those found below the folder that it was unpacked to; others: its other files.

    Raises SeveralLogsError, which names them, and RequestError where there is none.
    """
    if len(logs) == 1:
        return logs[0]
    if not logs:
        raise RequestError(f"{path} is a zip file that holds no log of a known format ({_names(others, folder)}).")
    raise SeveralLogsError(
        f"{path} is a zip file that holds {len(logs)} logs: {_names(logs, folder)}. Unpack it, and give the log that "
        "you mean, or the folder for all of them."
    )


def _names(files: list[Path], folder: Path) -> str:
    names = [str(file.relative_to(folder)) for file in files]
    return ", ".join(names[:_SHOWN]) + (f", and {len(names) - _SHOWN} more" if len(names) > _SHOWN else "")
