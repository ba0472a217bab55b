import casadi as ca
import numpy as np
import pytest

from dynamics import quaternion
from sitl_mock.vehicle.inner_loop import butterworth, low_pass, next_integral, rate_setpoint

GAIN = [4.0, 4.0, 2.8]


def rates(attitude: np.ndarray, setpoint: np.ndarray, yaw_rate: float = 0.0, weight: float = 0.4) -> np.ndarray:
    rates = rate_setpoint(
        ca.SX(ca.DM(attitude)), ca.SX(ca.DM(setpoint)), yaw_rate, gain=ca.SX(ca.DM(GAIN)), yaw_weight=ca.SX(weight)
    )
    return np.array(ca.evalf(rates)).ravel()


def test_at_the_setpoint_no_rate_is_commanded() -> None:
    attitude = quaternion.from_euler(0.3, -0.2, 1.0)
    np.testing.assert_allclose(rates(attitude, attitude), 0, atol=1e-5)


def test_small_errors_give_rates_by_the_gains() -> None:
    level = quaternion.IDENTITY
    np.testing.assert_allclose(rates(level, quaternion.from_euler(0.001, -0.002, 0)), [0.004, -0.008, 0], atol=1e-5)
    np.testing.assert_allclose(rates(level, quaternion.from_euler(0, 0, 0.05)), [0, 0, 0.14], atol=2e-4)


def test_both_signs_of_a_setpoint_mean_the_same() -> None:
    attitude, setpoint = quaternion.from_euler(0.1, 0.4, -2.0), quaternion.from_euler(-0.3, 0.2, 1.5)
    np.testing.assert_allclose(rates(attitude, setpoint), rates(attitude, -setpoint), atol=1e-12)
    np.testing.assert_allclose(rates(attitude, setpoint), rates(-attitude, setpoint), atol=1e-12)


def test_tilt_is_corrected_before_yaw() -> None:
    setpoint = quaternion.from_euler(0.5, 0.0, 2.5)
    thrust_axis = quaternion.rotate(setpoint, np.array([0.0, 0.0, 1.0]))
    shortest = np.cross([0.0, 0.0, 1.0], thrust_axis)
    straight, yawing = (
        rates(quaternion.IDENTITY, setpoint, weight=0.05),
        rates(quaternion.IDENTITY, setpoint, weight=1.0),
    )

    def detour(rate: np.ndarray) -> float:
        return float(abs(rate[0] * shortest[1] - rate[1] * shortest[0]) / np.hypot(*rate[:2]) / np.hypot(*shortest[:2]))

    assert detour(straight) < 0.1 < detour(yawing)


def test_upside_down_it_still_turns() -> None:
    rate = rates(quaternion.from_euler(np.pi, 0, 0), quaternion.IDENTITY)
    assert np.isfinite(rate).all()
    assert np.linalg.norm(rate) > 4.0


def test_yaw_rate_is_fed_forward_about_the_world() -> None:
    attitude = quaternion.from_euler(0.4, 0.0, 0.7)
    np.testing.assert_allclose(
        rates(attitude, attitude, yaw_rate=1.0), quaternion.rotate_inverse(attitude, np.array([0, 0, 1.0])), atol=1e-5
    )


def integrate(error: list[float], unallocated: list[float], start: float = 0.0) -> np.ndarray:
    gains = {"rate_gain_i": ca.DM([0.2, 0.2, 0.1]), "integral_limit": ca.DM([0.3, 0.3, 0.3])}
    return np.array(next_integral(ca.DM([start] * 3), ca.DM(error), ca.DM(unallocated), gains, 0.01)).ravel()


def test_the_integrator_integrates() -> None:
    fade = 1 - (0.5 / np.radians(400)) ** 2
    np.testing.assert_allclose(integrate([0.5, -0.5, 0.5], [0, 0, 0]), np.array([1, -1, 0.5]) * 1e-3 * fade)


def test_a_saturated_axis_is_not_wound_further_but_may_unwind() -> None:
    integral = integrate([0.5, -0.5, -0.5], [0.1, -0.1, 0.1])
    assert integral[0] == 0
    assert integral[1] == 0
    assert integral[2] < 0


def test_the_integrator_fades_out_at_large_errors_and_has_a_limit() -> None:
    assert integrate([7.5, 0, 0], [0, 0, 0])[0] == 0
    assert integrate([1.0, 0, 0], [0, 0, 0], start=0.2999)[0] == pytest.approx(0.3)


@pytest.mark.parametrize(("frequency", "expected"), [(4.0, 1.0), (40.0, np.sqrt(0.5)), (160.0, 1 / 16)])
def test_the_gyro_filter_is_a_second_order_butterworth(frequency: float, expected: float) -> None:
    memory, out = ca.DM.zeros(2), []
    for k in range(2000):
        value, memory = butterworth(ca.DM(np.sin(2 * np.pi * frequency * k * 1e-3)), memory, 40.0, 1e-3)
        out.append(float(value))
    assert np.max(np.abs(out[1000:])) == pytest.approx(expected, rel=0.15, abs=0.01)


def test_the_first_order_filter_has_its_time_constant() -> None:
    value, cutoff = ca.DM(0), ca.DM(5.0)
    for _ in range(round(1000 / (2 * np.pi * 5))):
        value = low_pass(ca.DM(1), value, cutoff, 1e-3)
    assert float(value) == pytest.approx(1 - np.exp(-1), abs=0.02)
    assert float(low_pass(ca.DM(1), ca.DM(0), ca.DM(0), 1e-3)) == 1.0
