"""Whatever is wrong with a log is an error with a name or a repair with a name, never a silent guess."""

from __future__ import annotations

import gzip
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from dynamics import frames
from dynamics.arrays import Floats
from dynamics.errors import AlulaError, DataError, RequestError
from flights import Flight, Log, read_folder, read_log, reading
from flights.folder import folder_content
from tests.support.flight_files import Truth, crazyflie_log, flight_csv, manoeuvre, paper_bag, ros2_bag, tlog

PX4 = Path(__file__).parents[1] / "data" / "px4_sih_offboard"


@pytest.fixture(scope="module")
def truth() -> Truth:
    return manoeuvre()


def _repairs(log: Log) -> set[str]:
    return {repair.name for repair in log.provenance.repairs}


@pytest.fixture
def lines(truth: Truth, tmp_path: Path) -> list[str]:
    return flight_csv(truth, tmp_path / "whole.csv").read_text().splitlines()


def _read(tmp_path: Path, lines: list[str]) -> Log:
    path = tmp_path / "changed.csv"
    path.write_text("\n".join(lines) + "\n")
    return read_log(path)


def _edit(lines: list[str], row: int, column: int, cell: str) -> None:
    cells = lines[row].split(",")
    cells[column] = cell
    lines[row] = ",".join(cells)


def test_an_empty_file(tmp_path: Path) -> None:
    (tmp_path / "empty.ulg").touch()
    with pytest.raises(DataError, match="is empty"):
        Flight.read(tmp_path / "empty.ulg")
    (tmp_path / "empty.gz").write_bytes(gzip.compress(b""))
    with pytest.raises(DataError, match="is gzipped and empty"):
        Flight.read(tmp_path / "empty.gz")


def test_a_file_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(RequestError, match="No such file"):
        Flight.read(tmp_path / "nowhere.ulg")


def test_a_format_that_is_not_known(tmp_path: Path) -> None:
    (tmp_path / "picture.ulg").write_bytes(b"\x89PNG\r\n\x1a\n" + bytes(100))
    with pytest.raises(RequestError, match="has no known log format"):
        Flight.read(tmp_path / "picture.ulg")


@pytest.mark.parametrize("first", ["", " ArduCopter V4.5.7 (2a3dc4b7)\n"])
def test_ardupilots_log_as_text_is_named_for_what_it_is(tmp_path: Path, first: str) -> None:
    path = tmp_path / "00000017.log"
    path.write_text(
        f"{first}FMT, 128, 89, FMT, BBnNZ, Type,Length,Name,Format,Columns\n"
        "FMT, 43, 36, IMU, QBffffffIIfBBHH, TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ,EG,EA,T,GH,AH,GHz,AHz\n"
        "IMU, 16840112, 0, 0.001, 0.002, 0.001, 0.02, 0.03, -9.79, 0, 0, 45.1, 1, 1, 1000, 1000\n"
    )
    with pytest.raises(RequestError, match=r"an ArduPilot log as text.*Give the \.bin file"):
        Flight.read(path)
    assert folder_content(tmp_path).logs == (path,)  # so that a folder's reader is told, too


def test_a_table_whose_columns_mean_nothing(tmp_path: Path) -> None:
    (tmp_path / "table.csv").write_text("time,a,b\n0,1,2\n")
    with pytest.raises(RequestError, match="column-mapping TOML"):
        Flight.read(tmp_path / "table.csv")


def test_shuffled_columns_are_read_by_their_names(lines: list[str], truth: Truth, tmp_path: Path) -> None:
    order = np.random.default_rng(1).permutation(len(lines[0].split(",")))
    log = _read(tmp_path, [",".join(np.array(line.split(","))[order]) for line in lines])
    stream = log.stream("velocity")
    assert stream is not None
    np.testing.assert_allclose(stream.values, truth.velocity)


def test_a_duplicated_column(lines: list[str], tmp_path: Path) -> None:
    lines[0] = lines[0].replace("position_y", "position_x")
    with pytest.raises(DataError, match="position_x are there more than once"):
        _read(tmp_path, lines)


def test_a_missing_column_of_a_quantity(lines: list[str], tmp_path: Path) -> None:
    lines[0] = lines[0].replace("velocity_y", "velocty_y")
    with pytest.raises(DataError, match="velocity_y missing beside velocity_x, velocity_z"):
        _read(tmp_path, lines)


def test_a_missing_rotor(lines: list[str], tmp_path: Path) -> None:
    lines[0] = lines[0].replace("rotor_speed_1", "rotor_speed_7")
    with pytest.raises(DataError, match="rotor_speed_1 missing"):
        _read(tmp_path, lines)


