"""Nothing is missing that a log holds: numbers that are not used as a quantity are kept with range and reason."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pyarrow as pa
import pyarrow.parquet
import pytest
from numpy.testing import assert_allclose
from numpy.typing import NDArray

from dynamics import frames
from dynamics.arrays import Floats
from dynamics.errors import DataError
from dynamics.vehicle import Vehicle
from fixtures.ulog_file import Topic, ulog_file
from flights import Flight, Log, read_log
from flights.quality.inspection import judge
from flights.rotors import rotor_speeds
from tests.support.flight_files import Truth, flight_csv, manoeuvre

COMMAND = 0.5 + 0.02 * np.arange(4)  # of PX4's motors, which are our rotors 3, 1, 0, 2
ORDER = [2, 1, 3, 0]
MISSING = ("neither rotor speeds nor commands", "log them", "SDLOG_PROFILE")


@pytest.fixture(scope="module")
def truth() -> Truth:
    return manoeuvre(12.0)


def _commands(truth: Truth) -> Floats:
    """(n, 4) of PX4's motors: the thrust goes with their square."""
    return np.asarray((COMMAND - 0.1) * np.sqrt(truth.specific_force[:, 2:] / 9.81))


def _ulog(
    truth: Truth,
    tmp_path: Path,
    outputs: Mapping[int, Floats],
    parameters: Mapping[str, float] | None = None,
    *extra: Topic,
) -> Log:
    """A log of motion with instances of actuator_outputs by number, each (n, k)."""
    stamps = (5_000_000 + np.round(truth.time * 1e6)).astype("<u8")

    def columns(values: Floats) -> NDArray[Any]:
        return np.asarray(values).astype("<f4")

    force = columns(frames.flu_from_frd(truth.specific_force))
    gyro = columns(frames.flu_from_frd(truth.rate))
    topics = [
        Topic("sensor_combined", {"timestamp": stamps, "gyro_rad": gyro, "accelerometer_m_s2": force}),
        Topic("vehicle_attitude", {"timestamp": stamps, "q": columns(frames.attitude_ned_frd(truth.attitude))}),
    ]
    for instance, values in outputs.items():
        table = np.zeros((len(stamps), 16))
        table[:, : values.shape[1]] = values
        topics.append(Topic("actuator_outputs", {"timestamp": stamps, "output": columns(table)}, instance))
    path = tmp_path / "log.ulg"
    path.write_bytes(ulog_file([*topics, *extra], {"MAV_TYPE": 2, **(parameters or {})}))
    return read_log(path)


def _rotor_command(log: Log) -> Floats:
    stream = log.stream("rotor_command")
    assert stream is not None, log.provenance.unused
    return stream.values


@pytest.mark.parametrize("instance", [0, 1, 2, 3])
def test_motors_are_found_on_any_instance(truth: Truth, tmp_path: Path, instance: int) -> None:
    zeros = {other: np.zeros((len(truth.time), 4)) for other in range(instance)}
    pulses = 1000.0 + 1000.0 * _commands(truth)
    log = _ulog(truth, tmp_path, {**zeros, instance: pulses})
    assert_allclose(_rotor_command(log), _commands(truth)[:, ORDER], atol=1e-4)


@pytest.mark.parametrize("motors_on", [0, 1, 2])
def test_of_several_instances_that_move_the_motors_go_with_the_thrust(
    truth: Truth, tmp_path: Path, motors_on: int
) -> None:
    servos = 1500.0 + 400.0 * np.sin(truth.time[:, None] * np.array([0.9, 1.7, 2.3, 3.1]))
    outputs = dict.fromkeys(range(3), servos)
    outputs[motors_on] = 8191.0 * _commands(truth)
    log = _ulog(truth, tmp_path, outputs)
    assert_allclose(_rotor_command(log), _commands(truth)[:, ORDER], atol=1e-4)
    assert any("UAVCAN raw commands from 0 to 8191" in text for text in log.provenance.inferences)
    assert {unused.source for unused in log.provenance.unused} == {
        f"actuator_outputs[{other}]" for other in range(3) if other != motors_on
    }


