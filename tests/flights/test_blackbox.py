"""Blackbox logs are read without a mapping: units, motor range, poles, and the gyro's signs that close."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

from dynamics import quaternion
from dynamics.arrays import Floats
from dynamics.errors import DataError, RequestError
from dynamics.unpacking import BYTES
from flights import Flight, Log, read_log
from flights.pose_source import source_of
from flights.reading import read_chunks
from flights.stated_frame import stated_layout
from tests.support.blackbox_table import FLU, FRD, FULL_SPEED, columns_of, inav_columns, text_of
from tests.support.flight_files import Truth, manoeuvre

DATA = Path(__file__).parents[1] / "data" / "blackbox"


@pytest.fixture(scope="module")
def truth() -> Truth:
    return manoeuvre(duration=4.0, rate=100.0)


def _write(folder: Path, text: str) -> Path:
    (folder / "LOG00001.01.csv").write_text(text)
    return folder / "LOG00001.01.csv"


def _values(log: Log, name: str) -> Floats:
    stream = log.stream(name)
    assert stream is not None, name
    return stream.values


def _assert_read(log: Log, truth: Truth) -> None:
    assert_allclose(_values(log, "rate"), truth.rate, atol=0.01)
    assert_allclose(_values(log, "specific_force"), truth.specific_force, atol=0.02)
    assert_allclose(_values(log, "rotor_command"), truth.rotor_speed / FULL_SPEED, atol=1e-3)
    turned = np.abs(np.sum(_values(log, "attitude") * truth.attitude, axis=1))
    assert_allclose(turned, 1.0, atol=1e-5)


@pytest.mark.parametrize("gyro", [FLU, FRD])
@pytest.mark.parametrize("quoted", [False, True])
def test_betaflights_numbers_are_read_with_the_signs_that_close(
    truth: Truth, tmp_path: Path, gyro: tuple[float, float, float], quoted: bool
) -> None:
    log = read_log(_write(tmp_path, text_of(columns_of(truth, gyro=gyro), quoted=quoted)))
    _assert_read(log, truth)
    assert_allclose(_values(log, "rotor_speed"), truth.rotor_speed, atol=1.0)
    assert source_of(log.metadata) == "estimator"
    notes = " ".join(log.provenance.notes)
    axes = "y left, z up" if gyro is FLU else "y right, z down"
    assert f"{axes}: it closes with the attitude" in notes
    assert "14 poles (the usual number" in notes
    assert "DShot, 48 to 2047" in notes


def test_without_an_attitude_the_motors_tell_the_gyros_signs(truth: Truth, tmp_path: Path) -> None:
    """The rear motors turn the nose down, which is positive about y to the left."""
    time = truth.time
    pitch = 0.3 * np.sin(7.0 * time)  # rad/s about y left
    rate = np.column_stack([0.1 * np.sin(3 * time), pitch, 0.05 * np.cos(time)])
    acceleration = 0.3 * 7.0 * np.cos(7.0 * time)
    speed = 1200.0 + 20.0 * acceleration[:, None] * np.array([-1.0, 1.0, 1.0, -1.0])  # ours: rotors 1 and 2 are behind
    for gyro in (FLU, FRD):
        columns = columns_of(truth._replace(rate=rate, rotor_speed=speed), gyro=gyro, with_attitude=False)
        log = read_log(_write(tmp_path, text_of(columns)))
        assert_allclose(_values(log, "rate"), rate, atol=0.01)
        assert any("rear motors turn the nose down" in note for note in log.provenance.notes)


@pytest.mark.parametrize("form", ["H {}:{}\n", '"{}","{}"\n'])
def test_what_the_header_states_is_used(truth: Truth, tmp_path: Path, form: str) -> None:
    stated = {
        "Firmware revision": "Betaflight 4.5.1",
        "acc_1G": "4096",
        "motorOutput": "1070,2000",
        "motor_poles": "12",
    }
    preamble = "".join(form.format(key, value) for key, value in stated.items())
    columns = columns_of(truth, one_g=4096.0, poles=12, motors=(1000.0, 2000.0))
    log = read_log(_write(tmp_path, text_of(columns, preamble=preamble)))
    _assert_read(log, truth)
    assert_allclose(_values(log, "rotor_speed"), truth.rotor_speed, atol=1.0)
    assert log.metadata["firmware"] == "Betaflight 4.5.1"


def test_units_in_the_columns_names_are_used(truth: Truth, tmp_path: Path) -> None:
    columns = columns_of(truth)
    renamed: dict[str, Floats] = {}
    for name, values in columns.items():
        if name.startswith("gyroADC"):
            renamed[f"{name} (rad/s)"] = np.radians(values) * 1000
        elif name.startswith("accSmooth"):
            renamed[f"{name} (m/s/s)"] = values / 2048 * 9.80665 * 1000
        else:
            renamed[name] = values
    text = text_of(renamed).split("\n")
    thousandths = {index for index, name in enumerate(renamed) if name.endswith(("(rad/s)", "(m/s/s)"))}
    rows = [
        ", ".join(f"{float(cell) / 1000:.4f}" if i in thousandths else cell for i, cell in enumerate(row.split(", ")))
        for row in text[1:-1]
    ]
    _assert_read(read_log(_write(tmp_path, "\n".join([text[0], *rows]))), truth)


def test_gyros_of_high_resolution_are_told_by_the_attitude(truth: Truth, tmp_path: Path) -> None:
    columns = {
        name: values * 10 if name.startswith("gyroADC") else values for name, values in columns_of(truth).items()
    }
    log = read_log(_write(tmp_path, text_of(columns)))
    assert_allclose(_values(log, "rate"), truth.rate, atol=0.01)
    assert any("tenths of a degree" in note for note in log.provenance.notes)


def test_inavs_angles_position_and_pulses_are_read(truth: Truth, tmp_path: Path) -> None:
    log = read_log(_write(tmp_path, text_of(inav_columns(truth))))
    for name in ("position", "velocity"):
        assert_allclose(_values(log, name), getattr(truth, name), atol=0.01)
    angle = quaternion.angle_between(_values(log, "attitude"), truth.attitude)
    assert np.max(angle) < 0.003
    assert_allclose(_values(log, "rotor_command"), truth.rotor_speed / FULL_SPEED, atol=1e-3)
    assert any("with 512 for one g" in note for note in log.provenance.notes)


def test_motor_numbers_of_pulses_are_told_from_dshot(truth: Truth, tmp_path: Path) -> None:
    columns = columns_of(truth, with_attitude=False, with_erpm=False, motors=(1000.0, 2000.0))
    command = _values(read_log(_write(tmp_path, text_of(columns))), "rotor_command")
    assert_allclose(command, truth.rotor_speed / FULL_SPEED, atol=1e-3)


def test_chunks_of_a_decoded_blackbox_have_all_rows(truth: Truth, tmp_path: Path) -> None:
    path = _write(tmp_path, text_of(columns_of(truth)))
    assert sum(len(_values(chunk, "rate")) for chunk in read_chunks(path, 1.0)) == len(truth.time)


def test_rotors_are_in_our_order_for_a_vehicle_of_that_log(truth: Truth, tmp_path: Path) -> None:
    layout = stated_layout([Flight.read(_write(tmp_path, text_of(columns_of(truth))))], "quad_x")
    assert layout.autopilot == "Betaflight"
    assert [tuple(np.sign(place[:2])) for place in layout.position] == [(1, 1), (-1, 1), (-1, -1), (1, -1)]


def test_a_cut_of_the_reported_log_is_read_without_a_mapping() -> None:
    log = read_log(DATA / "LOG00001.01_cut.csv.gz")
    assert {stream.name for stream in log.streams} == {
        "attitude", "rate", "specific_force", "rotor_speed", "rotor_command", "battery_voltage",
    }  # fmt: skip
    assert any("y right, z down: it closes with the attitude" in note for note in log.provenance.notes)
    first = np.array([828, 830, 828, 830]) * 100 / 7 * 2 * np.pi / 60  # eRPM[3], [2], [0] and [1] of its first row
    assert_allclose(_values(log, "rotor_speed")[0], first)


RAW = b"H Product:Blackbox flight data recorder by Nicholas Sherlock\nH Data version:2\n"


def _decoder(folder: Path, monkeypatch: pytest.MonkeyPatch, script: str) -> None:
    (folder / "bin").mkdir()
    program = folder / "bin" / "blackbox_decode"
    program.write_text(f"#!/bin/sh\n{script}\n")
    program.chmod(0o755)
    monkeypatch.setenv("PATH", f"{folder / 'bin'}:/usr/bin:/bin")


def test_a_raw_log_goes_through_the_decoder_of_the_computer(
    truth: Truth, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The longest flight of the file, with what its header states."""
    table = _write(tmp_path, text_of(columns_of(truth, one_g=4096.0)))
    _decoder(tmp_path, monkeypatch, f'echo "$@" > {tmp_path}/words\necho decoding >&2\ncat {table}')
    raw = tmp_path / "btfl.bbl"
    raw.write_bytes(RAW + b"I\0" * 20 + RAW + b"H acc_1G:4096\n" + b"I\0" * 200)
    log = read_log(raw)
    _assert_read(log, truth)
    assert (tmp_path / "words").read_text().split() == ["--stdout", "--index", "2", str(raw)]
    assert any("2 flights; read: number 2, the longest" in note for note in log.provenance.notes)
    assert log.provenance.format == "Betaflight blackbox log"


