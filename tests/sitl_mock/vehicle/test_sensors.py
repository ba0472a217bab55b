import casadi as ca
import numpy as np
import pytest

from sitl_mock.vehicle.layout import Layout
from sitl_mock.vehicle.sensors import SensorErrors, next_estimate_error, quantised


def test_perfect_sensors_keep_only_their_delay() -> None:
    perfect = SensorErrors(delay=0.02).without_noise()
    assert perfect.delay == 0.02
    constants = perfect.constants(np.random.default_rng(0))
    noises = [value for name, value in constants.items() if name != "estimate_time"]
    np.testing.assert_array_equal(np.concatenate(noises), 0)


def test_the_biases_of_a_flight_come_from_its_seed() -> None:
    first, again, other = (SensorErrors().constants(np.random.default_rng(seed))["gyro_bias"] for seed in (1, 1, 2))
    np.testing.assert_array_equal(first, again)
    assert not np.array_equal(first, other)


def test_an_error_in_velocity_drags_the_position_along() -> None:
    constants = {"estimate_time": ca.DM([1e9] * 9), "estimate_noise": ca.DM([0.0] * 9)}
    error = ca.DM([0.0, 0, 0, 0.1, 0, 0, 0, 0, 0])
    for _ in range(100):
        error = next_estimate_error(error, ca.DM.zeros(9), constants, 0.001)
    assert float(error[0]) == pytest.approx(0.01, rel=0.01)


def test_the_estimates_error_keeps_its_spread() -> None:
    constants = {"estimate_time": ca.DM([0.01] * 9), "estimate_noise": ca.DM([0.0] * 3 + [0.5] * 6)}
    random, error, errors = np.random.default_rng(3), ca.DM.zeros(9), []
    for _ in range(3000):
        error = next_estimate_error(error, ca.DM(random.standard_normal(9)), constants, 0.001)
        errors.append(np.array(error).ravel()[3:])
    assert np.std(errors) == pytest.approx(0.5, rel=0.1)


def test_a_resolution_of_zero_changes_nothing() -> None:
    values = np.array([0.3, 1.26])
    np.testing.assert_array_equal(quantised(values, 0.0), values)
    np.testing.assert_allclose(quantised(values, 0.25), [0.25, 1.25])


def test_a_layout_fills_and_finds_its_parts() -> None:
    layout = Layout({"a": 2, "b": 4})
    vector = layout.fill({"b": [[1, 2], [3, 4]]})
    np.testing.assert_array_equal(vector, [0, 0, 1, 3, 2, 4])  # by column, as CasADi stores matrices
    views = layout.views(vector)
    views["a"][:] = 7
    np.testing.assert_array_equal(vector[:2], 7)