@pytest.mark.parametrize(
    ("parameters", "low", "high", "channels"),
    [
        ({"DSHOT_CONFIG": 600}, 0.0, 1999.0, (0, 1, 2, 3)),
        ({"DSHOT_CONFIG": 600, "DSHOT_MIN": 0.055}, 0.055 * 1999, 1999.0, (0, 1, 2, 3)),
        ({f"PWM_AUX_FUNC{5 + n}": 101 + n for n in range(4)} | {"PWM_AUX_TIM0": -3}, 0.0, 1999.0, (4, 5, 6, 7)),
        ({f"UAVCAN_EC_FUNC{4 - n}": 101 + n for n in range(4)}, 0.0, 8191.0, (3, 2, 1, 0)),
        ({f"UAVCAN_EC_FUNC{1 + n}": 101 + n for n in range(4)} | {f"UAVCAN_EC_MIN{1 + n}": 200 for n in range(4)},
         200.0, 8191.0, (0, 1, 2, 3)),
        ({"PWM_MIN": 1100, "PWM_MAX": 1900}, 1100.0, 1900.0, (0, 1, 2, 3)),
        ({"PWM_AUX_FUNC1": 201, "SYS_CTRL_ALLOC": 0}, 1000.0, 2000.0, (0, 1, 2, 3)),
    ],
)  # fmt: skip
def test_ranges_and_channels_are_those_that_parameters_state(
    truth: Truth,
    tmp_path: Path,
    parameters: dict[str, float],
    low: float,
    high: float,
    channels: tuple[int, ...],
) -> None:
    outputs = np.zeros((len(truth.time), 8))
    outputs[:, channels] = low + (high - low) * _commands(truth)
    log = _ulog(truth, tmp_path, {1: outputs}, parameters)
    assert_allclose(_rotor_command(log), _commands(truth)[:, ORDER], atol=1e-3)
    assert any(f"{low:g} to {high:g}, by " in text for text in log.provenance.inferences), log.provenance.inferences


def test_a_stream_that_stands_still_never_wins_over_one_that_moves(truth: Truth, tmp_path: Path) -> None:
    stamps = (5_000_000 + np.round(truth.time * 1e6)).astype("<u8")
    still = Topic("actuator_motors", {"timestamp": stamps, "control": np.full((len(stamps), 12), 0.0, dtype="<f4")})
    log = _ulog(truth, tmp_path, {0: 1000.0 + 1000.0 * _commands(truth)}, None, still)
    assert_allclose(_rotor_command(log), _commands(truth)[:, ORDER], atol=1e-4)


def test_escs_that_never_turn_are_no_rotors(truth: Truth, tmp_path: Path) -> None:
    stamps = (5_000_000 + np.round(truth.time * 1e6)).astype("<u8")
    rpm = {f"esc[{esc}].esc_rpm": np.zeros(len(stamps), dtype="<i4") for esc in range(8)}
    turning = {f"esc[{4 + n}].esc_rpm": (20_000.0 * _commands(truth)[:, n]).astype("<i4") for n in range(4)}
    pulses = {0: 1000.0 + 1000.0 * _commands(truth)}
    log = _ulog(truth, tmp_path, pulses, None, Topic("esc_status", {"timestamp": stamps, **rpm}))
    assert log.stream("rotor_speed") is None
    assert "esc_status[0]" in {unused.source for unused in log.provenance.unused}
    second = Topic("esc_status", {"timestamp": stamps, **rpm, **turning}, 1)
    log = _ulog(truth, tmp_path, pulses, None, Topic("esc_status", {"timestamp": stamps, **rpm}), second)
    stream = log.stream("rotor_speed")
    assert stream is not None
    expected = (20_000.0 * _commands(truth)[:, ORDER]) * 2 * np.pi / 60
    assert_allclose(stream.values, expected, atol=0.2)


def test_outputs_without_a_function_or_a_type_are_candidates_and_not_missing(
    truth: Truth, tmp_path: Path, arpl_250g: Vehicle
) -> None:
    pulses = 1000.0 + 1000.0 * _commands(truth)
    log = _ulog(truth, tmp_path, {2: pulses}, {"MAV_TYPE": 13, "SYS_CTRL_ALLOC": 1, "PWM_MAIN_FUNC1": 201})
    (unused,) = log.provenance.unused
    assert unused.source == "actuator_outputs[2]"
    assert unused.fields == tuple(f"output[{n}]" for n in range(4))
    assert unused.quantity == "rotor_command"
    assert unused.moves
    assert unused.count == len(truth.time)
    assert (unused.low, unused.high) == pytest.approx((pulses.min(), pulses.max()), abs=1e-3)
    assert f"outputs 0 to 3 move between {unused.low:.6g} and {unused.high:.6g}; not used: no function" in str(unused)
    inspection = judge(log)
    lines = [
        inspection.sentence,
        *(f.text + f.advice for f in inspection.findings),
        *(e.why for e in inspection.effects),
    ]
    assert not any(text in line for text in MISSING for line in lines)
    assert any(str(unused) in finding.text for finding in inspection.findings)
    assert msgspec.json.decode(msgspec.json.encode(inspection))["unused"][0]["source"] == "actuator_outputs[2]"
    with pytest.raises(DataError, match=r"may hold them unnamed: actuator_outputs\[2\]") as refused:
        rotor_speeds(Flight.from_log(log), arpl_250g)
    assert not any(text in str(refused.value) for text in MISSING)