def test_a_column_that_is_none_is_named_with_the_nearest(lines: list[str], tmp_path: Path) -> None:
    log = _read(tmp_path, [f"{line},{'batery_voltage' if i == 0 else '7.7'}" for i, line in enumerate(lines)])
    assert any("did you mean 'battery_voltage'" in note for note in log.provenance.notes)


def test_blank_and_nan_cells_are_masked(lines: list[str], tmp_path: Path) -> None:
    _edit(lines, 10, 1, "")
    _edit(lines, 11, 1, "nan")
    log = _read(tmp_path, lines)
    assert _repairs(log) == {"missing_values"}
    flight = Flight.from_log(log)
    assert np.flatnonzero(np.isnan(flight["position_x"])).tolist() == [9, 10]


def test_a_quantity_that_is_blank_in_most_rows_was_logged_less_often(lines: list[str], tmp_path: Path) -> None:
    columns = [i for i, name in enumerate(lines[0].split(",")) if name.startswith("velocity")]
    for row in range(1, len(lines)):
        for column in columns if row % 3 else []:
            _edit(lines, row, column, "")
    log = _read(tmp_path, lines)
    assert _repairs(log) == set()
    flight = Flight.from_log(log)
    assert flight.origins["velocity"].rate == pytest.approx(flight.origins["rate"].rate / 3, rel=0.01)
    assert np.isfinite(flight["velocity_x"][5:-5]).all()


def test_infinite_values_are_masked(lines: list[str], tmp_path: Path) -> None:
    _edit(lines, 10, 1, "inf")
    assert "absurd_values" in _repairs(_read(tmp_path, lines))


def test_a_word_among_the_numbers(lines: list[str], tmp_path: Path) -> None:
    _edit(lines, 10, 1, "fast")
    with pytest.raises(DataError, match="cannot be read as numbers"):
        _read(tmp_path, lines)


def test_a_torn_last_row_is_dropped(lines: list[str], tmp_path: Path) -> None:
    log = _read(tmp_path, [*lines[:-1], lines[-1][:30]])
    assert _repairs(log) == {"torn_rows"}


def test_many_torn_rows_are_refused(lines: list[str], tmp_path: Path) -> None:
    with pytest.raises(DataError, match="as many cells as columns"):
        _read(tmp_path, [line if i % 20 else line + ",1" for i, line in enumerate(lines, start=1)])


def test_a_header_without_rows(lines: list[str], tmp_path: Path) -> None:
    with pytest.raises(DataError, match="no rows"):
        _read(tmp_path, lines[:1])


def test_repeated_stamps_are_dropped(lines: list[str], tmp_path: Path) -> None:
    log = _read(tmp_path, [*lines[:50], lines[49], *lines[50:]])
    assert _repairs(log) == {"repeated_stamps"}


def test_two_swapped_rows_are_put_in_order(lines: list[str], truth: Truth, tmp_path: Path) -> None:
    lines[50], lines[51] = lines[51], lines[50]
    log = _read(tmp_path, lines)
    assert _repairs(log) == {"reversed_stamps"}
    stream = log.stream("position")
    assert stream is not None
    np.testing.assert_allclose(stream.values, truth.position)


@pytest.mark.parametrize("row", [1, 50, 51, 600])
def test_a_single_damaged_stamp_is_dropped(lines: list[str], truth: Truth, tmp_path: Path, row: int) -> None:
    _edit(lines, row, 0, "73786976.294")
    log = _read(tmp_path, lines)
    assert _repairs(log) == {"stray_stamps"}
    stream = log.stream("position")
    assert stream is not None
    np.testing.assert_allclose(stream.values, np.delete(truth.position, row - 1, axis=0))


@pytest.mark.parametrize("change", [lambda rows: rows[::-1], lambda rows: rows[300:] + rows[:300]])
def test_a_clock_that_runs_backwards(
    lines: list[str], tmp_path: Path, change: Callable[[list[str]], list[str]]
) -> None:
    with pytest.raises(DataError, match="time stamps go back"):
        _read(tmp_path, [lines[0], *change(lines[1:])])


def test_a_clock_that_stands_still(lines: list[str], tmp_path: Path) -> None:
    for row in range(1, len(lines)):
        _edit(lines, row, 0, "1.0")
    with pytest.raises(DataError, match="repeat the time stamp"):
        _read(tmp_path, lines)


def test_a_header_written_as_a_comment(lines: list[str], tmp_path: Path) -> None:
    assert not _repairs(_read(tmp_path, ["# " + lines[0], *lines[1:]]))


