"""A case as one file, to send: a zip archive with its logs, vehicle files, effects and results."""

from __future__ import annotations

import struct
import zipfile
import zlib
from pathlib import Path, PurePosixPath

import msgspec

from dynamics.errors import RequestError
from dynamics.files import make_folder, write_whole
from studio.case.case import ADVICE, LOGS, STATE_FILE, Case, files_of
from studio.case.state import CaseLog

ENDING = ".alula.zip"
# What zipfile raises for damaged members: beside its own, of decompression, encryption, unknown methods and bad names.
DAMAGE = (zipfile.BadZipFile, zlib.error, EOFError, RuntimeError, ValueError, LookupError, struct.error, OverflowError)
MAX_BYTES = 16 << 30  # of an archive's files in all, against one that grows without end when it is opened


def write_archive(case: Case, path: Path) -> Path:
    """Write a case with copies of all of its logs. Raises RequestError for a log that is gone, or a full disk."""
    placed = [_placed(log, number) for number, log in enumerate(case.state.logs)]
    missing = [str(file) for file in case.log_paths if not file.exists()]
    if missing:
        raise RequestError(f"{missing[0]} is gone, so the case cannot be sent whole. Put it back, or remove the log.")

    def write(part: Path) -> None:
        with zipfile.ZipFile(part, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
            for log, path in zip(placed, case.log_paths, strict=True):
                for file in files_of(path):
                    archive.write(file, str(Path(log.path) / file.relative_to(path)))
            for file in sorted(case.folder.rglob("*")):
                name = file.relative_to(case.folder)
                if file.is_file() and name.parts[0] in ("versions", "effects", "results") and ".part" not in str(name):
                    archive.write(file, str(name))
            state = msgspec.structs.replace(case.state, logs=tuple(placed))
            archive.writestr(STATE_FILE, msgspec.json.encode(state))

    return write_whole(path, write, advice="Give another file, or make room.")


def unpack_archive(path: Path, folder: Path) -> Path:
    """Unpack a case into a new folder. Raises RequestError for a file that is no case, or paths that leave it."""
    if folder.exists() and any(folder.iterdir()):
        raise RequestError(f"{folder} is not empty. Give a new folder for the case.")
    try:
        with zipfile.ZipFile(path) as archive:
            entries = archive.infolist()
            _require_case(path, entries)
            make_folder(folder, advice=ADVICE)
            archive.extractall(folder)
    except (*DAMAGE, OSError) as error:
        raise RequestError(f"{path} cannot be opened as a case: {error}. Give a file that `Send` wrote.") from error
    return folder


def _require_case(path: Path, entries: list[zipfile.ZipInfo]) -> None:
    names = [PurePosixPath(entry.filename) for entry in entries]
    if PurePosixPath(STATE_FILE) not in names:
        raise RequestError(f"{path} holds no case ({STATE_FILE} is missing). Give a file that `Send` wrote.")
    if any(name.is_absolute() or ".." in name.parts for name in names):
        raise RequestError(f"{path} would write outside its folder, so it was not opened.")
    if sum(entry.file_size for entry in entries) > MAX_BYTES:
        raise RequestError(f"{path} would take more than {MAX_BYTES >> 30} GB, so it was not opened.")


def _placed(log: CaseLog, number: int) -> CaseLog:
    """A log as it is inside of an archive."""
    path = Path(log.path)
    return log if not path.is_absolute() else msgspec.structs.replace(log, path=f"{LOGS}/{number:03d}_{path.name}")
