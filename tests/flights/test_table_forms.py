"""Tables as spreadsheets, pandas and ROS write them: decimal commas, times as text or in two parts, lists in cells."""

from __future__ import annotations

import datetime
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas
import pytest

from dynamics.arrays import Floats
from dynamics.errors import DataError, RequestError
from flights import Log, read_log
from flights.mapping import read_mapping
from flights.reading import read_chunks
from tests.support.flight_files import Truth, flight_csv, manoeuvre

START = datetime.datetime(2026, 4, 1, 23, 59, 59, 950_000, tzinfo=datetime.UTC)  # over midnight


@pytest.fixture(scope="module")
def truth() -> Truth:
    return manoeuvre(duration=2.0, rate=50.0)


@pytest.fixture
def table(truth: Truth, tmp_path: Path) -> pandas.DataFrame:
    return pandas.read_csv(flight_csv(truth, tmp_path / "plain.csv"))


def _assert_is(log: Log, truth: Truth, *, within: float = 1e-6) -> None:
    for name in ("position", "velocity", "attitude", "rate", "specific_force", "rotor_speed"):
        stream = log.stream(name)
        assert stream is not None, name
        np.testing.assert_allclose(stream.values, getattr(truth, name), atol=1e-9)
        np.testing.assert_allclose(stream.time, truth.time, atol=within)


def _stamps(truth: Truth, form: Callable[[datetime.datetime], str]) -> list[str]:
    return [form(START + datetime.timedelta(seconds=float(time))) for time in truth.time]


@pytest.mark.parametrize("separator", [";", "\t", ","])
@pytest.mark.parametrize("says_so", [True, False])
def test_decimal_commas_are_read(
    table: pandas.DataFrame, truth: Truth, tmp_path: Path, separator: str, says_so: bool
) -> None:
    text = table.to_csv(index=False, sep=separator, decimal=",")
    (tmp_path / "de.csv").write_text(f"sep={separator}\r\n{text}" if says_so else text, encoding="utf-8-sig")
    log = read_log(tmp_path / "de.csv")
    _assert_is(log, truth)
    assert any("decimal commas" in note for note in log.provenance.notes)


@pytest.mark.parametrize(("unit", "factor"), [("ms", 1e3), ("us", 1e6), ("ns", 1e9)])
@pytest.mark.parametrize("kind", ["csv", "parquet"])
def test_the_unit_of_t_is_told_by_the_rate_and_said(
    table: pandas.DataFrame, truth: Truth, tmp_path: Path, unit: str, factor: float, kind: str
) -> None:
    table["t"] = np.rint(table["t"] * factor).astype(int)
    path = tmp_path / f"log.{kind}"
    (table.to_csv if kind == "csv" else table.to_parquet)(path, index=False)
    log = read_log(path)
    _assert_is(log, truth)
    assert [str(repair) for repair in log.provenance.repairs] == [
        f"time_unit: t is in {unit} by its rate of rows, and not in s as the flight CSV's is"
    ]
    assert sum(len(chunk.stream("rate").time) for chunk in read_chunks(path, 0.5)) == len(truth.time)  # type: ignore[union-attr]


def test_a_unit_that_the_rate_leaves_open_is_asked_for(table: pandas.DataFrame, tmp_path: Path) -> None:
    table["t"] = 250 * np.arange(len(table))  # 4 kHz in us, or 4 Hz in ms
    table.to_csv(tmp_path / "log.csv", index=False)
    with pytest.raises(DataError, match=r"its unit may be ms \(4 Hz\) or us \(4e\+03 Hz\)"):
        read_log(tmp_path / "log.csv")


def test_a_table_of_position_alone_may_be_slow(table: pandas.DataFrame, truth: Truth, tmp_path: Path) -> None:
    slow = table[["t", "position_x", "position_y", "position_z"]].copy()
    slow["t"] = np.arange(len(slow), dtype=float)
    slow.to_csv(tmp_path / "log.csv", index=False)
    log = read_log(tmp_path / "log.csv")
    assert log.provenance.repairs == ()
    assert log.duration == len(truth.time) - 1


FORMS: tuple[Callable[[datetime.datetime], str], ...] = (
    lambda at: at.isoformat(),
    lambda at: at.isoformat().replace("+00:00", "Z"),
    lambda at: at.strftime("%Y-%m-%d %H:%M:%S.%f"),
    lambda at: at.strftime("%d.%m.%Y %H:%M:%S,%f"),
    lambda at: at.strftime("%m/%d/%Y %I:%M:%S.%f %p"),
    lambda at: at.strftime("%Y%m%dT%H%M%S.%f"),
    lambda at: at.strftime("%H:%M:%S.%f"),
)


