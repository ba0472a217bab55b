"""A log read in pieces is the log: nothing lost, nothing twice, whatever its format."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from dynamics.errors import RequestError
from flights import Flight, read_log, read_pieces
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
def test_pieces_are_the_whole(make: Callable[[Truth, Path], Path], tmp_path: Path) -> None:
    path = make(TRUTH, tmp_path / "flight.bag")
    whole, pieces = read_log(path), list(read_pieces(path, 2.5))
    assert len(pieces) == 3
    assert {piece.provenance.sha256 for piece in pieces} == {whole.provenance.sha256}
    for stream in whole.streams:
        parts = [part for piece in pieces for part in piece.alternatives(stream.name) if part.source == stream.source]
        values = np.concatenate([part.values for part in parts])
        if stream.name == "attitude":  # each piece chooses the sign of its first attitude by itself
            values = values * np.sign(np.sum(values * stream.values, axis=1))[:, None]
        np.testing.assert_array_equal(values, stream.values, stream.name)


@pytest.mark.parametrize(
    "name", ["crazyflie/log20.csv.gz", "acsl_x8copter/log_20240613_115633_cut.log.gz",
             "pyulog_samples/sample_px4_events.ulg.gz"]
)  # fmt: skip
def test_real_logs_in_pieces(name: str) -> None:
    whole = read_log(DATA / name)
    position = whole.stream("position")
    assert position is not None
    pieces = [stream for piece in read_pieces(DATA / name, 4.0) if (stream := piece.stream("position")) is not None]
    assert len(pieces) > 1
    np.testing.assert_array_equal(np.concatenate([piece.values for piece in pieces]), position.values)


def test_a_long_table_is_looked_at_once_however_many_pieces(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = flight_csv(TRUTH, tmp_path / "flight.csv")
    rows, looked = len(TRUTH.time), []
    mask = csv.Cut.mask
    monkeypatch.setattr(csv, "_SECTION", path.stat().st_size // 40)
    monkeypatch.setattr(csv.Cut, "mask", lambda cut, block: (looked.append(len(block["t"])), mask(cut, block))[1])
    pieces = list(read_pieces(path, 0.5))
    assert len(pieces) == 13
    assert rows <= sum(looked) < 3 * rows  # half a second after each piece may still hold rows of it


def test_a_stray_stamp_a_year_ahead_is_a_piece_and_not_ten_million(tmp_path: Path) -> None:
    path = tmp_path / "flight.csv"
    lines = flight_csv(TRUTH, path).read_text().splitlines()
    lines[100] = "3e7," + lines[100].partition(",")[2]
    path.write_text("\n".join(lines) + "\n")
    pieces = list(read_pieces(path, 2.5))
    assert [len(piece.streams[0].time) for piece in pieces] == [249, 250, 101, 1]


def test_pieces_of_no_length_are_refused(tmp_path: Path) -> None:
    with pytest.raises(RequestError, match="positive"):
        next(read_pieces(flight_csv(TRUTH, tmp_path / "flight.csv"), 0.0))
