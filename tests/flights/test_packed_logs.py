"""Compressed logs that would fill the disk, or the memory, are refused while they are unpacked."""

from __future__ import annotations

import gzip
import io
import tempfile
from pathlib import Path

import pytest
from mcap.writer import CompressionType, Writer

from dynamics import mcap_chunks, unpacking
from dynamics.errors import RequestError
from dynamics.references.table import read_table
from dynamics.unpacking import BYTES, FREE_BYTES, RATIO, gunzip
from dynamics.vehicle import Vehicle
from flights import read_log
from flights.folder import folder_content
from flights.followed import read_followed
from runtime.record.recording import read_recording
from runtime.record.tlog import read_tlog


@pytest.fixture(scope="module")
def bomb(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A gzip of 0.4 GB of zeros."""
    path = tmp_path_factory.mktemp("bomb") / "log.csv.gz"
    with gzip.open(path, "wb", 1) as file:
        for _ in range(400):
            file.write(bytes(1_000_000))
    return path


class Counted(io.BytesIO):
    """A file that only counts what is written."""

    count = 0

    def write(self, content: object) -> int:
        self.count += len(content)  # type: ignore[arg-type]
        return len(content)  # type: ignore[arg-type]


def test_a_log_of_zeros_is_refused_after_few_bytes_and_leaves_nothing(
    bomb: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    with pytest.raises(RequestError, match=r"log\.csv\.gz \(\d\.\d MB\) unpacks to more than 100 times.*ALULA_UNPACK"):
        read_log(bomb)
    assert list(tmp_path.iterdir()) == []
    target = Counted()
    with pytest.raises(RequestError):
        gunzip(bomb, target)
    assert target.count <= FREE_BYTES


def test_every_reader_of_packed_files_has_the_limit(bomb: Path, tmp_path: Path, arpl_250g: Vehicle) -> None:
    tlog = tmp_path / "log.tlog.gz"
    tlog.symlink_to(bomb)
    with pytest.raises(RequestError, match="unpacks to"):
        list(read_tlog(tlog))
    with pytest.raises(RequestError, match="unpacks to"):
        read_table(bomb, arpl_250g)


def test_a_bomb_among_logs_stops_no_folder(bomb: Path) -> None:
    assert folder_content(bomb.parent).logs in ((), (bomb,))


def test_the_limits_are_raised_by_the_environment(bomb: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(RATIO, "2000")
    target = Counted()
    assert gunzip(bomb, target) is None
    assert target.count == 400_000_000
    monkeypatch.setenv(BYTES, "0.3")
    with pytest.raises(RequestError, match=r"more than 0\.3 GB.*ALULA_UNPACK_GB"):
        gunzip(bomb, Counted())
    small = tmp_path / "small.gz"
    small.write_bytes(gzip.compress(b"x" * 1000))
    monkeypatch.setattr(unpacking, "FREE_BYTES", 0)
    monkeypatch.setenv(RATIO, "-1")
    with pytest.raises(RequestError, match="Give a positive number"):
        gunzip(small, Counted())


def test_a_torn_packed_table_is_refused_with_its_name(tmp_path: Path, arpl_250g: Vehicle) -> None:
    path = tmp_path / "table.csv.gz"
    path.write_bytes(gzip.compress(b"t,x,y,z\n" * 100)[:-9])
    with pytest.raises(RequestError, match=r"table\.csv\.gz.*ends early"):
        read_table(path, arpl_250g)


def test_a_chunk_of_a_recording_that_fills_the_memory_is_refused_before_it_is_unpacked(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "flight.mcap"
    with path.open("wb") as file:
        writer = Writer(file, chunk_size=1 << 30, compression=CompressionType.ZSTD)
        writer.start(profile="", library="")
        channel = writer.register_channel("/imu", "json", 0)
        for _ in range(10):
            writer.add_message(channel, 0, bytes(20_000_000), 0)
        writer.finish()
    assert path.stat().st_size < 1_000_000
    monkeypatch.setattr(mcap_chunks, "breakup_chunk", None)
    for read in (read_log, read_recording, read_followed):
        with pytest.raises(RequestError, match=r"flight\.mcap.*unpacks to more than 100 times"):
            read(path)
