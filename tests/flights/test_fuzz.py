"""No bytes, however wrong, end in anything but a log or an error with a name."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from dynamics.errors import AlulaError
from flights import Flight, Log, read_log
from tests.support.flight_files import Truth, crazyflie_log, manoeuvre, tlog

MAGICS = (
    b"", b"\xa3\x95\x80\x80\x59FMT\0BBnNZ",
    b"ULog\x01\x12\x35\x01", b"\x89MCAP0\r\n", b"#ROSBAG V2.0\n", b"SQLite format 3\0", b"PAR1", b"\xbc\x02\x00",
    b"\xbc\x01\x00\x01\x00", b"\xa3\x95\x80", b"\x1f\x8b\x08", b"H Product:Blackbox", b"t,position_x\n",
    struct.pack(">Q", 1_700_000_000_000_000) + b"\xfd",
)  # fmt: skip
FUZZ = settings(max_examples=150, suppress_health_check=[HealthCheck.function_scoped_fixture])


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("fuzz")


def _read(path: Path, data: bytes, *, named: bool = True) -> Log | None:
    """What the bytes read as. named: whether an error must have been foreseen by the reader itself."""
    path.write_bytes(data)
    try:
        log = read_log(path)
        Flight.from_log(log)
    except AlulaError as error:
        if named and error.__cause__ is not None and not isinstance(error.__cause__, AlulaError):
            raise error.__cause__ from None
        return None
    for stream in log.streams:
        assert (np.diff(stream.time) > 0).all()
        assert np.isfinite(stream.time).all()
        assert len(stream.time) == len(stream.values)
    return log


@given(magic=st.sampled_from(MAGICS), rest=st.binary(max_size=400))
@FUZZ
def test_any_bytes(folder: Path, magic: bytes, rest: bytes) -> None:
    _read(folder / "any", magic + rest, named=False)


CELL = st.one_of(
    st.floats(allow_nan=True, allow_infinity=True).map(repr), st.integers(-(10**20), 10**20).map(str),
    st.sampled_from(["", "nan", "x", "1e400", '"', "0x1", " 1 ", "1;2", "−1"]),
)  # fmt: skip
HEADERS = ("t", "position_x", "position_y", "position_z", "battery_voltage", "armed", "", "t ", "rotor_speed_0", "foo")


@given(
    header=st.lists(st.sampled_from(HEADERS), min_size=2, max_size=6),
    rows=st.lists(st.lists(CELL, min_size=1, max_size=7), max_size=12),
    end=st.sampled_from(["\n", "\r\n", ""]),
)
@example(header=["t", "armed"], rows=[["0", "1"], ["1e9", "1"]], end="\n")
@FUZZ
def test_any_table(folder: Path, header: list[str], rows: list[list[str]], end: str) -> None:
    text = (end or "\n").join([",".join(header), *(",".join(row) for row in rows)]) + end
    _read(folder / "table.csv", text.encode())


@given(
    times=st.lists(st.integers(0, 2**40), min_size=1, max_size=30),
    flips=st.lists(st.tuples(st.integers(0, 10**6), st.integers(0, 255)), max_size=4),
    cut=st.integers(0, 60),
)
@FUZZ
def test_a_crazyflie_log_with_flipped_bytes(
    folder: Path, times: list[int], flips: list[tuple[int, int]], cut: int
) -> None:
    variables = [*((f"stateEstimateZ.{axis}", "h") for axis in "xyz"), ("pm.vbat", "f")]
    data = bytearray(crazyflie_log(variables, [(time, (1, 2, 3, 3.7)) for time in times]))
    undamaged = not flips and not cut and sorted(set(times)) == times
    for position, value in flips:
        data[position % len(data)] = value
    log = _read(folder / "log", bytes(data[: len(data) - cut]))
    if undamaged and len(times) > 1 and max(times) < 4e10:
        assert log is not None
        assert not log.provenance.repairs


SHORT = manoeuvre(duration=0.3)


@given(
    flips=st.lists(st.tuples(st.integers(0, 10**6), st.integers(0, 255)), max_size=6),
    inserted=st.binary(max_size=60),
    at=st.integers(0, 10**6),
    cut=st.integers(0, 200),
)
@FUZZ
def test_a_tlog_with_flipped_and_inserted_bytes(
    folder: Path, flips: list[tuple[int, int]], inserted: bytes, at: int, cut: int
) -> None:
    data = bytearray(TLOG)
    for position, value in flips:
        data[12 + position % (len(data) - 12)] = value
    place = 12 + at % (len(data) - 12)
    log = _read(folder / "noisy.tlog", bytes(data[:place]) + inserted + bytes(data[place : len(data) - cut]))
    if log is not None:
        _assert_within(log, SHORT)


TLOG = tlog(SHORT)


def _assert_within(log: Log, truth: Truth) -> None:
    """Frames whose checksum holds carry the truth; a flipped byte must not get through as a value."""
    stream = log.stream("position")
    if stream is not None:
        low, high = truth.position.min(axis=0) - 1e-3, truth.position.max(axis=0) + 1e-3
        assert (stream.values > low).all()
        assert (stream.values < high).all()