@pytest.mark.parametrize("form", FORMS)
def test_times_as_text_are_read(
    table: pandas.DataFrame, truth: Truth, tmp_path: Path, form: Callable[[datetime.datetime], str]
) -> None:
    table["t"] = _stamps(truth, form)
    for separator, decimal in ((",", "."), (";", ",")):
        table.to_csv(tmp_path / "log.csv", index=False, sep=separator, decimal=decimal)
        _assert_is(read_log(tmp_path / "log.csv"), truth)
    table.to_parquet(tmp_path / "log.parquet")
    _assert_is(read_log(tmp_path / "log.parquet"), truth)


def test_a_column_of_timestamps_in_parquet_is_read(table: pandas.DataFrame, truth: Truth, tmp_path: Path) -> None:
    table["t"] = pandas.to_datetime(_stamps(truth, FORMS[0]), format="ISO8601")
    table.to_parquet(tmp_path / "log.parquet")
    _assert_is(read_log(tmp_path / "log.parquet"), truth)


def test_text_that_is_no_time_is_shown(table: pandas.DataFrame, truth: Truth, tmp_path: Path) -> None:
    table["t"] = _stamps(truth, FORMS[0])
    table.loc[40, "t"] = "yesterday"
    table.to_csv(tmp_path / "log.csv", index=False)
    with pytest.raises(DataError, match="'yesterday' is no time"):
        read_log(tmp_path / "log.csv")
    table.loc[40, "t"] = "2026-02-31T10:00:00"
    table.to_csv(tmp_path / "log.csv", index=False)
    with pytest.raises(DataError, match="2026-02-31 is no date"):
        read_log(tmp_path / "log.csv")


@pytest.mark.parametrize(("name", "factor"), [("timestamp", 1e9), ("Time [ms]", 1e3), ("time", 1.0)])
def test_a_column_that_is_a_time_by_its_name_is_one(
    table: pandas.DataFrame, truth: Truth, tmp_path: Path, name: str, factor: float
) -> None:
    stamps = np.rint((1_700_000_000.5 + truth.time) * factor).astype(np.int64) if factor > 1 else truth.time
    table.rename(columns={"t": name}).assign(**{name: stamps}).to_csv(tmp_path / "log.csv", index=False)
    _assert_is(read_log(tmp_path / "log.csv"), truth)


