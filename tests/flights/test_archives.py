"""A zip with one log is read as that log; with several, they are named; an encrypted ULog is named for what it is."""

from __future__ import annotations

import gzip
import zipfile
from pathlib import Path

import numpy as np
import pytest
from rosbags.rosbag2 import StoragePlugin

from dynamics.errors import AlulaError, DataError, RequestError
from flights import read_log
from flights.folder import folder_content
from flights.reading import read_chunks
from tests.support.flight_files import Truth, flight_csv, manoeuvre, ros2_bag


@pytest.fixture(scope="module")
def truth() -> Truth:
    return manoeuvre(duration=2.0, rate=50.0)


def _zip(path: Path, members: dict[str, bytes]) -> Path:
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as packed:
        for name, data in members.items():
            packed.writestr(name, data)
    return path


def _csv(truth: Truth, folder: Path) -> bytes:
    return flight_csv(truth, folder / "plain.csv").read_bytes()


def _assert_read(path: Path, truth: Truth) -> None:
    position = read_log(path).stream("position")
    assert position is not None
    np.testing.assert_array_equal(position.values, truth.position)


@pytest.mark.parametrize("packed_twice", [False, True])
def test_the_one_log_of_a_zip_is_read_beside_files_that_are_none(
    truth: Truth, tmp_path: Path, packed_twice: bool
) -> None:
    data = _csv(truth, tmp_path)
    members = {
        "notes.txt": b"windy",
        "__MACOSX/._flight.csv": b"\0\5\x16\7",
        "day/.DS_Store": b"\0",
        "day/flight.csv": gzip.compress(data) if packed_twice else data,
    }
    path = _zip(tmp_path / "flight.zip", members)
    _assert_read(path, truth)
    assert read_log(path).provenance.path == str(path)
    assert len(list(read_chunks(path, 1.0))) == 3


def test_a_zipped_bag_of_ros2_is_one_log(truth: Truth, tmp_path: Path) -> None:
    bag = ros2_bag(truth, tmp_path / "bag", body_velocity=True, storage=StoragePlugin.SQLITE3)
    path = _zip(tmp_path / "bag.zip", {f"bag/{file.name}": file.read_bytes() for file in bag.iterdir()})
    _assert_read(path, truth)


def test_several_logs_of_a_zip_are_named_and_one_is_asked_for(truth: Truth, tmp_path: Path) -> None:
    data = _csv(truth, tmp_path)
    path = _zip(tmp_path / "day.zip", {"a.csv": data, "b.csv": data, "notes.txt": b"windy"})
    with pytest.raises(RequestError, match=r"holds 2 logs: a\.csv, b\.csv\. Unpack it"):
        read_log(path)
    (tmp_path / "plain.csv").unlink()
    assert folder_content(tmp_path).logs == (path,)  # it is refused by name, and not passed over


def test_a_zip_without_a_log_is_none_of_a_folder(truth: Truth, tmp_path: Path) -> None:
    flight_csv(truth, tmp_path / "a.csv")
    path = _zip(tmp_path / "pictures.zip", {"a.txt": b"windy", "b.png": b"\x89PNG\r\n"})
    with pytest.raises(RequestError, match=r"holds no log of a known format \(a\.txt, b\.png\)"):
        read_log(path)
    assert folder_content(tmp_path).others == (path,)


@pytest.mark.parametrize("name", ["../flight.csv", "/flight.csv", "a/../../flight.csv", "..\\flight.csv", "C:\\f.csv"])
def test_a_name_that_leads_out_of_the_folder_is_refused(truth: Truth, tmp_path: Path, name: str) -> None:
    path = _zip(tmp_path / "flight.zip", {name: _csv(truth, tmp_path)})
    (tmp_path / "plain.csv").unlink()
    with pytest.raises(DataError, match="leads out of the folder"):
        read_log(path)
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize(
    ("variable", "limit", "message"),
    [("ALULA_UNPACK_FILES", "1", "more than 1 files"), ("ALULA_UNPACK_GB", "0.00001", "more than 1e-05 GB")],
)
def test_the_limits_of_all_compressed_files_hold(
    truth: Truth, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, variable: str, limit: str, message: str
) -> None:
    path = _zip(tmp_path / "flight.zip", {"a.txt": b"", "flight.csv": _csv(truth, tmp_path)})
    monkeypatch.setenv(variable, limit)
    with pytest.raises(RequestError, match=message):
        read_log(path)


def test_a_zip_bomb_is_not_unpacked(tmp_path: Path) -> None:
    with pytest.raises(RequestError, match="100 times the bytes"):
        read_log(_zip(tmp_path / "zeros.zip", {"flight.csv": bytes(80 << 20)}))


def test_what_is_no_zip_of_a_log_is_named_for_what_it_is(truth: Truth, tmp_path: Path) -> None:
    intact = _zip(tmp_path / "flight.zip", {"flight.csv": _csv(truth, tmp_path)}).read_bytes()
    cases = {
        "cut off": intact[: len(intact) // 2],
        "is damaged": intact[:200] + bytes(100) + intact[300:],
        "without a file": _zip(tmp_path / "a.zip", {}).read_bytes(),
        "a spreadsheet": _zip(tmp_path / "b.zip", {"xl/workbook.xml": b"<a/>"}).read_bytes(),
    }
    for message, data in cases.items():
        (tmp_path / "case.zip").write_bytes(data)
        with pytest.raises(DataError, match=message):
            read_log(tmp_path / "case.zip")


def test_every_end_of_a_zip_gives_an_error_of_ours(truth: Truth, tmp_path: Path) -> None:
    intact = _zip(tmp_path / "flight.zip", {"flight.csv": _csv(truth, tmp_path)[:4000]}).read_bytes()
    for end in range(4, len(intact), 37):
        (tmp_path / "cut.zip").write_bytes(intact[:end])
        with pytest.raises(AlulaError):
            read_log(tmp_path / "cut.zip")


def test_an_encrypted_ulog_names_what_decrypts_it(tmp_path: Path) -> None:
    (tmp_path / "flight.ulge").write_bytes(b"ULogEnc\x01" + bytes(8) + b"\x04\x02\x00\x01" + bytes(range(256)))
    with pytest.raises(DataError, match=r"encrypted: decrypt it with PX4's Tools/decrypt_ulog\.py"):
        read_log(tmp_path / "flight.ulge")
    assert folder_content(tmp_path).logs == (tmp_path / "flight.ulge",)
