"""Archives that are bombs, or that would write where they should not, are refused before they have done harm."""

from __future__ import annotations

import random
import stat
import time
import zipfile
from pathlib import Path

import pytest

from dynamics import unpacking
from dynamics.errors import RequestError
from dynamics.unpacking import BYTES, FILES, RATIO
from studio.case import archive as archives
from studio.case.archive import unpack_archive, write_archive
from studio.case.case import Case


@pytest.fixture
def plain(tmp_path: Path) -> Path:
    """A sound archive."""
    log = tmp_path / "flight.csv"
    log.write_text("t\n" + "".join(f"{n}\n" for n in range(1000)))
    case = Case.create(tmp_path / "case")
    case.add_logs([log])
    path = write_archive(case, tmp_path / "plain.zip")
    case.close()
    return path


@pytest.fixture(autouse=True)
def watched(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Bytes that were unpacked."""
    counts = [0]
    add = unpacking.Unpacking.add_bytes

    def counted(self: unpacking.Unpacking, count: int, packed: int) -> None:
        add(self, count, packed)
        counts[0] += count

    monkeypatch.setattr(unpacking.Unpacking, "add_bytes", counted)
    return counts


def _refused(path: Path, match: str) -> None:
    target = path.parent / "cases" / "unpacked"
    with pytest.raises(RequestError, match=match):
        unpack_archive(path, target)
    assert not any(target.parent.iterdir())


def _with(plain: Path, *entries: zipfile.ZipInfo | str, data: bytes = b"x") -> Path:
    with zipfile.ZipFile(plain, "a", zipfile.ZIP_DEFLATED) as archive:
        for entry in entries:
            archive.writestr(entry, data)
    return plain


def _special(name: str, kind: int) -> zipfile.ZipInfo:
    entry = zipfile.ZipInfo(name)
    entry.external_attr = (kind | 0o777) << 16
    return entry


BAD_NAMES = (
    "../x", "logs/../../x", "/etc/x", "C:/x", "C:x", "..\\x", "logs\\..\\..\\x", "logs/./x", "logs//x", ".lock", "nul",
    "logs/con.csv", "logs/COM1", "logs/LPT9.txt", "logs/x.", "logs/x ", "logs/a\nb", "logs/a\x1b[2J", "..",
)  # fmt: skip


@pytest.mark.parametrize("name", BAD_NAMES)
def test_a_name_that_is_no_plain_one_is_refused(plain: Path, name: str) -> None:
    _refused(_with(plain, name), "was not opened")
    assert not (plain.parent / "x").exists()


@pytest.mark.parametrize("kind", [stat.S_IFLNK, stat.S_IFIFO, stat.S_IFCHR, stat.S_IFBLK, stat.S_IFSOCK])
def test_links_and_devices_are_refused(plain: Path, kind: int) -> None:
    _refused(_with(plain, _special("logs/link", kind), data=b"/etc/passwd"), "link or a device")


@pytest.mark.filterwarnings("ignore:Duplicate name")
@pytest.mark.parametrize("names", [("a", "a"), ("logs/a", "LOGS/A"), ("a\u0301", "\u00e1")])
def test_a_name_twice_is_refused(plain: Path, names: tuple[str, str]) -> None:
    _refused(_with(plain, *names), "twice")


def test_a_name_that_is_a_file_and_a_folder_is_refused(plain: Path) -> None:
    _refused(_with(plain, "a", "a/b"), "a file and a folder")


@pytest.mark.parametrize("method", [zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA])
def test_other_ways_of_packing_whose_output_has_no_bound_are_refused(plain: Path, method: int) -> None:
    entry = zipfile.ZipInfo("logs/a")
    entry.compress_type = method
    _refused(_with(plain, entry), "packed in another way")


def test_an_encrypted_file_is_refused(plain: Path) -> None:
    content = bytearray(plain.read_bytes())
    place = content.rfind(b"PK\1\2")
    content[place + 8] |= 1
    plain.write_bytes(content)
    _refused(plain, "encrypted")


@pytest.mark.parametrize("megabytes", [400, 2000])
def test_a_bomb_is_refused_while_it_is_unpacked(tmp_path: Path, watched: list[int], megabytes: int) -> None:
    path = tmp_path / "bomb.zip"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
        archive.writestr("case.json", "{}")
        with archive.open("logs/zeros", "w", force_zip64=True) as file:
            for _ in range(megabytes):
                file.write(bytes(1_000_000))
    _refused(path, "more than 100 times the bytes.*ALULA_UNPACK_RATIO")
    assert watched[0] <= unpacking.FREE_BYTES


def test_files_that_overlap_are_refused(tmp_path: Path, watched: list[int]) -> None:
    path = tmp_path / "overlap.zip"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("case.json", "{}")
        archive.writestr("logs/00", random.Random(1).randbytes(100_000))
        kernel = archive.infolist()[-1]
        for number in range(1, 50):
            entry = zipfile.ZipInfo(f"logs/{number:02d}")
            for name in ("header_offset", "compress_size", "file_size", "CRC", "compress_type", "flag_bits"):
                setattr(entry, name, getattr(kernel, name))
            archive.filelist.append(entry)
    _refused(path, "overlap")
    assert watched[0] == 0


def test_too_many_files_are_refused_before_they_are_written(plain: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(FILES, "20")
    _refused(_with(plain, *(f"logs/{number}" for number in range(30))), "more than 20 files.*ALULA_UNPACK_FILES")
    monkeypatch.setenv(FILES, "40")
    unpack_archive(plain, plain.parent / "cases" / "raised")


def test_a_list_of_contents_too_long_to_read_is_refused_unread(plain: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(archives, "BYTES_OF_ENTRY", 10)
    monkeypatch.setenv(FILES, "5")
    monkeypatch.setattr(archives.zipfile, "ZipFile", None)
    _refused(plain, "lists its contents")


def test_limits_are_raised_by_the_environment(plain: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(BYTES, "0.000001")
    _refused(plain, "more than 1e-06 GB.*ALULA_UNPACK_GB")
    monkeypatch.setenv(BYTES, "none")
    _refused(plain, "Give a positive number")
    monkeypatch.delenv(BYTES)
    monkeypatch.setattr(unpacking, "FREE_BYTES", 0)
    monkeypatch.setenv(RATIO, "1.5")
    _refused(plain, "more than 1.5 times")
    monkeypatch.setenv(RATIO, "1000")
    unpack_archive(plain, plain.parent / "cases" / "raised")


def test_a_damaged_archive_is_refused_whatever_is_damaged(plain: Path) -> None:
    intact = plain.read_bytes()
    choice = random.Random(time.time_ns())
    for number in range(300):
        content = bytearray(intact)
        for _ in range(choice.randint(1, 4)):
            content[choice.randrange(len(content))] = choice.randrange(256)
        if number % 3 == 0:
            content = content[: choice.randrange(len(content))]
        plain.write_bytes(content)
        target = plain.parent / "cases" / str(number)
        try:
            unpack_archive(plain, target)
        except RequestError:
            assert not target.exists()
        assert not list(target.parent.glob(".*"))


def test_names_that_people_give_are_unpacked(tmp_path: Path) -> None:
    names = ["2026-01-01T12:00:00.csv", "flug ä.csv", "aux.csv", "a.b.csv", ".hidden", "con"]
    case = Case.create(tmp_path / "case")
    bag = tmp_path / "bag"
    bag.mkdir()
    (bag / "metadata.yaml").write_text("x")
    (bag / ".DS_Store").write_text("y")
    for number, name in enumerate(names):
        (tmp_path / name).write_text(f"t\n{number}\n")
    case.add_logs([*(tmp_path / name for name in names), bag])
    there = Case.open(unpack_archive(write_archive(case, tmp_path / "sent.zip"), tmp_path / "there"))
    assert len(there.log_paths) == len(names) + 1
    assert all(path.exists() for path in there.log_paths)
    there.close()
    case.close()
