import casadi as ca
import numpy as np
import pytest

from dynamics import quaternion
from dynamics.vehicle import GRAVITY, Vehicle
from sitl_mock.vehicle import ground


def contact(vehicle: Vehicle, *, height: float, velocity: tuple[float, float, float] = (0, 0, 0), roll: float = 0.0):
    x = np.concatenate([[0, 0, height], velocity, quaternion.from_euler(roll, 0, 0), np.zeros(3)])
    ratio = vehicle.body.mass / np.array(vehicle.body.inertia)
    acceleration = ground.contact_acceleration(ca.DM(x), ca.DM(ground.contact_points(vehicle)), ca.DM(ratio), 0.0)
    return [np.array(ca.evalf(part)).ravel() for part in acceleration]


def test_in_the_air_the_ground_does_nothing(arpl_250g: Vehicle) -> None:
    linear, angular = contact(arpl_250g, height=0.5)
    np.testing.assert_array_equal(linear, 0)
    np.testing.assert_array_equal(angular, 0)


def test_the_weight_is_carried_at_its_sinkage(arpl_250g: Vehicle) -> None:
    linear, angular = contact(arpl_250g, height=ground.leg_height(arpl_250g) - ground.SINKAGE)
    np.testing.assert_allclose(linear, [0, 0, GRAVITY], atol=1e-9)
    np.testing.assert_allclose(angular, 0, atol=1e-9)


def test_the_ground_never_pulls(arpl_250g: Vehicle) -> None:
    linear, _ = contact(arpl_250g, height=ground.leg_height(arpl_250g) - 0.001, velocity=(0, 0, 5.0))
    assert linear[2] == 0


def test_sliding_is_braked_by_friction_alone(arpl_250g: Vehicle) -> None:
    linear, _ = contact(arpl_250g, height=ground.leg_height(arpl_250g) - ground.SINKAGE, velocity=(3.0, -4.0, 0.0))
    np.testing.assert_allclose(linear[:2], ground.FRICTION * GRAVITY * np.array([-0.6, 0.8]), atol=1e-9)


@pytest.mark.parametrize("roll", [0.05, -0.05])
def test_a_leaning_vehicle_is_righted(arpl_250g: Vehicle, roll: float) -> None:
    _, angular = contact(arpl_250g, height=ground.leg_height(arpl_250g), roll=roll)
    assert np.sign(angular[0]) == -np.sign(roll)
