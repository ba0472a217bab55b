"""ArduPilot's motors: on any outputs, in any range of any of its versions, with ESCs of any number."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

from dynamics import frames
from dynamics.arrays import Floats
from fixtures.dataflash_file import Message, dataflash_file
from flights import Log, read_log
from tests.support.flight_files import Truth, manoeuvre

ORDER = [2, 1, 3, 0]  # ArduPilot's motor of each of our rotors
FRAME = {"FRAME_CLASS": 1.0, "FRAME_TYPE": 1.0}
PWM = {"MOT_PWM_MIN": 1000.0, "MOT_PWM_MAX": 2000.0}


@pytest.fixture(scope="module")
def truth() -> Truth:
    return manoeuvre(12.0)


def _commands(truth: Truth) -> Floats:
    """(n, 4) of ArduPilot's motors: the thrust goes with their square."""
    return np.asarray((0.4 + 0.02 * np.arange(4)) * np.sqrt(truth.specific_force[:, 2:] / 9.81))


def _functions(outputs: Sequence[int]) -> dict[str, float]:
    functions = {f"SERVO{n}_FUNCTION": 0.0 for n in range(1, 17)}
    return functions | {f"SERVO{n}_FUNCTION": 33.0 + motor for motor, n in enumerate(outputs)}


def _log(
    truth: Truth,
    tmp_path: Path,
    pulses: Mapping[int, Floats],
    parameters: Mapping[str, float],
    escs: Mapping[int, Floats] | None = None,
) -> Log:
    """A log with pulses by output and rpm by instance of ESC, each (n,)."""
    stamps = (5_000_000 + np.round(truth.time * 1e6)).astype("<u8")
    count = len(stamps)
    outputs = {f"C{n}": np.round(pulses.get(n, np.zeros(count))).astype("<u2") for n in range(1, 15)}
    imu = {"TimeUS": stamps, "I": np.zeros(count, dtype="u1")}
    for prefix, values in (("Gyr", truth.rate), ("Acc", truth.specific_force)):
        body = frames.flu_from_frd(values)
        imu |= {f"{prefix}{axis}": body[:, n].astype("<f4") for n, axis in enumerate("XYZ")}
    messages = [Message("RCOU", {"TimeUS": stamps, **outputs}), Message("IMU", imu)]
    if escs:
        parts = [(stamps + 100 * esc, np.full(count, esc), rpm) for esc, rpm in escs.items()]
        time, instance, rpm = (np.concatenate(part) for part in zip(*parts, strict=True))
        fields = {"TimeUS": time.astype("<u8"), "Instance": instance.astype("u1"), "RPM": rpm.astype("<f4")}
        messages.append(Message("ESC", fields))
    path = tmp_path / "log.bin"
    path.write_bytes(dataflash_file(messages, parameters))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        return read_log(path)


def _check(log: Log, truth: Truth, atol: float = 1e-3) -> None:
    stream = log.stream("rotor_command")
    assert stream is not None, (log.provenance.notes, log.provenance.unused)
    assert_allclose(stream.values, _commands(truth)[:, ORDER], atol=atol)


@pytest.mark.parametrize("outputs", [(1, 2, 3, 4), (9, 10, 11, 12), (5, 6, 7, 8), (3, 14, 9, 1)])
def test_motors_are_on_the_outputs_that_their_functions_name(
    truth: Truth, tmp_path: Path, outputs: Sequence[int]
) -> None:
    pulses = {n: 1000 + 1000 * _commands(truth)[:, motor] for motor, n in enumerate(outputs)}
    log = _log(truth, tmp_path, pulses, {**FRAME, **PWM, **_functions(outputs)})
    _check(log, truth)
    assert not log.provenance.unused