@pytest.mark.parametrize(
    ("names", "per_second"),
    [
        (("sec", "nanosec"), 10**9),
        (("header.stamp.sec", "header.stamp.nanosec"), 10**9),
        (("tv_sec", "tv_usec"), 10**6),
    ],
)
def test_a_time_of_two_columns_is_read(
    table: pandas.DataFrame, truth: Truth, tmp_path: Path, names: tuple[str, str], per_second: int
) -> None:
    ticks = 17 * 10**8 * per_second + per_second * 95 // 100 + np.rint(truth.time * per_second).astype(np.int64)
    two = pandas.DataFrame({names[0]: ticks // per_second, names[1]: ticks % per_second})
    pandas.concat([two, table.drop(columns="t")], axis=1).to_csv(tmp_path / "log.csv", index=False)
    log = read_log(tmp_path / "log.csv")
    _assert_is(log, truth)
    assert log.start == pytest.approx(1_700_000_000.95, abs=1e-6)
    assert sum(len(chunk.stream("rate").time) for chunk in read_chunks(tmp_path / "log.csv", 0.5)) == len(truth.time)  # type: ignore[union-attr]


MAPPING = """
name = "mine"
{file}
[time]
{time}
[frames]
world = "ENU"
body = "FLU"
[[streams]]
quantity = "position"
columns = ["p[0]", "p[1]", "p[2]"]
[[streams]]
quantity = "velocity"
columns = ["v[0]", "v[1]", "v[2]"]
[[streams]]
quantity = "attitude"
columns = ["q[0]", "q[1]", "q[2]"]
order = "xyz"
scale = 3.051850947599719e-05
[[streams]]
quantity = "rate"
columns = ["w[0]", "w[1]", "w[2]"]
unit = "deg/s"
[[streams]]
quantity = "specific_force"
columns = ["a[0]", "a[1]", "a[2]"]
[[streams]]
quantity = "rotor_speed"
columns = ["e[0]", "e[1]", "e[2]", "e[3]"]
unit = "rpm"
scale = 100
pole_pairs = 7
[[streams]]
quantity = "rotor_command"
columns = ["m[0]", "m[1]", "m[2]", "m[3]"]
{command}
"""


def _listed(truth: Truth) -> dict[str, Floats]:
    """Columns of lists in a decoded blackbox's units."""
    upright = truth.attitude * np.sign(truth.attitude[:, :1])
    return {
        "p": truth.position,
        "v": truth.velocity,
        "q": upright[:, 1:] * 32767,
        "w": np.degrees(truth.rate),
        "a": truth.specific_force,
        "e": truth.rotor_speed * 60 / (2 * np.pi) * 7 / 100,
        "m": 48 + 1999 * truth.rotor_speed / 2000,
    }


def _mapping(folder: Path, **parts: str) -> Path:
    texts = {"file": "", "time": 'column = "t"', "command": 'unit = "48..2047"', **parts}
    path = folder / "mapping.toml"
    path.write_text(MAPPING.format(**texts))
    return path


def _assert_mapped(log: Log, truth: Truth) -> None:
    for name in ("position", "velocity", "rate", "specific_force", "rotor_speed"):
        stream = log.stream(name)
        assert stream is not None
        np.testing.assert_allclose(stream.values, getattr(truth, name), rtol=1e-6, atol=1e-6)
        np.testing.assert_allclose(stream.time, truth.time, atol=1e-6)
    attitude, command = log.stream("attitude"), log.stream("rotor_command")
    assert attitude is not None
    assert command is not None
    np.testing.assert_allclose(np.abs(np.sum(attitude.values * truth.attitude, axis=1)), 1.0, atol=1e-9)
    np.testing.assert_allclose(command.values, truth.rotor_speed / 2000, atol=1e-9)


PRINTED: dict[str, Callable[[Floats], str]] = {
    "python": lambda row: str(row.tolist()),
    "numpy": lambda row: np.array2string(row, floatmode="unique", max_line_width=40),  # broken into lines
    "numpy 2 scalars": lambda row: str(list(row)),
    "array": lambda row: f"array({row.tolist()}, dtype=float64)",
    "tuple": lambda row: str(tuple(row.tolist())),
}


@pytest.mark.parametrize("printed", list(PRINTED))
def test_elements_of_lists_in_cells_are_named(truth: Truth, tmp_path: Path, printed: str) -> None:
    columns = {name: [PRINTED[printed](row) for row in values] for name, values in _listed(truth).items()}
    pandas.DataFrame({"t": truth.time, **columns}).to_csv(tmp_path / "log.csv")
    _assert_mapped(read_log(tmp_path / "log.csv", mapping=_mapping(tmp_path)), truth)


def test_elements_of_lists_in_parquet_are_named(truth: Truth, tmp_path: Path) -> None:
    frame = pandas.DataFrame({"t": truth.time, **{name: list(values) for name, values in _listed(truth).items()}})
    frame.to_parquet(tmp_path / "log.parquet")
    _assert_mapped(read_log(tmp_path / "log.parquet", mapping=_mapping(tmp_path)), truth)
    columns = {name: [str(row.tolist()) for row in values] for name, values in _listed(truth).items()}
    pandas.DataFrame({"t": truth.time, **columns}).to_parquet(tmp_path / "text.parquet")
    _assert_mapped(read_log(tmp_path / "text.parquet", mapping=_mapping(tmp_path)), truth)


def test_missing_elements_are_no_values_and_words_are_refused(truth: Truth, tmp_path: Path) -> None:
    columns = {name: [str(row.tolist()) for row in values] for name, values in _listed(truth).items()}
    columns["p"][3:6] = [str(truth.position[3, :2].tolist()), "", f"[nan, None, {truth.position[5, 2]}]"]
    frame = pandas.DataFrame({"t": truth.time, **columns})
    frame.to_csv(tmp_path / "log.csv")
    position = read_log(tmp_path / "log.csv", mapping=_mapping(tmp_path)).stream("position")
    assert position is not None
    assert np.isnan(position.values).any(axis=1).nonzero()[0].tolist() == [3, 4, 5]
    frame.loc[7, "p"] = "[left, right, up]"
    frame.to_csv(tmp_path / "log.csv")
    with pytest.raises(DataError, match="p: its cells cannot be read as lists of numbers"):
        read_log(tmp_path / "log.csv", mapping=_mapping(tmp_path))


def test_a_column_that_has_the_name_of_an_element_is_that_column(truth: Truth, tmp_path: Path) -> None:
    columns = {f"{name}[{i}]": values[:, i] for name, values in _listed(truth).items() for i in range(values.shape[1])}
    pandas.DataFrame({"t": truth.time, **columns}).to_csv(tmp_path / "log.csv")
    _assert_mapped(read_log(tmp_path / "log.csv", mapping=_mapping(tmp_path)), truth)


def test_a_mapping_states_offset_decimal_comma_and_time(truth: Truth, tmp_path: Path) -> None:
    columns = {f"{name}[{i}]": values[:, i] for name, values in _listed(truth).items() for i in range(values.shape[1])}
    offset = f"offset = 48\nscale = {1 / 1999!r}"
    frame = pandas.DataFrame({"t": _stamps(truth, FORMS[3]), **columns})
    frame.to_csv(tmp_path / "log.csv", sep=";", decimal=",")
    written = _mapping(
        tmp_path, file='[file]\ndelimiter = ";"\ndecimal = ","', time='column = "t"\nunit = "iso"', command=offset
    )
    _assert_mapped(read_log(tmp_path / "log.csv", mapping=written), truth)
    ticks = 1_700_000_000_950_000_000 + np.rint(truth.time * 1e9).astype(np.int64)
    frame = pandas.DataFrame({"a": ticks // 10**9, "b": ticks % 10**9, **columns})
    frame.to_csv(tmp_path / "log.csv")
    written = _mapping(tmp_path, time='column = "a"\nfraction = "b"', command=offset)
    _assert_mapped(read_log(tmp_path / "log.csv", mapping=written), truth)


def test_the_line_of_a_mapping_that_reads_a_cell_is_named(truth: Truth, tmp_path: Path) -> None:
    columns = {f"{name}[{i}]": values[:, i] for name, values in _listed(truth).items() for i in range(values.shape[1])}
    frame = pandas.DataFrame({"t": truth.time, **columns})
    frame.to_csv(tmp_path / "log.csv", sep=";", decimal=",")
    with pytest.raises(DataError, match=r"decimal = ',' under \[file\]"):
        read_log(tmp_path / "log.csv", mapping=_mapping(tmp_path, file='[file]\ndelimiter = ";"'))
    frame.assign(t=_stamps(truth, FORMS[0])).to_csv(tmp_path / "log.csv")
    with pytest.raises(DataError, match=r"unit = 'iso' under \[time\]"):
        read_log(tmp_path / "log.csv", mapping=_mapping(tmp_path))
    listed = {name: [str(row.tolist()) for row in values] for name, values in _listed(truth).items()}
    pandas.DataFrame({"t": truth.time, **listed}).to_csv(tmp_path / "log.csv")
    with pytest.raises(
        RequestError, match=r"The cells of p, v, q, w, a, e, m are lists: name their elements, as p\[0\]"
    ):
        read_log(tmp_path / "log.csv")


@pytest.mark.parametrize(
    ("before", "after", "message"),
    [
        (
            'columns = ["p[0]", "p[1]", "p[2]"]',
            'columns = ["p"]',
            r'name their elements: \["p\[0\]", "p\[1\]", "p\[2\]"\]',
        ),
        ('unit = "48..2047"', 'unit = "48..48"', "unknown unit '48..48'.*or a range such as '1000..2000'"),
        ('unit = "48..2047"', "offset = [1, 2]", "give one offset, or one a column"),
        ('unit = "48..2047"', "pole_pairs = 7", "rotor_command is no rotor speed: leave pole_pairs out"),
        ("pole_pairs = 7", "pole_pairs = 0.5", "give 1 or more, 7 for 14 poles"),
        ('column = "t"', 'column = "t"\nunit = "ms"\nfraction = "n"', "fraction goes with a column in whole s"),
        ("[time]", '[file]\ndecimal = ","\n[time]', "decimal and delimiter are both"),
        (
            'order = "xyz"',
            'order = "xyzw"',
            "attitude has 4 columns; 3 are given. If w was left out, give order = 'xyz'",
        ),
    ],
)
def test_what_a_mapping_cannot_mean_is_refused(tmp_path: Path, before: str, after: str, message: str) -> None:
    text = _mapping(tmp_path).read_text()
    assert before in text
    (tmp_path / "mapping.toml").write_text(text.replace(before, after, 1))
    with pytest.raises(RequestError, match=message):
        read_mapping(tmp_path / "mapping.toml")
