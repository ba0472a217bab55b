"""A case as one file, to send: a zip archive with its logs, vehicle files, effects and results."""

from __future__ import annotations

import os
import shutil
import stat
import struct
import unicodedata
import zipfile
import zlib
from collections.abc import Iterable, Iterator
from pathlib import Path, PurePosixPath

import msgspec

from dynamics.effect_source import printable
from dynamics.errors import RequestError
from dynamics.files import make_folder, write_whole
from dynamics.inside import path_inside
from dynamics.unpacking import FILES, Unpacking, limit_of
from dynamics.version import with_version
from studio.case.case import Case, files_of, is_device
from studio.case.links import set_links
from studio.case.state_file import (
    ADVICE,
    EFFECTS,
    LOCK_FILE,
    MAPPINGS,
    RESULTS,
    STATE_FILE,
    VERSIONS,
    inside,
    read_state,
    require_confined,
)

ENDING = ".alula.zip"
BYTES_OF_ENTRY = 2_048  # that an entry may have in an archive's list of contents; names of 100 characters take 200
ZIP_CHUNK = 1 << 16  # bytes that are unpacked at once, and at most read for it
ENCRYPTED = 0x1  # flag of an entry
METHODS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)  # whose output is bounded for every byte that is read
# What zipfile raises for damaged members: beside its own, of decompression, encryption, unknown methods and bad names.
DAMAGE = (zipfile.BadZipFile, zlib.error, EOFError, RuntimeError, ValueError, LookupError, struct.error, OverflowError)


