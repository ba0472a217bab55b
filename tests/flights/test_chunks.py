"""A log read in chunks is the log: nothing lost, nothing twice, in every format."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from dynamics.errors import RequestError
from flights import Flight, read_chunks, read_log
from flights.readers import csv
from tests.support.flight_files import Truth, crazyflie_log, dataflash_log, flight_csv, manoeuvre, paper_bag, tlog

DATA = Path(__file__).parents[1] / "data"
TRUTH = manoeuvre()


def _tlog(truth: Truth, path: Path) -> Path:
    path.write_bytes(tlog(truth))
    return path


def _dataflash(truth: Truth, path: Path) -> Path:
    path.write_bytes(dataflash_log(truth))
    return path


def _crazyflie(truth: Truth, path: Path) -> Path:
    rows = [(round(t * 1e6), tuple(rate)) for t, rate in zip(truth.time, np.degrees(truth.rate), strict=True)]
    path.write_bytes(crazyflie_log([(f"gyro.{axis}", "d") for axis in "xyz"], rows))
    return path


def _parquet(truth: Truth, path: Path) -> Path:
    return Flight.read(flight_csv(truth, path.with_suffix(".csv"))).to_parquet(path)


MAKERS: list[Callable[[Truth, Path], Path]] = [flight_csv, _parquet, paper_bag, _tlog, _dataflash, _crazyflie]


@pytest.mark.parametrize("make", MAKERS, ids=[make.__name__.strip("_") for make in MAKERS])
def test_chunks_are_the_log(make: Callable[[Truth, Path], Path], tmp_path: Path) -> None:
    path = make(TRUTH, tmp_path / "flight.bag")
    log, chunks = read_log(path), list(read_chunks(path, 2.5))
    assert len(chunks) == 3
    assert {chunk.provenance.sha256 for chunk in chunks} == {log.provenance.sha256}
    for stream in log.streams:
        parts = [part for chunk in chunks for part in chunk.alternatives(stream.name) if part.source == stream.source]
        values = np.concatenate([part.values for part in parts])
        if stream.name == "attitude":  # each chunk chooses the sign of its first attitude by itself
            values = values * np.sign(np.sum(values * stream.values, axis=1))[:, None]
        np.testing.assert_array_equal(values, stream.values, stream.name)


@pytest.mark.parametrize(
    "name",
    [
        "crazyflie/log20.csv.gz",
        "acsl_x8copter/log_20240613_115633_cut.log.gz",
        "pyulog_samples/sample_px4_events.ulg.gz",
    ],
)
def test_real_logs_in_chunks(name: str) -> None:
    log = read_log(DATA / name)
    position = log.stream("position")
    assert position is not None
    chunks = [stream for chunk in read_chunks(DATA / name, 4.0) if (stream := chunk.stream("position")) is not None]
    assert len(chunks) > 1
    np.testing.assert_array_equal(np.concatenate([chunk.values for chunk in chunks]), position.values)


def test_a_long_table_is_parsed_once_for_any_number_of_chunks(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = flight_csv(TRUTH, tmp_path / "flight.csv")
    rows, parsed = len(TRUTH.time), []
    mask = csv.Cut.mask
    monkeypatch.setattr(csv, "_SECTION", path.stat().st_size // 40)
    monkeypatch.setattr(csv.Cut, "mask", lambda cut, block: (parsed.append(len(block["t"])), mask(cut, block))[1])
    chunks = list(read_chunks(path, 0.5))
    assert len(chunks) == 13
    assert rows <= sum(parsed) < 3 * rows  # half a second after each chunk may still hold rows of it


def test_a_stray_stamp_a_year_ahead_is_a_chunk_and_not_ten_million(tmp_path: Path) -> None:
    path = tmp_path / "flight.csv"
    lines = flight_csv(TRUTH, path).read_text().splitlines()
    lines[100] = "3e7," + lines[100].partition(",")[2]
    path.write_text("\n".join(lines) + "\n")
    chunks = list(read_chunks(path, 2.5))
    assert [len(chunk.streams[0].time) for chunk in chunks] == [249, 250, 101, 1]


def test_chunks_of_no_length_are_refused(tmp_path: Path) -> None:
    with pytest.raises(RequestError, match="positive"):
        next(read_chunks(flight_csv(TRUTH, tmp_path / "flight.csv"), 0.0))
