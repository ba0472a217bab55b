"""The flight table: what goes in comes out bit for bit, and segments hold nothing that does not belong together."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from dynamics.arrays import Floats
from dynamics.errors import DataError, RequestError
from flights import Flight, Provenance
from flights.quantities import QUANTITIES, known_columns, quantity_of
from tests.support.flight_files import flight_csv, manoeuvre

SOMEWHERE = Provenance("made up", "", "test", "test")
NUMBERS = st.floats(min_value=-1e6, max_value=1e6) | st.just(float("nan"))


def _flight(time: Floats, **columns: Floats) -> Flight:
    return Flight(time, columns, SOMEWHERE)


def _same(one: Flight, other: Flight) -> None:
    assert list(one.columns) == list(other.columns)
    np.testing.assert_array_equal(one.time.view(np.int64), other.time.view(np.int64))
    for name in one.columns:
        given_nan, got_nan = np.isnan(one.columns[name]), np.isnan(other.columns[name])
        np.testing.assert_array_equal(given_nan, got_nan, name)
        np.testing.assert_array_equal(one.columns[name][~given_nan], other.columns[name][~got_nan], name)


@given(
    table=hnp.arrays(float, st.tuples(st.integers(3, 40), st.just(8)), elements=NUMBERS),
    start=st.floats(-100, 100),
    rate=st.sampled_from([10.0, 100.0, 250.0, 997.0]),
)
def test_csv_and_parquet_give_every_bit_back(
    tmp_path_factory: pytest.TempPathFactory, table: Floats, start: float, rate: float
) -> None:
    names = (*(f"position_{part}" for part in "xyz"), *(f"rotor_speed_{i}" for i in range(4)), "battery_voltage")
    table[0] = 1.0  # a file of nothing but blanks is no flight
    flight = _flight(start + np.arange(len(table)) / rate, **dict(zip(names, table.T, strict=True)))
    folder = tmp_path_factory.mktemp("round_trip")
    _same(flight, Flight.read(flight.to_csv(folder / "flight.csv")))
    _same(flight, Flight.read(flight.to_parquet(folder / "flight.parquet")))


def test_a_quantity_with_many_gaps_here_and_there_is_no_slower_stream(tmp_path: Path) -> None:
    time = np.arange(60) / 10.0
    blank = np.random.default_rng(0).random(60) < 0.6
    voltage = np.where(blank, np.nan, 16.0 - 0.01 * time)
    assert np.median(np.diff(np.flatnonzero(~blank))) >= 2
    flight = _flight(time, position_x=time, position_y=time, position_z=time, battery_voltage=voltage)
    _same(flight, Flight.read(flight.to_csv(tmp_path / "flight.csv")))


def test_a_parquet_file_keeps_what_was_known_of_its_source(tmp_path: Path) -> None:
    flight = Flight.read(flight_csv(manoeuvre(), tmp_path / "flight.csv"))
    again = Flight.read(flight.to_parquet(tmp_path / "flight.parquet"))
    _same(flight, again)
    assert any("flight.csv" in note and "flight CSV" in note for note in again.provenance.notes)
    assert again.provenance.sha256 != flight.provenance.sha256


def test_columns_are_in_the_order_of_the_flight_csv_and_cannot_be_changed() -> None:
    t = np.arange(3.0)
    flight = _flight(t, rotor_speed_1=t, rate_z=t, rate_x=t, rate_y=t, yaw=t, rotor_speed_0=t)
    assert list(flight.columns) == ["rate_x", "rate_y", "rate_z", "yaw", "rotor_speed_0", "rotor_speed_1"]
    with pytest.raises(ValueError, match="read-only"):
        flight["rate_x"][0] = 1.0
    with pytest.raises(TypeError):
        flight.columns["rate_x"] = t  # type: ignore[index]


def test_a_quantity_is_one_array_however_the_flight_is_made() -> None:
    t, speeds = np.arange(3.0), np.arange(12.0).reshape(3, 4)
    by_array = Flight(t, {"rotor_speed": speeds, "yaw": t[:, None]}, SOMEWHERE)
    by_columns = _flight(t, yaw=t, **{f"rotor_speed_{rotor}": speeds[:, rotor] for rotor in range(4)})
    for flight in (by_array, by_columns):
        np.testing.assert_array_equal(flight["rotor_speed"], speeds)
        np.testing.assert_array_equal(flight["rotor_speed_2"], speeds[:, 2])
        np.testing.assert_array_equal(flight["yaw"], t)
        assert flight["rotor_speed"] is flight.values["rotor_speed"]  # stored so: nothing is stacked at each use
        assert np.shares_memory(flight.rows(1, 3)["rotor_speed"], flight.values["rotor_speed"])
        assert np.shares_memory(flight.columns["rotor_speed_2"], flight.values["rotor_speed"])
    assert by_array.quantities == by_columns.quantities == ("yaw", "rotor_speed")


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"position_x": np.zeros(3)}, "position_y, position_z missing beside position_x"),
        ({"rotor_speed_0": np.zeros(3), "rotor_speed_2": np.zeros(3)}, "rotor_speed_1 missing"),
        ({"rate": np.zeros((3, 2))}, r"rate has the shape \(3, 2\)"),
        ({"rotor_speed": np.zeros((3, 17))}, r"rotor_speed has the shape \(3, 17\)"),
        ({"rate": np.zeros((2, 3))}, "as long as its time"),
        ({"rate": np.zeros(3)}, "rate are no columns"),
    ],
)
def test_a_quantity_is_there_whole_or_not_at_all(values: dict[str, Floats], message: str) -> None:
    with pytest.raises(DataError, match=message):
        Flight(np.arange(3.0), values, SOMEWHERE)


def test_unknown_columns_are_refused_by_name() -> None:
    with pytest.raises(DataError, match="speed_of_sound"):
        _flight(np.arange(3.0), speed_of_sound=np.arange(3.0))
    with pytest.raises(RequestError, match="altitude"):
        _flight(np.arange(3.0)).unit("altitude")
    with pytest.raises(DataError, match="has no rate"):
        _flight(np.arange(3.0), yaw=np.arange(3.0))["rate"]


def test_rows_that_do_not_follow_each_other_by_one_period_are_refused() -> None:
    """A gap would be taken for one period, and what happens there for an effect."""
    t = np.arange(1000) / 100.0
    for later in (t + (t >= 5.0), np.where(t < 5.0, t, t - 1.0), np.where(t == 5.0, np.nan, t)):
        with pytest.raises(DataError, match=r"follow each other by one period, here 0\.01 s, but .* Put rows of NaN"):
            _flight(later, yaw=t)
    assert len(_flight(t + 1e-4 * np.sin(t), yaw=t)) == 1000


def test_every_known_column_belongs_to_its_quantity() -> None:
    for column in known_columns(8):
        quantity = quantity_of(column)
        assert quantity is not None
        assert column in quantity.columns(8 if quantity.parts is None else len(quantity.parts))
    assert quantity_of("rotor_speed_16") is None
    assert quantity_of("rotor_speed_01") is None
    assert quantity_of("position_w") is None
    assert {quantity_of(column) for column in known_columns()} == set(QUANTITIES.values())


def test_segments_end_at_gaps_resets_and_disarming() -> None:
    t = np.arange(1000) / 100.0
    position = np.ones(1000)
    position[200:210] = np.nan
    resets = np.where(t < 5.0, 3.0, 4.0)
    armed = np.where(t < 8.0, 1.0, 0.0)
    flight = _flight(
        t, position_x=position, position_y=position, position_z=position, armed=armed, position_reset_counter=resets
    )
    spans = [(segment.time[0], segment.time[-1]) for segment in flight.segments()]
    assert spans == [(0.0, 1.99), (2.1, 4.99), (5.0, 7.99)]
    landed = (t >= 3.0) & (t < 3.5)
    spans = [(segment.time[0], segment.time[-1]) for segment in flight.segments(exclude=landed)]
    assert spans == [(0.0, 1.99), (2.1, 2.99), (3.5, 4.99), (5.0, 7.99)]
    assert [len(segment) for segment in flight.segments(shortest=2.5)] == [290, 300]


def test_a_segment_written_and_read_keeps_its_time(tmp_path: Path) -> None:
    flight = Flight.read(flight_csv(manoeuvre(), tmp_path / "flight.csv")).rows(150, 450)
    assert flight.time[0] == pytest.approx(1.5)
    _same(flight, Flight.read(flight.to_csv(tmp_path / "segment.csv")))


def test_an_empty_or_torn_table_has_no_segments() -> None:
    assert _flight(np.empty(0), yaw=np.empty(0)).segments() == ()
    nothing = np.full(100, np.nan)
    flight = _flight(np.arange(100) / 100, position_x=nothing, position_y=nothing, position_z=nothing)
    assert flight.segments() == ()
    assert flight.duration == pytest.approx(0.99)


def test_a_file_in_a_folder_that_is_none_is_refused(tmp_path: Path) -> None:
    flight = _flight(np.arange(3.0), yaw=np.arange(3.0))
    with pytest.raises(RequestError, match="cannot write"):
        flight.to_csv(tmp_path / "nowhere" / "flight.csv")


def test_a_flight_prints_as_a_summary() -> None:
    flight = Flight.read(Path("tests/data/px4_sih_flights/nothing_1_circle.ulg.gz"))
    lines = str(flight).splitlines()
    assert lines[0].startswith("nothing_1_circle.ulg.gz (PX4 ULog")
    assert f"{flight.duration:.1f} s, {len(flight)} rows" in lines[0]
    assert len(lines) == 1 + len(flight.quantities)
    assert any(line.split()[:4] == ["specific_force", "m/s^2", "body", "FLU,"] for line in lines)


def test_a_summary_counts_what_is_missing() -> None:
    values = np.array([1.0, np.nan, np.nan, 4.0])
    assert str(_flight(np.arange(4.0), velocity_x=values, velocity_y=values, velocity_z=values)).endswith(
        "50 % missing"
    )


def test_a_flight_as_a_data_frame_has_its_numbers_units_and_frames() -> None:
    flight = Flight.read(Path("tests/data/px4_sih_flights/nothing_1_circle.ulg.gz"))
    frame = flight.to_pandas()
    np.testing.assert_array_equal(frame.index.to_numpy(), flight.time)
    np.testing.assert_array_equal(frame["velocity_x"].to_numpy(), flight["velocity"][:, 0])
    assert frame.attrs["units"]["velocity_x"] == "m/s"
    assert frame.attrs["frames"]["velocity_x"] == "world ENU"
    frame["velocity_x"] = 0.0  # a copy: the flight stays as it is
    assert np.nanmax(np.abs(flight["velocity"][:, 0])) > 0.0
