"""Repairs that were found are written so that they are read back, whatever the log and the file are called."""

from __future__ import annotations

from pathlib import Path

import pytest

from dynamics.errors import RequestError
from flights.hypotheses import Hypothesis
from flights.hypotheses.mapping_file import write_repairs
from flights.mapping import read_mapping, read_repairs
from flights.stream_repair import StreamRepair

MILLIMETRES = StreamRepair("position", scale=0.001)
TURNED = StreamRepair("rate", turn=((0.0, -1.0, 0.0), (1.0, 0.0, 0.0), (0.0, 0.0, 1.0)), late=0.25)
HYPOTHESES = [
    Hypothesis("position_unit", "in mm", "moves", (MILLIMETRES,)),
    Hypothesis("clock", "late", "follows", (TURNED,)),
]
MAPPING = """name = "mine"
[time]
column = "t"
[frames]
world = "ENU"
body = "FLU"
[[streams]]  # of the tracker
quantity = "position"
columns = ["x", "y", "z"]
"""


@pytest.mark.parametrize("log", ["flight.csv", 'a"b.csv', "a\n[[repairs]]\nquantity = 'rate'\n.csv"])
@pytest.mark.parametrize("name", ["repairs.toml", 'say "mm".toml'])
def test_repairs_alone_are_read_back(tmp_path: Path, log: str, name: str) -> None:
    assert read_repairs(write_repairs(HYPOTHESES, tmp_path / name, log=Path(log))) == (False, (MILLIMETRES, TURNED))


@pytest.mark.parametrize("earlier", ["", "repairs = [{quantity = 'time', scale = 0.001}]\n"])
def test_they_follow_those_of_the_mapping_which_stays_as_it_is(tmp_path: Path, earlier: str) -> None:
    mapping = tmp_path / "mine.toml"
    mapping.write_text(earlier + MAPPING)
    written = write_repairs(HYPOTHESES, tmp_path / "repaired.toml", log=Path("flight.csv"), mapping=mapping)
    assert mapping.read_text() == earlier + MAPPING
    assert "# of the tracker" in written.read_text()
    first = (StreamRepair("time", scale=0.001),) if earlier else ()
    assert read_mapping(written).repairs == (*first, MILLIMETRES, TURNED)


def test_no_file_is_written_over(tmp_path: Path) -> None:
    path = tmp_path / "repairs.toml"
    path.write_text("mine")
    with pytest.raises(RequestError, match="exists already"):
        write_repairs(HYPOTHESES, path, log=Path("flight.csv"))
    assert path.read_text() == "mine"
