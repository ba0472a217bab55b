"""Blocks of Crazyflie's log variables are read by their names, and several files of one flight are joined."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas
import pytest
from numpy.testing import assert_allclose
from typer.testing import CliRunner

import alula
from alula.cli.app import app
from diagnosis.data.dataset import read_flights
from dynamics import quaternion
from dynamics.arrays import Floats
from dynamics.errors import DataError
from dynamics.joined_logs import logs_are_joined, logs_joined
from dynamics.vehicle import GRAVITY
from flights import Log, read_log
from flights.one_flight import read_one_flight
from flights.pose_source import source_of
from flights.reading import read_chunks
from tests.support.flight_files import Truth, flight_csv, manoeuvre

DATA = Path(__file__).parents[1] / "data" / "cfclient"
START = 813_000  # ms


@pytest.fixture(scope="module")
def truth() -> Truth:
    return manoeuvre(duration=4.0, rate=100.0)


def _imu(truth: Truth) -> dict[str, Floats]:
    return _named("gyro", np.degrees(truth.rate)) | _named("acc", truth.specific_force / GRAVITY)


def _named(group: str, values: Floats, names: str = "xyz") -> dict[str, Floats]:
    return {f"{group}.{name}": column for name, column in zip(names, values.T, strict=True)}


def _state(truth: Truth) -> dict[str, Floats]:
    euler = np.degrees(quaternion.to_euler(truth.attitude)) * np.array([1.0, -1.0, 1.0])  # nose up is negative
    motors = truth.rotor_speed[:, [3, 2, 1, 0]] / 2000 * 65535
    return (
        _named("stateEstimate", truth.position)
        | {f"stateEstimate.v{name}": column for name, column in zip("xyz", truth.velocity.T, strict=True)}
        | dict(zip(("stabilizer.roll", "stabilizer.pitch", "stabilizer.yaw"), euler.T, strict=True))
        | {f"motor.m{number + 1}": column for number, column in enumerate(motors.T)}
    )


def _write(
    path: Path, truth: Truth, columns: dict[str, Floats], *, start: float = START, per_second: float = 1e3
) -> Path:
    stamps = np.rint(start * per_second / 1e3 + truth.time * per_second).astype(np.int64)
    pandas.DataFrame({"Timestamp": stamps, **columns}).to_csv(path, index=False)
    return path


def _values(log: Log, name: str) -> Floats:
    stream = log.stream(name)
    assert stream is not None, name
    return stream.values


def _assert_joined(log: Log, truth: Truth) -> None:
    for name in ("position", "velocity", "rate", "specific_force"):
        assert_allclose(_values(log, name), getattr(truth, name), atol=1e-9)
    assert_allclose(np.abs(np.sum(_values(log, "attitude") * truth.attitude, axis=1)), 1.0, atol=1e-9)
    assert_allclose(_values(log, "rotor_command"), truth.rotor_speed / 2000, atol=1e-9)


@pytest.mark.parametrize("per_second", [1e3, 1e6])
def test_two_blocks_of_one_flight_are_joined_on_their_own_stamps(
    truth: Truth, tmp_path: Path, per_second: float
) -> None:
    first = _write(tmp_path / "imu.csv", truth, _imu(truth), start=START + 4, per_second=per_second)
    second = _write(tmp_path / "state.csv", truth, _state(truth), per_second=per_second)
    log = read_one_flight([first, second])
    _assert_joined(log, truth)
    rate, position = log.stream("rate"), log.stream("position")
    assert rate is not None
    assert position is not None
    assert_allclose(position.time, truth.time, atol=1e-9)
    assert_allclose(rate.time, truth.time + 0.004, atol=1e-9)
    assert log.start == pytest.approx(813.0)
    assert source_of(log.metadata) == "estimator"
    assert log.provenance.path == f"{first} + state.csv"
    assert log.provenance.format == "CSV of Crazyflie log variables"


def test_pwm_and_a_quaternion_are_read_by_their_names(truth: Truth, tmp_path: Path) -> None:
    q = truth.attitude
    columns = {f"stateEstimate.q{part}": q[:, index] for index, part in enumerate("wxyz")}
    columns |= {f"pwm.m{n + 1}_pwm": truth.rotor_speed[:, 3 - n] / 2000 * 65535 for n in range(4)}
    log = read_log(_write(tmp_path / "a.csv", truth, columns))
    assert_allclose(_values(log, "attitude"), q, atol=1e-9)
    assert_allclose(_values(log, "rotor_command"), truth.rotor_speed / 2000, atol=1e-9)


def test_chunks_of_a_block_have_all_rows(truth: Truth, tmp_path: Path) -> None:
    path = _write(tmp_path / "imu.csv", truth, _imu(truth))
    assert sum(len(_values(chunk, "rate")) for chunk in read_chunks(path, 1.0)) == len(truth.time)


def test_files_of_two_clocks_or_of_two_flights_are_refused(truth: Truth, tmp_path: Path) -> None:
    first = _write(tmp_path / "imu.csv", truth, _imu(truth))
    other = _write(tmp_path / "state.csv", truth, _state(truth), start=0)
    with pytest.raises(DataError, match=r"imu\.csv runs from 813\.000 to 817\.000 s .* not on one clock"):
        read_one_flight([first, other])
    backwards = Truth(truth.time, *(values[::-1] for values in truth[1:]))
    with pytest.raises(DataError, match="as files of one flight"):
        read_one_flight([first, _write(tmp_path / "b.csv", truth, _state(backwards))])


def test_files_of_different_formats_are_joined(truth: Truth, tmp_path: Path) -> None:
    """A flight CSV of motion capture beside a block of the vehicle, which were stamped by one clock."""
    path = flight_csv(truth, tmp_path / "pose.csv")
    table = pandas.read_csv(path)
    table["t"] += START / 1e3
    table[["t", *(name for name in table if name.startswith(("position", "velocity", "attitude")))]].to_csv(
        path, index=False
    )
    state = {name: values for name, values in _state(truth).items() if name.startswith("motor")}
    second = _write(tmp_path / "imu.csv", truth, {**_imu(truth), **state})
    _assert_joined(read_one_flight([path, second]), truth)


def test_a_single_file_is_itself(truth: Truth, tmp_path: Path) -> None:
    path = _write(tmp_path / "imu.csv", truth, _imu(truth))
    assert read_one_flight([path]).provenance == read_log(path).provenance


def test_commands_join_the_cut_of_a_reported_flight() -> None:
    files = [str(DATA / name) for name in ("imu.csv", "stabilizer.csv")]
    result = CliRunner().invoke(app, ["inspect", *files, "--one-flight", "--json"])
    assert result.exit_code == 0, result.output
    assert '"quantity":"rotor_command"' in result.stdout.replace(" ", "")
    assert not logs_are_joined()  # the next call reads a flight a file
    assert "further blocks" not in result.stdout
    alone = CliRunner().invoke(app, ["inspect", *files])
    assert " ".join(alone.stdout.split()).count("further blocks of the flight join it by --one-flight") == 2
    with logs_joined():
        (flight,) = read_flights(files)
    assert flight.has("position", "rate", "rotor_command")
    assert len(read_flights(files[1:])) == 1
    assert alula.read_log(files[0]).stream("position") is None