def test_a_table_of_absurd_length_is_not_even_tried(truth: Truth, tmp_path: Path) -> None:
    log = read_log(flight_csv(truth, tmp_path / "flight.csv"))
    with pytest.raises(DataError, match="give a lower rate"):
        Flight.from_log(log, rate=1e8)


@pytest.mark.parametrize(
    ("name", "replaced"),
    [
        ("rates in degrees", lambda truth: {"rate": np.degrees(truth.rate)}),
        ("rates far beyond any gyro", lambda truth: {"rate": 500.0 + 0 * truth.rate, "attitude": 0 * truth.attitude}),
        ("rates in FRD", lambda truth: {"rate": frames.flu_from_frd(truth.rate)}),
        ("specific force in FRD", lambda truth: {"specific_force": frames.flu_from_frd(truth.specific_force)}),
        ("specific force in g", lambda truth: {"specific_force": truth.specific_force / 9.81}),
        ("velocity in NED", lambda truth: {"velocity": frames.enu_from_ned(truth.velocity)}),
        (
            "position and velocity in NED",
            lambda truth: {name: frames.enu_from_ned(getattr(truth, name)) for name in ("position", "velocity")},
        ),
        (
            "everything in NED and FRD",
            lambda truth: {
                "position": frames.enu_from_ned(truth.position),
                "velocity": frames.enu_from_ned(truth.velocity),
                "attitude": frames.attitude_ned_frd(truth.attitude),
                "rate": frames.flu_from_frd(truth.rate),
                "specific_force": frames.flu_from_frd(truth.specific_force),
            },
        ),
        ("quaternions x first", lambda truth: {"attitude": np.roll(truth.attitude, -1, axis=1)}),
        ("world to body", lambda truth: {"attitude": truth.attitude * np.array([1.0, -1.0, -1.0, -1.0])}),
    ],
)
def test_units_and_frames_that_contradict_physics_are_refused(
    truth: Truth, tmp_path: Path, name: str, replaced: Callable[[Truth], dict[str, Floats]]
) -> None:
    with pytest.raises(DataError, match="anted"):
        read_log(flight_csv(truth, tmp_path / f"{name}.csv", **replaced(truth)))


def test_ned_labelled_as_enu_without_an_imu_is_refused(truth: Truth, tmp_path: Path) -> None:
    nothing = np.full_like(truth.rate, np.nan)
    with pytest.raises(DataError, match="NED"):
        read_log(
            flight_csv(
                truth,
                tmp_path / "flight.csv",
                rate=nothing,
                specific_force=nothing,
                position=frames.enu_from_ned(truth.position),
                velocity=frames.enu_from_ned(truth.velocity),
                attitude=frames.attitude_ned_frd(truth.attitude),
            )
        )


