import casadi as ca
import numpy as np
import pytest

from dynamics import quaternion
from dynamics.arrays import Floats
from dynamics.errors import RequestError
from dynamics.vehicle import GRAVITY, Vehicle
from sitl_mock.vehicle import ground
from sitl_mock.vehicle.ground import Ground
from sitl_mock.vehicle.sensors import SensorErrors
from sitl_mock.vehicle.vehicle import SimulatedVehicle, VehicleOptions
from sitl_mock.vehicle.vehicle_interface import ControlSetpoint


def contact(
    vehicle: Vehicle,
    *,
    height: float,
    velocity: tuple[float, float, float] = (0, 0, 0),
    roll: float = 0.0,
    rights: int = 1,
) -> list[Floats]:
    x = np.concatenate([[0, 0, height], velocity, quaternion.from_euler(roll, 0, 0), np.zeros(3)])
    ratio = vehicle.body.mass / np.array(vehicle.body.inertia)
    surface = {
        "ground_point": ca.DM.zeros(3), "ground_normal": ca.DM([0, 0, 1]), "ground_velocity": ca.DM.zeros(3),
        "ground_rights": ca.DM(rights), "leg_height": ca.DM(ground.leg_height(vehicle)),
    }  # fmt: skip
    acceleration = ground.contact_acceleration(ca.DM(x), ca.DM(ground.contact_points(vehicle)), ca.DM(ratio), surface)
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


def test_the_ground_of_sih_carries_the_weight_and_rights_nothing(arpl_250g: Vehicle) -> None:
    height = ground.leg_height(arpl_250g) - ground.SINKAGE
    linear, angular = contact(arpl_250g, height=height, velocity=(0.1, 0.0, 0.0), roll=0.5, rights=0)
    assert linear[2] == pytest.approx(GRAVITY)
    assert linear[0] == pytest.approx(-0.1 * ground.STICKING_RATE)
    np.testing.assert_array_equal(angular, 0)


def on(surface: Ground, vehicle: Vehicle) -> SimulatedVehicle:
    options = VehicleOptions(sensors=SensorErrors().without_noise(), rotor_noise=0.0, ground=surface)
    return SimulatedVehicle(vehicle, options=options)


def tilt_of(vehicle: SimulatedVehicle) -> float:
    return float(np.arccos(quaternion.rotate(vehicle.truth.attitude, np.array([0.0, 0.0, 1.0]))[2]))


@pytest.mark.parametrize("kind", ["legs", "sih"])
def test_it_stands_on_a_slope_and_takes_off_from_it(arpl_250g: Vehicle, kind: ground.GroundKind) -> None:
    vehicle = on(Ground(kind, slope=np.radians(15.0), uphill=1.0), arpl_250g)
    assert tilt_of(vehicle) == pytest.approx(np.radians(15.0))
    start = vehicle.truth.position_world
    vehicle.advance(ControlSetpoint("idle"), False, 2.0)
    assert np.linalg.norm(vehicle.truth.position_world - start) < 0.03  # friction grows with speed: it creeps
    assert tilt_of(vehicle) == pytest.approx(np.radians(15.0), abs=0.01)
    vehicle.advance(ControlSetpoint("hold", position_world=np.array([0.0, 0.0, 1.0])), True, 5.0)
    assert vehicle.truth.position_world[2] == pytest.approx(1.0, abs=0.1)


@pytest.mark.parametrize("kind", ["legs", "sih"])
def test_a_deck_takes_along_what_stands_on_it(arpl_250g: Vehicle, kind: ground.GroundKind) -> None:
    surface = Ground(kind, speed=(1.0, -0.5), heave=0.3, heave_period=4.0)
    vehicle = on(surface, arpl_250g)
    start = vehicle.truth.position_world
    vehicle.advance(ControlSetpoint("idle"), False, 2.0)  # half a period: at the top
    np.testing.assert_allclose(vehicle.truth.position_world - start, [2.0, -1.0, 0.6], atol=0.01)
    np.testing.assert_allclose(vehicle.truth.velocity_world, surface.velocity(2.0), atol=0.02)


def test_on_the_ground_of_sih_a_tilted_vehicle_stays_tilted(arpl_250g: Vehicle) -> None:
    tilts = {}
    for kind in ("legs", "sih"):
        vehicle = on(Ground(kind), arpl_250g)
        vehicle.advance(ControlSetpoint("hold", position_world=np.array([0.0, 0.0, 0.5])), True, 3.0)
        leaning = quaternion.from_euler(0.4, 0.0, 0.0)
        vehicle.advance(ControlSetpoint("attitude", attitude=leaning, thrust=0.2), True, 1.0)
        vehicle.advance(ControlSetpoint("idle"), False, 2.0)
        tilts[kind] = tilt_of(vehicle)
    assert tilts["legs"] < 0.05
    assert tilts["sih"] > 0.2


@pytest.mark.parametrize("fields", [{"slope": 1.5}, {"heave": 3.0}, {"heave_period": 0.1}, {"speed": (30.0, 0.0)}])
def test_ground_that_is_not_possible_is_refused(fields: dict[str, float]) -> None:
    with pytest.raises(RequestError, match="wanted"):
        Ground(**fields)  # type: ignore[arg-type]