@pytest.mark.parametrize(("script", "message"), [("exit 3", "exit status 3"), ("echo hello", "made no table")])
def test_a_decoder_that_fails_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, script: str, message: str
) -> None:
    _decoder(tmp_path, monkeypatch, script)
    (tmp_path / "btfl.bbl").write_bytes(RAW)
    with pytest.raises(DataError, match=message):
        read_log(tmp_path / "btfl.bbl")


def test_a_log_named_like_an_option_is_given_by_its_path(
    truth: Truth, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    table = _write(tmp_path, text_of(columns_of(truth)))
    _decoder(tmp_path, monkeypatch, f'echo "$@" > {tmp_path}/words\ncat {table}')
    (tmp_path / "--raw.bbl").write_bytes(RAW)
    monkeypatch.chdir(tmp_path)
    read_log(Path("--raw.bbl"))
    assert (tmp_path / "words").read_text().split()[-1] == str(tmp_path / "--raw.bbl")


def test_a_decoder_that_floods_is_ended(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    _decoder(tmp_path, monkeypatch, "while :; do echo 0123456789012345678901234567890123456789; done")
    monkeypatch.setenv(BYTES, "0.001")
    (tmp_path / "btfl.bbl").write_bytes(RAW)
    with pytest.raises(RequestError, match="unpacks to more than"):
        read_log(tmp_path / "btfl.bbl")


def test_a_raw_log_names_its_decoder_where_there_is_none(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    (tmp_path / "btfl.bbl").write_bytes(RAW)
    with pytest.raises(DataError, match=r"blackbox_decode of blackbox-tools decodes\. Install it"):
        read_log(tmp_path / "btfl.bbl")
