"""Motors of the autopilot as rotors of the vehicle file: by where they are, complete, or not at all."""

import numpy as np
import pytest

from dynamics.vehicle import Vehicle
from runtime.link.rotors import RotorReader, motor_of_rotors
from runtime.link.telemetry import MotorOutputs, RotorSpeeds


def test_rotors_are_matched_by_their_directions(arpl_250g: Vehicle) -> None:
    assert motor_of_rotors(arpl_250g.rotors) == (2, 1, 3, 0)  # PX4's: front right, back left, front left, back right
    forward_left = np.array(arpl_250g.rotors.position)[[3, 0, 1, 2], :2]
    assert motor_of_rotors(arpl_250g.rotors, 2.0 * forward_left) == (1, 2, 3, 0)


@pytest.mark.parametrize("motors", [np.eye(4)[:, :2], np.zeros((6, 2)), np.array([[1.0, 1.0]] * 4)])
def test_motors_elsewhere_are_no_rotors(arpl_250g: Vehicle, motors: np.ndarray) -> None:
    assert motor_of_rotors(arpl_250g.rotors, motors) is None


def reader() -> RotorReader:
    return RotorReader((2, 1, 3, 0), lambda signal: 1000.0 * signal)


def test_a_reading_is_in_the_vehicle_file_s_order() -> None:
    reading = reader().read(RotorSpeeds(1.0, 1.1, 0, (10.0, 20.0, 30.0, 40.0)))
    assert reading is not None
    assert (reading.time, reading.measured) == (1.0, True)
    np.testing.assert_array_equal(reading.speed, [30.0, 20.0, 40.0, 10.0])


def test_messages_of_a_few_motors_are_joined() -> None:
    joined = reader()
    assert joined.read(RotorSpeeds(1.0, 1.1, 0, (10.0, 20.0))) is None
    reading = joined.read(RotorSpeeds(1.0, 1.1, 2, (30.0, 40.0)))
    assert reading is not None
    np.testing.assert_array_equal(reading.speed, [30.0, 20.0, 40.0, 10.0])


def test_outputs_are_commanded_speeds() -> None:
    reading = reader().read(MotorOutputs(1.0, 1.1, "SERVO_OUTPUT_RAW", (1100.0, 1200.0, 1300.0, 1400.0, 900.0)))
    assert reading is not None
    assert not reading.measured
    np.testing.assert_allclose(reading.speed, [300.0, 200.0, 400.0, 100.0])


@pytest.mark.parametrize(
    "sample",
    [
        RotorSpeeds(1.0, 1.1, 0, (10.0, 20.0, float("nan"), 40.0)),
        RotorSpeeds(1.0, 1.1, 0, (10.0, 0.0, 30.0, 40.0)),
        RotorSpeeds(1.0, 1.1, 0, (10.0, 20.0, 30.0)),
        MotorOutputs(1.0, 1.1, "SERVO_OUTPUT_RAW", (900.0, 900.0, 900.0, 900.0)),
        MotorOutputs(1.0, 1.1, "SERVO_OUTPUT_RAW", (1100.0, 1200.0)),
        MotorOutputs(1.0, 1.1, "ACTUATOR_OUTPUT_STATUS", (0.1, 0.2, 0.3, 0.4)),
    ],
)
def test_what_is_no_reading_of_all_rotors_is_none(sample: RotorSpeeds | MotorOutputs) -> None:
    assert reader().read(sample) is None
