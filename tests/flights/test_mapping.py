"""A column mapping defines every column, or is refused with its error."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from dynamics import frames
from dynamics.errors import RequestError
from flights import read_log
from flights.mapping import read_mapping, shipped
from tests.support.flight_files import manoeuvre

MAPPING = """
name = "mine"
[file]
delimiter = ";"
[time]
column = "stamp"
unit = "ms"
[frames]
world = "NED"
body = "FRD"
[[streams]]
quantity = "position"
columns = ["x", "y", "z"]
unit = "mm"
[[streams]]
quantity = "attitude"
columns = ["qx", "qy", "qz", "qw"]
order = "xyzw"
[[streams]]
quantity = "rate"
columns = ["p", "q", "r"]
unit = "deg/s"
[[streams]]
quantity = "rotor_speed"
columns = ["n1", "n2", "n3", "n4"]
unit = "rpm"
"""


def _write(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "mapping.toml"
    path.write_text(text)
    return path


def test_units_frames_and_orders_are_turned_into_ours(tmp_path: Path) -> None:
    truth = manoeuvre()
    names = "stamp;x;y;z;qx;qy;qz;qw;p;q;r;n1;n2;n3;n4"
    table = np.column_stack(
        [
            1000 * truth.time + 1.7e12,
            1000 * frames.enu_from_ned(truth.position),
            np.roll(frames.attitude_ned_frd(truth.attitude), -1, axis=1),
            np.degrees(frames.flu_from_frd(truth.rate)),
            truth.rotor_speed * 60 / (2 * np.pi),
        ]
    )
    np.savetxt(tmp_path / "log.txt", table, delimiter=";", header=names, comments="", fmt="%.12g")
    log = read_log(tmp_path / "log.txt", mapping=_write(tmp_path, MAPPING))
    for name in ("position", "rate", "rotor_speed"):
        stream = log.stream(name)
        assert stream is not None
        np.testing.assert_allclose(stream.values, getattr(truth, name), rtol=1e-6, atol=1e-6)
        np.testing.assert_allclose(stream.time, truth.time, atol=2e-3)
    attitude = log.stream("attitude")
    assert attitude is not None
    np.testing.assert_allclose(np.abs(np.sum(attitude.values * truth.attitude, axis=1)), 1.0, atol=1e-9)


@pytest.mark.parametrize(
    ("before", "after", "message"),
    [
        ('"mm"', '"inch"', "unknown unit 'inch'; expected m, mm or cm"),
        ('order = "xyzw"', "", "give order"),
        ('quantity = "rate"', 'quantity = "rat"', "did you mean 'rate'"),
        ('["p", "q", "r"]', '["p", "q"]', "rate has 3 columns; 2 are given"),
        ('world = "NED"', 'world = "NWU"', "NWU"),
        ('unit = "ms"', 'units = "ms"', "unknown key 'units'"),
        ('delimiter = ";"', 'delimiter = "tab"', "must be one character"),
        ('delimiter = ";"', "prefix = '('", "missing"),
        ('name = "mine"', "name = mine", "cannot read the column mapping"),
    ],
)
def test_a_wrong_mapping_is_refused_by_name(tmp_path: Path, before: str, after: str, message: str) -> None:
    assert before in MAPPING
    with pytest.raises(RequestError, match=message):
        read_mapping(_write(tmp_path, MAPPING.replace(before, after, 1)))


def test_a_mapping_for_another_table_names_the_missing_columns(tmp_path: Path) -> None:
    (tmp_path / "log.csv").write_text("stamp;x;y\n1;2;3\n")
    with pytest.raises(RequestError, match="needs the columns z, qx"):
        read_log(tmp_path / "log.csv", mapping=_write(tmp_path, MAPPING))


def test_every_shipped_mapping_is_valid_and_describes_itself() -> None:
    assert {mapping.name for mapping in shipped()} >= {"acsl_x8copter", "imrc_lee_crazyflie"}
    assert all(mapping.description for mapping in shipped())