@pytest.mark.parametrize("topic", ["vehicle_acceleration", "vehicle_imu"])
def test_a_specific_force_is_read_without_sensor_combined(truth: Truth, tmp_path: Path, topic: str) -> None:
    stamps = (5_000_000 + np.round(truth.time * 1e6)).astype("<u8")
    force = frames.flu_from_frd(truth.specific_force)
    fields: dict[str, NDArray[Any]] = {"xyz": force.astype("<f4")}
    if topic == "vehicle_imu":
        interval = np.full(len(stamps), 5000, dtype="<u4")
        fields = {"delta_velocity": (force * 5e-3).astype("<f4"), "delta_velocity_dt": interval}
    path = tmp_path / "log.ulg"
    attitude = frames.attitude_ned_frd(truth.attitude).astype("<f4")
    path.write_bytes(
        ulog_file(
            [
                Topic(topic, {"timestamp": stamps, **fields}),
                Topic("vehicle_attitude", {"timestamp": stamps, "q": attitude}),
            ]
        )
    )
    stream = read_log(path).stream("specific_force")
    assert stream is not None
    assert stream.source == topic
    assert_allclose(stream.values, truth.specific_force, atol=1e-4)


def test_raw_accelerometers_are_candidates(truth: Truth, tmp_path: Path) -> None:
    stamps = (5_000_000 + np.round(truth.time * 1e6)).astype("<u8")
    raw = {axis: truth.specific_force[:, n].astype("<f4") for n, axis in enumerate("xyz")}
    path = tmp_path / "log.ulg"
    attitude = frames.attitude_ned_frd(truth.attitude).astype("<f4")
    pose = Topic("vehicle_attitude", {"timestamp": stamps, "q": attitude})
    path.write_bytes(ulog_file([Topic("sensor_accel", {"timestamp": stamps, **raw}, 1), pose]))
    (unused,) = read_log(path).provenance.unused
    assert (unused.source, unused.quantity, unused.fields) == ("sensor_accel[1]", "specific_force", ("x", "y", "z"))


@pytest.mark.parametrize("names", ["eRPM[{}]", "erpm_{}", "motor_rpm_{}", "m{}", "esc{}_rpm", "pwm{}", "motor[{}]"])
@pytest.mark.parametrize("form", ["csv", "parquet"])
def test_columns_that_may_be_rotors_are_candidates(truth: Truth, tmp_path: Path, names: str, form: str) -> None:
    path = flight_csv(truth, tmp_path / "flight.csv")
    header, *rows = path.read_text().splitlines()
    for rotor in range(4):
        header = header.replace(f"rotor_speed_{rotor}", names.format(rotor))
    path.write_text("\n".join([header, *rows]) + "\n")
    if form == "parquet":
        table = np.loadtxt(path, delimiter=",", skiprows=1)
        path = tmp_path / "flight.parquet"
        pa.parquet.write_table(pa.table(list(table.T), names=header.split(",")), path)
    log = read_log(path)
    (unused,) = log.provenance.unused
    assert unused.fields == tuple(names.format(rotor) for rotor in range(4))
    assert unused.quantity == ("rotor_speed" if "rpm" in names.lower() else "rotor_command")
    assert (unused.low, unused.high) == pytest.approx((truth.rotor_speed.min(), truth.rotor_speed.max()))
    assert not any(text in finding.text for text in MISSING for finding in judge(log).findings)


def test_a_table_without_any_rotor_still_lacks_them(truth: Truth, tmp_path: Path) -> None:
    path = flight_csv(truth, tmp_path / "flight.csv")
    header, *rows = path.read_text().splitlines()
    for rotor in range(4):
        header = header.replace(f"rotor_speed_{rotor}", f"esc{rotor}_temperature")
    path.write_text("\n".join([header, *rows]) + "\n")
    log = read_log(path)
    assert not log.provenance.unused
    assert any("neither rotor speeds nor commands" in finding.text for finding in judge(log).findings)