def test_a_truncated_ulog_is_read_up_to_where_it_ends(tmp_path: Path) -> None:
    data = gzip.decompress((PX4 / "offboard_hover_topics.ulg.gz").read_bytes())
    path = tmp_path / "torn.ulg"
    path.write_bytes(data[: len(data) // 2 + 5])
    log = read_log(path)
    assert "torn_end" in _repairs(log)
    assert 25.0 < log.duration < 45.0
    path.write_bytes(data)
    assert not _repairs(read_log(path)) & {"torn_end", "damaged_messages"}
    path.write_bytes(data[:40])
    with pytest.raises(DataError, match=r"cannot be read|without flight data"):
        read_log(path)


def test_a_damaged_ulog_is_read_around_the_damage(tmp_path: Path) -> None:
    data = bytearray(gzip.decompress((PX4 / "offboard_hover_topics.ulg.gz").read_bytes()))
    data[2_000_000:2_000_400] = bytes(400)
    (tmp_path / "damaged.ulg").write_bytes(data)
    log = read_log(tmp_path / "damaged.ulg")
    assert "damaged_messages" in _repairs(log)


def test_a_truncated_gzip_is_read_up_to_where_it_ends(tmp_path: Path) -> None:
    data = (PX4 / "offboard_hover.tlog.gz").read_bytes()
    (tmp_path / "torn.tlog.gz").write_bytes(data[: len(data) // 3])
    log = read_log(tmp_path / "torn.tlog.gz")
    assert "torn_gzip" in _repairs(log)
    assert 10.0 < log.duration < 40.0


def test_a_tlog_with_noise_between_its_frames(truth: Truth, tmp_path: Path) -> None:
    data = tlog(truth)
    (tmp_path / "noisy.tlog").write_bytes(data[:5000] + bytes(range(256)) + data[5000:])
    log = read_log(tmp_path / "noisy.tlog")
    assert _repairs(log) & {"skipped_bytes", "damaged_frames"}
    stream = log.stream("position")
    assert stream is not None
    assert len(stream.time) > len(truth.time) - 5


@pytest.mark.parametrize("end", [-4, -5, -40])
def test_a_torn_crazyflie_log_is_repaired_with_a_failed_checksum(tmp_path: Path, end: int) -> None:
    data = crazyflie_log(
        [("gyro.x", "f"), ("gyro.y", "f"), ("gyro.z", "f")], [(i * 1000, (1, 2, 3)) for i in range(99)]
    )
    (tmp_path / "log").write_bytes(data[:end])
    log = read_log(tmp_path / "log")
    assert "checksum_failed" in _repairs(log)
    stream = log.stream("rate")
    assert stream is not None
    np.testing.assert_allclose(stream.values, np.radians([[1, 2, 3]] * len(stream.time)))


def test_a_crazyflie_log_of_another_version(tmp_path: Path) -> None:
    data = bytearray(crazyflie_log([("gyro.x", "f")], [(0, (1.0,))]))
    data[1] = 9
    (tmp_path / "log").write_bytes(data)
    with pytest.raises(DataError, match="version 9"):
        read_log(tmp_path / "log")


def test_a_bag_of_the_wrong_version(truth: Truth, tmp_path: Path) -> None:
    data = paper_bag(truth, tmp_path / "good.bag").read_bytes()
    (tmp_path / "old.bag").write_bytes(data.replace(b"#ROSBAG V2.0", b"#ROSBAG V1.2", 1))
    with pytest.raises(DataError, match="rosbag migrate"):
        read_log(tmp_path / "old.bag")


def test_a_bag_that_was_cut_off(truth: Truth, tmp_path: Path) -> None:
    data = paper_bag(truth, tmp_path / "good.bag").read_bytes()
    (tmp_path / "torn.bag").write_bytes(data[: len(data) // 2])
    with pytest.raises(DataError, match="rosbag reindex"):
        read_log(tmp_path / "torn.bag")


def test_a_bag_of_ros2_from_the_future(truth: Truth, tmp_path: Path) -> None:
    folder = ros2_bag(truth, tmp_path / "bag", body_velocity=True)
    metadata = folder / "metadata.yaml"
    metadata.write_text(metadata.read_text().replace("version: 8", "version: 99", 1))
    with pytest.raises(DataError, match="99"):
        read_log(folder)


def test_a_blackbox_log_names_the_tool_that_converts_it(tmp_path: Path) -> None:
    header = b"H Product:Blackbox flight data recorder by Nicholas Sherlock\nH Data version:2\n"
    (tmp_path / "btfl.bbl").write_bytes(header)
    with pytest.raises(DataError, match="blackbox_decode"):
        read_log(tmp_path / "btfl.bbl")


def test_a_folder_of_mixed_formats_gives_each_file_or_its_reason(truth: Truth, tmp_path: Path) -> None:
    flight_csv(truth, tmp_path / "a.csv")
    (tmp_path / "b.ulg").touch()
    (tmp_path / "c.txt").write_text("notes of the day")
    (tmp_path / "d").mkdir()
    (tmp_path / "d" / "flight.tlog").write_bytes(tlog(truth))
    ros2_bag(truth, tmp_path / "e", body_velocity=True)
    results = {str(path.relative_to(tmp_path)): result for path, result in read_folder(tmp_path)}
    assert list(results) == ["a.csv", "b.ulg", "c.txt", "d/flight.tlog", "e"]
    formats = [result.provenance.format if isinstance(result, Log) else type(result) for result in results.values()]
    assert formats == ["flight CSV", DataError, RequestError, "MAVLink tlog", "ROS bag"]
    assert isinstance(results["b.ulg"], AlulaError)
    with pytest.raises(RequestError, match="read a folder of logs"):
        Flight.read(tmp_path)


def test_what_is_cut_off_or_torn_is_damage(tmp_path: Path, lines: list[str]) -> None:
    assert _read(tmp_path, lines).provenance.damage == ()
    lines[100] += ",1.0"
    assert "1 rows with 22 instead of 21 cells dropped" in _read(tmp_path, lines).provenance.damage


def test_a_log_that_needs_more_memory_than_there_is_is_not_called_damaged(
    lines: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    greedy = replace(reading.FORMATS["csv"], read=lambda source: np.empty((10**9, 10**6)))
    monkeypatch.setitem(reading.FORMATS, "csv", greedy)
    with pytest.raises(DataError, match=r"changed\.csv \(\d+ MB\) is a flight CSV, .* needs more memory than there is"):
        _read(tmp_path, lines)
