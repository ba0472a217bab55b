"""Compressed logs that would fill the disk, or the memory, are refused while they are unpacked."""

from __future__ import annotations

import bz2
import gzip
import io
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import lz4.frame
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pa_parquet
import pytest
import zstandard
from mcap.writer import CompressionType, Writer
from rosbags.highlevel import AnyReader
from rosbags.rosbag1 import Writer as Ros1Writer
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as Ros2Writer
from rosbags.typesys import Stores, get_typestore

from dynamics import mcap_chunks, unpacking
from dynamics.array_file import read_arrays
from dynamics.errors import RequestError
from dynamics.packed_chunks import METHODS, unpacked
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


def _mcap(path: Path, compression: CompressionType) -> Path:
    with path.open("wb") as file:
        writer = Writer(file, chunk_size=1 << 30, compression=compression)
        writer.start(profile="", library="")
        channel = writer.register_channel("/imu", "json", 0)
        for _ in range(10):
            writer.add_message(channel, 0, bytes(20_000_000), 0)
        writer.finish()
    return path


def _bag_of_ros1(path: Path, compression: Ros1Writer.CompressionFormat, size: int) -> Path:
    store = get_typestore(Stores.ROS1_NOETIC)
    text = store.types["std_msgs/msg/String"](data="\0" * size)
    bag = Ros1Writer(path)
    bag.set_compression(compression)
    with bag as writer:
        connection = writer.add_connection("/odom", "nav_msgs/msg/Odometry", typestore=store)
        writer.write(connection, 0, store.serialize_ros1(text, "std_msgs/msg/String"))
    return path


def _bag_of_ros2(path: Path, storage: StoragePlugin, mode: CompressionMode, size: int) -> Path:
    store = get_typestore(Stores.ROS2_HUMBLE)
    text = store.types["std_msgs/msg/String"](data="\0" * size)
    bag = Ros2Writer(path, version=9, storage_plugin=storage)
    bag.set_compression(mode, CompressionFormat.ZSTD)
    with bag as writer:
        connection = writer.add_connection("/odom", "nav_msgs/msg/Odometry", typestore=store)
        writer.write(connection, 0, store.serialize_cdr(text, "std_msgs/msg/String"))
    return path


def _parquet(path: Path, rows: int, **options: Any) -> Path:
    pa_parquet.write_table(
        pa.table({"t": pa.array(np.zeros(rows)), "position_x": pa.array(np.zeros(rows))}), path, **options
    )
    return path


ROS1, ROS2 = Ros1Writer.CompressionFormat, CompressionMode
BOMBS: dict[str, Callable[[Path, int], Path]] = {
    "ros1 bz2": lambda path, size: _bag_of_ros1(path / "a.bag", ROS1.BZ2, size),
    "ros1 lz4": lambda path, size: _bag_of_ros1(path / "a.bag", ROS1.LZ4, size),
    "ros2 file": lambda path, size: _bag_of_ros2(path / "a", StoragePlugin.SQLITE3, ROS2.FILE, size),
    "ros2 message": lambda path, size: _bag_of_ros2(path / "a", StoragePlugin.SQLITE3, ROS2.MESSAGE, size),
    "ros2 mcap chunk": lambda path, size: _bag_of_ros2(path / "a", StoragePlugin.MCAP, ROS2.STORAGE, size),
    "parquet plain": lambda path, size: _parquet(
        path / "a.parquet", size // 16, use_dictionary=False, compression="zstd"
    ),
    "parquet dictionary": lambda path, size: _parquet(path / "a.parquet", size // 16),
}


@pytest.mark.parametrize("kind", BOMBS)
def test_a_bag_or_a_table_that_fills_the_memory_is_refused_while_it_is_unpacked(
    kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With limits of a thousandth: what counts is the ratio, and how much has come out when it is refused."""
    counted: list[int] = []
    add = unpacking.Unpacking.add_bytes
    monkeypatch.setattr(unpacking, "FREE_BYTES", 1 << 20)
    monkeypatch.setattr(
        unpacking.Unpacking, "add_bytes", lambda self, n, packed: (add(self, n, packed), counted.append(n))
    )
    bag = BOMBS[kind](tmp_path, 40_000_000)
    with pytest.raises(RequestError, match=r"unpacks to more than 100 times.*ALULA_UNPACK_RATIO"):
        read_log(bag)
    assert sum(counted) < 20_000_000


@pytest.mark.parametrize("kind", [kind for kind in BOMBS if kind.startswith("ros")])
def test_whoever_reads_bags_beside_us_has_the_librarys_own_decompressors(kind: str, tmp_path: Path) -> None:
    bag = BOMBS[kind](tmp_path, 40_000_000)
    with AnyReader([bag], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
        ((_, _, content),) = reader.messages()
    assert len(content) > 40_000_000


@pytest.mark.parametrize("compression", [CompressionType.LZ4, CompressionType.ZSTD])
def test_a_chunk_of_mcap_is_refused_whatever_it_is_packed_by(
    compression: CompressionType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(mcap_chunks, "breakup_chunk", None)
    path = _mcap(tmp_path / "flight.mcap", compression)
    with pytest.raises(RequestError, match=r"flight\.mcap.*unpacks to more than 100 times"):
        read_log(path)


@pytest.mark.parametrize("method", METHODS)
def test_chunks_within_the_limits_are_unpacked_whole(method: str, tmp_path: Path) -> None:
    content = np.random.default_rng(1).integers(0, 4, 3_000_000).astype(np.uint8).tobytes()
    pack = {"bz2": bz2.compress, "lz4": lz4.frame.compress, "zstd": zstandard.compress}[method]
    (tmp_path / "log").write_bytes(b"log")
    assert unpacked(pack(content) + pack(content), method, tmp_path / "log") == 2 * content
    for damaged in (pack(content)[:-9], b"none of it"):
        with pytest.raises(ValueError, match="damaged"):
            unpacked(damaged, method, tmp_path / "log")


def test_arrays_that_fill_the_memory_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(unpacking, "FREE_BYTES", 1 << 20)
    path = tmp_path / "a.npz"
    np.savez_compressed(path, a=np.zeros(1_000_000))
    with pytest.raises(RequestError, match=r"a\.npz.*unpacks to more than 100 times"):
        read_arrays(path, advice="Export again.")
