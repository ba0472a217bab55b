"""Repairs of streams: as a mapping file has them, on any format, refused where the quantity cannot have them."""

from __future__ import annotations

import tomllib
from pathlib import Path

import msgspec
import numpy as np
import pytest

from dynamics.errors import DataError, RequestError
from flights import Flight, read_log
from flights.mapping import read_repairs
from flights.stream_repair import StreamRepair

FLIGHT = Path("tests/data/nanobench/B3_figure8_fast_rep1.csv.gz")
REPAIRS = (
    StreamRepair("position", scale=0.001),
    StreamRepair("attitude", order="xyzw", conjugate=True, axes=("x", "-z", "y"), body_axes=("x", "-z", "y")),
    StreamRepair("rate", turn=((0.0, -1.0, 0.0), (1.0, 0.0, 0.0), (0.0, 0.0, 1.0)), late=0.25),
    StreamRepair("velocity", even=True),
)


@pytest.mark.parametrize("repair", REPAIRS, ids=lambda repair: repair.quantity)
def test_a_repair_is_read_back_as_it_is_written(repair: StreamRepair) -> None:
    (table,) = tomllib.loads(str(repair))["repairs"]
    assert msgspec.convert(table, StreamRepair) == repair


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        ('quantity = "positon"', "unknown quantity 'positon'.*position"),
        ('quantity = "position"\nscale = 0', "scale and late must be finite"),
        ('quantity = "position"\norder = "xyzw"', "position is no attitude: leave order out"),
        ('quantity = "attitude"\norder = "zyxw"', "give 'wxyz' or 'xyzw'"),
        ('quantity = "battery_voltage"\naxes = ["x", "y", "z"]', "is no vector"),
        ('quantity = "position"\naxes = ["x", "x", "z"]', "no three axes"),
        ('quantity = "position"\nturn = [[1, 0, 0], [0, 1, 0]]', "three rows of three"),
        ('quantity = "position"\nturn = [[1, 0, 0], [0, 2, 0], [0, 0, 1]]', "unit vectors at right angles"),
        ('quantity = "attitude"\naxes = ["-x", "y", "z"]', "must be right-handed"),
        ('quantity = "position"\nscal = 2', "unknown key 'scal'.*scale"),
    ],
)
def test_a_wrong_repair_is_refused_with_what_is_wrong(lines: str, message: str, tmp_path: Path) -> None:
    path = tmp_path / "wrong.toml"
    path.write_text(f'name = "wrong"\n[[repairs]]\n{lines}\n')
    with pytest.raises(RequestError, match=message):
        read_repairs(path)


def test_a_file_of_repairs_reads_any_format(tmp_path: Path) -> None:
    repairs = tmp_path / "repairs.toml"
    repairs.write_text('name = "millimetres"\n' + str(StreamRepair("position", scale=0.001)) + "\n")
    real = Flight.read(FLIGHT)
    wrong = real.columns | {f"position_{axis}": 1000 * real[f"position_{axis}"] for axis in "xyz"}
    path = Flight(real.time, wrong, real.provenance).to_csv(tmp_path / "wrong.csv")
    with pytest.raises(DataError, match="the position is in mm"):
        read_log(path)
    log = read_log(path, mapping=repairs)
    np.testing.assert_allclose(Flight.from_log(log)["position"], real["position"], atol=1e-6)
    assert [repair.name for repair in log.provenance.repairs] == ["mapped_repair"]


def test_a_repair_of_what_the_log_has_not_is_refused(tmp_path: Path) -> None:
    repairs = tmp_path / "repairs.toml"
    repairs.write_text('name = "none"\n' + str(StreamRepair("battery_current", scale=0.001)) + "\n")
    with pytest.raises(DataError, match="repairs battery_current, which is not in this log"):
        read_log(FLIGHT, mapping=repairs)
