import math

import numpy as np
import pytest

from dynamics import quaternion
from sitl_mock.vehicle.position_control import TILT_MAX, PositionControl
from sitl_mock.vehicle.vehicle_interface import ControlSetpoint, MotionState, Tuning

DT = 0.008


def at(position: list[float], velocity: list[float] | None = None, yaw: float = 0.0) -> MotionState:
    velocity = velocity or [0.0, 0.0, 0.0]
    attitude = quaternion.from_euler(0, 0, yaw)
    return MotionState(0.0, np.array(position, float), np.array(velocity, float), attitude, np.zeros(3))


@pytest.fixture
def control() -> PositionControl:
    return PositionControl(np.zeros(3), Tuning())


def thrust_direction(attitude: list[float]) -> np.ndarray:
    return np.asarray(quaternion.rotate(np.array(attitude), np.array([0.0, 0.0, 1.0])))


def hold(position: list[float], **rest: float) -> ControlSetpoint:
    return ControlSetpoint("hold", position_world=np.array(position, float), **rest)  # type: ignore[arg-type]


def test_at_the_target_it_hovers_level(control: PositionControl) -> None:
    demand = control.fly(hold([1, 2, 3]), at([1, 2, 3], yaw=0.4), DT)
    np.testing.assert_allclose(demand.attitude, quaternion.from_euler(0, 0, 0.4), atol=1e-12)
    assert demand.thrust == pytest.approx(0.5)


@pytest.mark.parametrize("yaw", [0.0, 2.0])
def test_it_leans_towards_the_target_whatever_its_heading(control: PositionControl, yaw: float) -> None:
    leaning = thrust_direction(control.fly(hold([4, -3, 3]), at([0, 0, 3], yaw=yaw), DT).attitude)
    np.testing.assert_allclose(leaning[:2] / np.hypot(*leaning[:2]), [0.8, -0.6], atol=1e-9)


def test_tilt_is_limited(control: PositionControl) -> None:
    leaning = thrust_direction(control.fly(hold([1000, 0, 3]), at([0, 0, 3], [-12, 0, 0]), DT).attitude)
    assert math.acos(leaning[2]) == pytest.approx(TILT_MAX)


def test_the_heading_of_the_setpoint_is_flown(control: PositionControl) -> None:
    demand = control.fly(hold([0, 0, 3], yaw=1.2), at([0, 0, 3]), DT)
    assert quaternion.to_euler(np.array(demand.attitude))[2] == pytest.approx(1.2)


def test_without_a_target_it_stays_where_it_was_when_the_mode_began(control: PositionControl) -> None:
    control.fly(ControlSetpoint("hold"), at([1, 1, 5]), DT)
    leaning = thrust_direction(control.fly(ControlSetpoint("hold"), at([3, 1, 5]), DT).attitude)
    assert leaning[0] < -0.05


def test_a_velocity_is_flown_without_a_position_setpoint(control: PositionControl) -> None:
    setpoint = ControlSetpoint("hold", velocity_world=np.array([0.0, 2.0, 0.0]))
    assert thrust_direction(control.fly(setpoint, at([0, 0, 3]), DT).attitude)[1] > 0.1
    control.leave()
    assert abs(thrust_direction(control.fly(setpoint, at([0, 9, 3], [0, 2, 0]), DT).attitude)[1]) < 0.01


def test_landing_sinks_fast_when_high_and_slowly_when_low(control: PositionControl) -> None:
    land = ControlSetpoint("land")
    assert control.fly(land, at([0, 0, 20], [0, 0, -1.5]), DT).thrust == pytest.approx(0.5, abs=1e-6)
    control.leave()
    assert control.fly(land, at([0, 0, 2], [0, 0, -0.7]), DT).thrust == pytest.approx(0.5, abs=1e-6)


def test_a_return_climbs_first_then_flies_home_then_sinks(control: PositionControl) -> None:
    back = ControlSetpoint("rtl")
    climbing = control.fly(back, at([20, 0, 3]), DT)
    assert climbing.climbs
    assert thrust_direction(climbing.attitude)[2] == pytest.approx(1.0)
    homing = control.fly(back, at([20, 0, 30]), DT)
    assert thrust_direction(homing.attitude)[0] < -0.1
    sinking = control.fly(back, at([0.2, 0, 30]), DT)
    assert sinking.thrust < 0.5


def test_an_acceleration_alone_is_followed_whatever_the_speed(control: PositionControl) -> None:
    push = ControlSetpoint("hold", acceleration_world=np.array([1.0, -2.0, 0.5]))
    demand = control.fly(push, at([5, 5, 5], [3, 3, -1]), DT)
    leaning = thrust_direction(demand.attitude)
    np.testing.assert_allclose(leaning[:2] / leaning[2], np.array([1.0, -2.0]) / 9.81, rtol=2e-3)
    assert demand.thrust * leaning[2] == pytest.approx(0.5 * (1 + 0.5 / 9.81), rel=1e-3)


def test_after_an_acceleration_it_holds_where_it_then_is(control: PositionControl) -> None:
    control.fly(hold([0, 0, 3]), at([0, 0, 3]), DT)
    control.fly(ControlSetpoint("hold", acceleration_world=np.ones(3)), at([9, 0, 3]), DT)
    stay = ControlSetpoint("hold", velocity_world=np.array([np.nan, np.nan, 0.0]))
    leaning = thrust_direction(control.fly(stay, at([9, 0, 3]), DT).attitude)
    np.testing.assert_allclose(leaning, [0, 0, 1], atol=0.02)
