"""ULogs of PX4's versions: topics and fields by any of their names, rotors by function, frames by what the log says."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose
from numpy.typing import NDArray

from dynamics import frames, quaternion
from dynamics.arrays import Floats
from fixtures.ulog_file import Topic, ulog_file
from flights import Flight, Log, read_log
from flights.alignment import resample
from tests.support.flight_files import Truth, manoeuvre

QUAD_X = {f"CA_ROTOR{i}_P{axis}": value for i, (x, y) in enumerate([(0.1, 0.1), (-0.1, -0.1), (0.1, -0.1), (-0.1, 0.1)])
          for axis, value in (("X", x), ("Y", y))}  # fmt: skip


@pytest.fixture(scope="module")
def truth() -> Truth:
    return manoeuvre()


def _read(tmp_path: Path, topics: Sequence[Topic], parameters: dict[str, float] | None = None) -> Log:
    path = tmp_path / "log.ulg"
    path.write_bytes(ulog_file(topics, parameters))
    return read_log(path)


def _stamps(truth: Truth) -> NDArray[np.uint64]:
    return (5_000_000 + np.round(truth.time * 1e6)).astype("<u8")


def _f(values: Any) -> NDArray[np.float32]:
    return np.asarray(values).astype("<f4")


def _values(log: Log, name: str) -> Floats:
    stream = log.stream(name)
    assert stream is not None, f"{name}: {log.names}, {log.provenance.notes}"
    return stream.values


def _odometry(truth: Truth, **changed: Any) -> Topic:
    stamps = _stamps(truth)
    fields = {
        "timestamp": stamps + 2000,
        "timestamp_sample": stamps,
        "position": _f(frames.enu_from_ned(truth.position)),
        "q": _f(frames.attitude_ned_frd(truth.attitude)),
        "velocity": _f(frames.enu_from_ned(truth.velocity)),
        "velocity_frame": np.full(len(stamps), 1, dtype="u1"),
    }
    return Topic("vehicle_odometry", {**fields, **changed})


def test_odometry_velocity_is_in_the_frame_that_the_log_names(truth: Truth, tmp_path: Path) -> None:
    log = _read(tmp_path, [_odometry(truth)])
    assert_allclose(_values(log, "velocity"), truth.velocity, atol=1e-5)
    assert_allclose(log.stream("velocity").time, truth.time, atol=1e-9)  # type: ignore[union-attr]
    assert log.start == pytest.approx(5.0)
    body = _f(frames.flu_from_frd(quaternion.rotate_inverse(truth.attitude, truth.velocity)))
    in_body = np.full(len(body), 3, dtype="u1")
    log = _read(tmp_path, [_odometry(truth, velocity=body, velocity_frame=in_body)])
    assert_allclose(_values(log, "velocity"), truth.velocity, atol=1e-5)


def test_a_velocity_in_an_unknown_frame_is_masked(truth: Truth, tmp_path: Path) -> None:
    log = _read(tmp_path, [_odometry(truth, velocity_frame=np.full(len(truth.time), 2, dtype="u1"))])
    assert log.stream("velocity") is None
    assert "unknown_frame" in {repair.name for repair in log.provenance.repairs}


def test_odometry_of_old_firmware(truth: Truth, tmp_path: Path) -> None:
    ned, velocity = frames.enu_from_ned(truth.position), frames.enu_from_ned(truth.velocity)
    fields = {"timestamp": _stamps(truth), "q": _f(frames.attitude_ned_frd(truth.attitude))}
    fields |= {name: _f(ned[:, axis]) for axis, name in enumerate("xyz")}
    fields |= {f"v{name}": _f(velocity[:, axis]) for axis, name in enumerate("xyz")}
    log = _read(tmp_path, [Topic("vehicle_odometry", fields)])
    assert_allclose(_values(log, "velocity"), truth.velocity, atol=1e-5)
    assert any("no velocity_frame" in note for note in log.provenance.notes)
    old_ned = {**fields, "velocity_frame": np.zeros(len(truth.time), dtype="u1")}
    assert_allclose(
        _values(_read(tmp_path, [Topic("vehicle_odometry", old_ned)]), "velocity"), truth.velocity, atol=1e-5
    )


def test_topics_are_found_by_their_old_names(truth: Truth, tmp_path: Path) -> None:
    old = Topic("vehicle_vision_odometry", _odometry(truth).fields)
    log = _read(tmp_path, [old])
    position = log.stream("position")
    assert position is not None
    assert position.source == "vehicle_visual_odometry"
    assert_allclose(position.values, truth.position, atol=1e-5)


def _esc(truth: Truth, functions: Sequence[int]) -> Topic:
    speeds = truth.rotor_speed * 60 / (2 * np.pi)  # of our rotors 0 to 3, which are PX4's motors 3, 2, 4, 1
    by_function = {103: speeds[:, 0], 102: speeds[:, 1], 104: speeds[:, 2], 101: speeds[:, 3]}
    fields: dict[str, NDArray[Any]] = {"timestamp": _stamps(truth)}
    nested = ["esc_rpm", "actuator_function"]
    for esc, function in enumerate(functions):
        rpm = by_function.get(function or 101 + esc, np.zeros(len(truth.time)))
        fields[f"esc[{esc}].{nested[0]}"] = rpm.round().astype("<i4")
        fields[f"esc[{esc}].{nested[1]}"] = np.full(len(rpm), function, dtype="u1")
    return Topic("esc_status", fields)


@pytest.mark.parametrize(
    "functions", [(101, 102, 103, 104), (104, 101, 103, 102), (0, 0, 0, 0), (0, 103, 101, 102, 104)]
)
def test_escs_are_mapped_by_their_function(truth: Truth, tmp_path: Path, functions: tuple[int, ...]) -> None:
    log = _read(tmp_path, [_esc(truth, functions)], {"CA_ROTOR_COUNT": 4, **QUAD_X})
    assert_allclose(_values(log, "rotor_speed"), truth.rotor_speed, atol=0.06)


def test_a_missing_motor_leaves_the_speeds_out(truth: Truth, tmp_path: Path) -> None:
    log = _read(tmp_path, [_esc(truth, (101, 102, 104)), _odometry(truth)], {"CA_ROTOR_COUNT": 4, **QUAD_X})
    assert log.stream("rotor_speed") is None
    assert any("motors [0, 1, 3] only" in note for note in log.provenance.notes)


def test_outputs_are_mapped_by_their_function_and_scaled_by_their_limits(truth: Truth, tmp_path: Path) -> None:
    command = np.linspace(0.1, 0.9, 4) + 0.05 * np.sin(truth.time)[:, None]  # of our rotors
    motors = command[:, [3, 1, 0, 2]]  # PX4's motor n where our rotor is
    output = np.full((len(command), 16), 900.0)
    output[:, 2:6] = 1100.0 + 800.0 * motors
    parameters: dict[str, float] = {f"PWM_MAIN_FUNC{3 + motor}": 101 + motor for motor in range(4)}
    parameters |= {f"PWM_MAIN_MIN{channel}": 1100 for channel in range(1, 9)}
    parameters |= {f"PWM_MAIN_MAX{channel}": 1900 for channel in range(1, 9)}
    topic = Topic("actuator_outputs", {"timestamp": _stamps(truth), "output": _f(output)})
    log = _read(tmp_path, [topic], {"CA_ROTOR_COUNT": 4, **QUAD_X, **parameters})
    assert_allclose(_values(log, "rotor_command"), command, atol=1e-6)


def test_the_fastest_rotor_commands_come_first(truth: Truth, tmp_path: Path) -> None:
    """Old logs hold the outputs at 10 Hz and the controls that they were mixed from at 100 Hz."""
    slow = slice(None, None, 10)
    stamps, count = _stamps(truth), len(truth.time)
    pulses = 1000.0 + 500.0 * np.ones((count, 16)) + 10 * np.sin(truth.time)[:, None]
    control = np.stack([0.1 * np.ones(count), 0 * truth.time, 0 * truth.time, 0.5 + 0.05 * np.sin(truth.time)], axis=1)
    topics = [
        Topic("actuator_outputs", {"timestamp": stamps[slow], "output": _f(pulses[slow])}),
        Topic("actuator_controls_0", {"timestamp": stamps, "control": _f(control)}),
        Topic("vehicle_status", {"timestamp": stamps[:1], "system_type": np.array([2], dtype="u1")}),
    ]
    log = _read(tmp_path, topics)
    assert [stream.source for stream in log.alternatives("rotor_command")] == [
        "actuator_controls_0",
        "actuator_outputs",
    ]
    command = _values(log, "rotor_command")[0]
    assert command == pytest.approx(0.5 + 0.1 * np.sqrt(0.5) * np.array([1, 1, -1, -1]))  # rolls right: left lifts
    assert any("quad x mixer" in note for note in log.provenance.notes)


def test_rotor_commands_are_motor_signals_behind_the_thrust_model(truth: Truth, tmp_path: Path) -> None:
    signal, factor = np.clip(truth.rotor_speed / 2000.0, 0.0, 1.0), 0.4
    thrust = factor * signal**2 + (1 - factor) * signal
    motors = {f"control[{i}]": _f(thrust[:, i] if i < 4 else np.full(len(thrust), np.nan)) for i in range(12)}
    topic = Topic("actuator_motors", {"timestamp": _stamps(truth), "timestamp_sample": _stamps(truth), **motors})
    log = _read(tmp_path, [_odometry(truth), topic], {"THR_MDL_FAC": factor})
    assert_allclose(_values(log, "rotor_command"), signal, atol=1e-6)
    assert any("THR_MDL_FAC" in note for note in log.provenance.notes)


def test_what_the_estimator_calls_invalid_is_masked(truth: Truth, tmp_path: Path) -> None:
    count = len(truth.time)
    ned, velocity = frames.enu_from_ned(truth.position), frames.enu_from_ned(truth.velocity)
    valid = (truth.time > 1.0).astype("u1")
    fields = {"timestamp": _stamps(truth), "xy_valid": valid, "z_valid": np.ones(count, dtype="u1")}
    fields |= {name: _f(ned[:, axis]) for axis, name in enumerate("xyz")}
    fields |= {f"v{name}": _f(velocity[:, axis]) for axis, name in enumerate("xyz")}
    fields |= {"xy_reset_counter": valid, "z_reset_counter": 0 * valid}
    log = _read(tmp_path, [Topic("vehicle_local_position", fields)])
    flight, flight_stream = Flight.from_log(log), log.stream("position")
    assert flight_stream is not None
    assert np.isnan(flight["position_x"][:100]).all()
    assert np.isfinite(flight["position_z"]).all()
    assert np.isnan(resample(flight_stream, flight.time + 0.003)[:99, 0]).all()
    assert np.isfinite(resample(flight_stream, flight.time - 0.003)[1:, 2]).all()
    (segment,) = flight.segments()
    assert segment.time[0] == pytest.approx(1.01)


def test_topics_of_every_rate_are_joined_on_the_gyros_clock(truth: Truth, tmp_path: Path) -> None:
    fine = manoeuvre(rate=250.0)
    rates = Topic(
        "vehicle_angular_velocity", {"timestamp": _stamps(fine) + 1, "xyz": _f(frames.flu_from_frd(fine.rate))}
    )
    volts = np.linspace(12.6, 12.0, 7)
    battery = Topic(
        "battery_status", {"timestamp": (5_000_000 + np.arange(7) * 1_000_000).astype("<u8"), "voltage_v": _f(volts)}
    )
    flight = Flight.from_log(_read(tmp_path, [_odometry(truth), rates, battery]))
    assert flight.rate == pytest.approx(250.0)
    at = flight.time - 1e-6
    inside = (at > 0.01) & (at < 5.98)
    assert_allclose(flight["rate"][inside], fine.rate[1:-1][: inside.sum()], atol=0.02)
    exact = [np.interp(flight.time[inside], truth.time, column) for column in truth.position.T]
    assert_allclose(flight["position"][inside], np.stack(exact, axis=1), atol=1e-5)
    assert flight["battery_voltage"][inside][10] == pytest.approx(12.6)
    assert flight.origins["battery_voltage"].rate == pytest.approx(1.0)