def write_archive(case: Case, path: Path) -> Path:
    """Write a case with copies of all of its logs.

    Raises RequestError for a log that is gone, for links that lead out of the case, or a full disk.
    """
    logs = list(zip(case.state.logs, case.log_paths, strict=True))
    missing = [str(file) for _, file in logs if not file.exists()]
    if missing:
        raise RequestError(f"{missing[0]} is gone, so the case cannot be sent whole. Put it back, or remove the log.")

    def write(part: Path) -> None:
        with zipfile.ZipFile(part, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
            for log, place in logs:
                for file in files_of(place):
                    if file != place and path_inside(place, str(file.relative_to(place))) is None:
                        raise RequestError(f"{file} is a link out of its log's folder. Put the file itself there.")
                    archive.write(file, str(PurePosixPath(log.path) / file.relative_to(place)))
            for name in _content_of(case.folder):
                if name not in archive.NameToInfo:
                    archive.write(inside(case.folder, name), name)
            archive.writestr(STATE_FILE, msgspec.json.encode(with_version(case.state)))

    return write_whole(path, write, advice="Give another file, or make room.")


def _content_of(folder: Path) -> Iterator[str]:
    """The names of a case's files beside its logs and its state."""
    for top in (VERSIONS, EFFECTS, MAPPINGS, RESULTS):
        for file in sorted(inside(folder, top).rglob("*")):
            name = str(file.relative_to(folder))
            if ".part" not in name and (file.is_symlink() or file.is_file()):
                yield name


def unpack_archive(path: Path, folder: Path) -> Path:
    """Unpack a case into a new folder, which appears whole.

    Raises RequestError for a file that is no case, paths that leave it, and one that is larger than the limits.
    """
    if folder.exists() and any(folder.iterdir()):
        raise RequestError(f"{folder} is not empty. Give a new folder for the case.")
    make_folder(folder.parent, advice=ADVICE)
    part = folder.with_name(f".{folder.name}.{os.getpid()}.part")
    shutil.rmtree(part, ignore_errors=True)
    try:
        _require_short_list(path)
        with zipfile.ZipFile(path) as archive:
            entries = archive.infolist()
            _require_case(path, entries)
            part.mkdir()
            _extract(archive, entries, part, Unpacking(path, path.stat().st_size))
        require_confined(read_state(part), part)
        set_links(folder.resolve(), ())  # of a case that was there before
        part.replace(folder)
    except (*DAMAGE, OSError) as error:
        raise RequestError(f"{path} cannot be opened as a case: {error}. Give a file that `Send` wrote.") from error
    finally:
        shutil.rmtree(part, ignore_errors=True)
    return folder


def _extract(archive: zipfile.ZipFile, entries: Iterable[zipfile.ZipInfo], folder: Path, unpacking: Unpacking) -> None:
    packed = 0  # bytes of the entries that are done
    for entry in entries:
        unpacking.add_file()
        target = inside(folder, entry.filename.rstrip("/"))
        if entry.is_dir():
            target.mkdir(parents=True, exist_ok=True)
            continue
        target.parent.mkdir(parents=True, exist_ok=True)
        with archive.open(entry) as source, target.open("xb") as file:
            while chunk := source.read(ZIP_CHUNK):
                read = 0 if archive.fp is None else archive.fp.tell() - entry.header_offset
                unpacking.add_bytes(len(chunk), packed + min(read, entry.compress_size))
                file.write(chunk)
        packed += entry.compress_size


def _require_case(path: Path, entries: list[zipfile.ZipInfo]) -> None:
    """Raise RequestError for an archive that is no case's, before anything of it is unpacked."""
    if STATE_FILE not in (entry.orig_filename for entry in entries):
        raise RequestError(f"{path} holds no case ({STATE_FILE} is missing). Give a file that `Send` wrote.")
    files: set[str] = set()
    folders: set[str] = set()
    for entry in entries:
        if fault := _fault_of(entry):
            raise RequestError(f"{path} was not opened: {printable(entry.orig_filename)!r} {fault}.")
        name = PurePosixPath(unicodedata.normalize("NFC", entry.filename.rstrip("/")).casefold())
        folders |= {str(parent) for parent in name.parents} | ({str(name)} if entry.is_dir() else set())
        if not entry.is_dir() and str(name) in files:
            raise RequestError(f"{path} was not opened: it holds {printable(entry.orig_filename)!r} twice.")
        files |= set() if entry.is_dir() else {str(name)}
    if both := sorted(files & folders):
        raise RequestError(f"{path} was not opened: {printable(both[0])!r} is a file and a folder in it.")
    if sum(entry.compress_size for entry in entries) > path.stat().st_size:
        raise RequestError(f"{path} was not opened: its files overlap, which those that `Send` writes do not.")


def _fault_of(entry: zipfile.ZipInfo) -> str:
    """Why an entry is not unpacked, empty for one that is."""
    name = entry.orig_filename.rstrip("/")
    parts = name.split("/")
    mode = entry.external_attr >> 16
    if name.startswith("/") or ".." in parts or "\\" in name or name[1:2] == ":":
        return "would be written outside its folder"
    if name != entry.filename.rstrip("/") or not name or any(part in ("", ".", LOCK_FILE) for part in parts):
        return "is no plain name of a file"
    if any(is_device(part) or part[-1] in ". " or not part.isprintable() for part in parts):
        return "is no name that every system can have: a device's, or with characters that cannot be seen"
    if stat.S_IFMT(mode) not in (0, stat.S_IFREG, stat.S_IFDIR):
        return "is a link or a device"
    if entry.flag_bits & ENCRYPTED or entry.compress_type not in METHODS:
        return "is encrypted, or packed in another way than by `Send`"
    return ""


def _require_short_list(path: Path) -> None:
    """Raise RequestError for a list of contents too long for the files that an archive may hold: it is read whole."""
    limit = limit_of(FILES) * BYTES_OF_ENTRY
    with path.open("rb") as file:
        end = file.seek(0, os.SEEK_END)
        file.seek(max(0, end - (1 << 16) - 42 - 56))
        tail = file.read()
    # its length stands 12 bytes after the first of these marks, in archives over 4 GB 40 bytes after the second
    for mark, layout, offset in ((b"PK\5\6", "<L", 12), (b"PK\6\6", "<Q", 40)):
        place = tail.rfind(mark)
        if place < 0 or len(tail) < place + offset + struct.calcsize(layout):
            continue
        (length,) = struct.unpack_from(layout, tail, place + offset)
        if limit < length <= end:
            raise RequestError(
                f"{path} lists its contents in {length / 1e6:.0f} MB, which is more than {limit_of(FILES):,.0f} files. "
                f"If it is sound, set {FILES} in the environment (in the studio --unpack-files)."
            )