@pytest.mark.parametrize(
    "limits",
    [{}, {"RC3_MIN": 1000.0, "RC3_MAX": 2000.0}, {"RCMAP_THROTTLE": 1.0, "RC1_MIN": 1000.0, "RC1_MAX": 2000.0}],
)
def test_a_copter_before_functions_has_motor_n_on_output_n(
    truth: Truth, tmp_path: Path, limits: Mapping[str, float]
) -> None:
    """FRAME and MOT_PWM_MIN and MAX of 0, where the throttle stick's range is the motors'."""
    pulses = {n + 1: 1000 + 1000 * _commands(truth)[:, n] for n in range(4)}
    log = _log(truth, tmp_path, pulses, {"FRAME": 1.0, "MOT_PWM_MIN": 0.0, "MOT_PWM_MAX": 0.0, **limits})
    _check(log, truth)
    assert any("put in our order as ArduPilot's quad x" in note for note in log.provenance.notes)


def test_the_throttle_sticks_range_is_the_motors_where_none_is_set(truth: Truth, tmp_path: Path) -> None:
    pulses = {n + 1: 1100 + 800 * _commands(truth)[:, n] for n in range(4)}
    limits = {"MOT_PWM_MIN": 0.0, "MOT_PWM_MAX": 0.0, "RC3_MIN": 1100.0, "RC3_MAX": 1900.0}
    _check(_log(truth, tmp_path, pulses, {**FRAME, **limits, **_functions((1, 2, 3, 4))}), truth)


@pytest.mark.parametrize("limits", [PWM, {"MOT_PWM_MIN": 0.0, "MOT_PWM_MAX": 0.0}])
def test_oneshot_is_an_eighth_of_the_pulses(truth: Truth, tmp_path: Path, limits: Mapping[str, float]) -> None:
    pulses = {n + 1: 125 + 125 * _commands(truth)[:, n] for n in range(4)}
    log = _log(truth, tmp_path, pulses, {**FRAME, **limits, **_functions((1, 2, 3, 4))})
    _check(log, truth, atol=0.005)
    assert any("OneShot125 pulses from 125 to 250" in text for text in log.provenance.inferences)


@pytest.mark.parametrize(
    ("outputs", "instances", "phantoms"),
    [
        ((1, 2, 3, 4), (0, 1, 2, 3), ()),
        ((9, 10, 11, 12), (8, 9, 10, 11), (0, 1, 2, 3)),
        ((9, 10, 11, 12), (0, 1, 2, 3), ()),
        ((1, 2, 3, 4), (0, 1, 2, 3), (4, 5, 6, 7)),
        ((1, 2, 3, 4), (4, 5, 6, 7), (0, 1, 2, 3)),
    ],
)
def test_speeds_are_those_of_the_escs_that_turn(
    truth: Truth, tmp_path: Path, outputs: Sequence[int], instances: Sequence[int], phantoms: Sequence[int]
) -> None:
    rpm = 20_000 * _commands(truth)
    pulses = {n: 1000 + 1000 * _commands(truth)[:, motor] for motor, n in enumerate(outputs)}
    escs = {esc: np.zeros(len(rpm)) for esc in phantoms} | {esc: rpm[:, n] for n, esc in enumerate(instances)}
    log = _log(truth, tmp_path, pulses, {**FRAME, **PWM, **_functions(outputs)}, escs)
    stream = log.stream("rotor_speed")
    assert stream is not None, log.provenance.unused
    assert_allclose(stream.values, rpm[:, ORDER] * 2 * np.pi / 60, rtol=1e-6)
    assert [unused.reason for unused in log.provenance.unused] == ["they never turn"] * bool(phantoms)


def test_outputs_that_no_function_names_are_candidates(truth: Truth, tmp_path: Path) -> None:
    pulses = {n: 1000 + 1000 * _commands(truth)[:, n - 9] for n in range(9, 13)}
    log = _log(truth, tmp_path, pulses, {**FRAME, **PWM, **_functions(())})
    assert log.stream("rotor_command") is None
    (unused,) = log.provenance.unused
    assert str(unused).startswith("RCOU: C9 to C12 move between 1")
    assert "no SERVOn_FUNCTION names them as motors" in unused.reason
