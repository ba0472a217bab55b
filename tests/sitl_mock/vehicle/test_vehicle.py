import dataclasses
from collections.abc import Callable

import numpy as np
import pytest

from dynamics import quaternion
from dynamics.vehicle import GRAVITY, Body, EffectUse, Rotors, Vehicle
from dynamics.vehicle_file import read_vehicle
from sitl_mock.vehicle.sensors import SensorErrors
from sitl_mock.vehicle.vehicle import SimulatedVehicle, VehicleOptions
from sitl_mock.vehicle.vehicle_interface import ControlSetpoint
from tests.support.flights import QUIET, hover_at, milliseconds_to, response, take_off
from vehicles import FOLDER

IDLE = ControlSetpoint("idle")


@pytest.fixture(scope="module", params=["px4_sih", "arpl_250g"])
def vehicle(request: pytest.FixtureRequest) -> Vehicle:
    return read_vehicle(FOLDER / f"{request.param}.toml")


@pytest.fixture(scope="module")
def sih() -> Vehicle:
    return read_vehicle(FOLDER / "px4_sih.toml")


@pytest.fixture
def small(arpl_250g: Vehicle) -> SimulatedVehicle:
    return SimulatedVehicle(arpl_250g, options=QUIET)


def rates(x: float, y: float, z: float, thrust: float) -> ControlSetpoint:
    return ControlSetpoint("rates", rate_body=np.array([x, y, z]), thrust=thrust)


# equilibria


def test_disarmed_it_rests_level_where_it_stands(vehicle: Vehicle) -> None:
    mock = SimulatedVehicle(vehicle, options=dataclasses.replace(QUIET, position=(2.0, -1.0), yaw=0.7))
    start = mock.truth
    mock.advance(IDLE, False, 3.0)
    np.testing.assert_allclose(mock.truth.position_world, start.position_world, atol=1e-6)
    np.testing.assert_allclose(quaternion.to_euler(mock.truth.attitude), [0, 0, 0.7], atol=1e-6)
    assert mock.on_ground
    assert mock.ground_force == pytest.approx(1.0, abs=1e-6)
    np.testing.assert_allclose(mock.imu.specific_force_body, [0, 0, GRAVITY], atol=1e-5)
    np.testing.assert_allclose(mock.rotor_speed, 0)


def test_it_hovers_at_the_setpoint(vehicle: Vehicle) -> None:
    mock = SimulatedVehicle(vehicle, options=QUIET)
    take_off(mock, duration=12.0)
    np.testing.assert_allclose(mock.truth.position_world, [0, 0, 3], atol=0.03)
    np.testing.assert_allclose(mock.truth.velocity_world, 0, atol=0.02)
    np.testing.assert_allclose(mock.true_rotor_speed, vehicle.hover_speed, rtol=1e-3)
    assert not mock.on_ground


def test_without_thrust_it_falls_freely(small: SimulatedVehicle) -> None:
    take_off(small, height=6.0, duration=8.0)
    small.advance(rates(0, 0, 0, 0.0), True, 0.3)  # rotors run down
    before = small.truth
    small.advance(rates(0, 0, 0, 0.0), True, 0.2)
    fallen = small.truth.velocity_world[2] - before.velocity_world[2]
    assert fallen == pytest.approx(-GRAVITY * 0.2, rel=1e-3)
    np.testing.assert_allclose(small.imu.specific_force_body, 0, atol=0.01)


# responses


def test_attitude_steps_as_measured_on_px4(sih: Vehicle) -> None:
    mock = SimulatedVehicle(sih, options=QUIET)
    take_off(mock, duration=8.0)
    setpoint = ControlSetpoint("attitude", attitude=quaternion.from_euler(0.15, 0, 0), thrust=mock.tuning.hover_thrust)
    roll = response(mock, setpoint, 1.2, lambda v: float(quaternion.to_euler(v.estimate.attitude)[0])) / 0.15
    on_the_link = 10  # ms: setpoints wait for PX4's 4 ms cycle, estimates for the next message of a 100 Hz stream
    assert 84 <= milliseconds_to(0.10, roll) + on_the_link <= 132
    assert 264 <= milliseconds_to(0.63, roll) + on_the_link <= 284
    assert 396 <= milliseconds_to(0.90, roll) + on_the_link <= 448
    assert roll.max() < 1.01


@pytest.mark.parametrize("axis", [0, 1])
def test_rates_follow_as_fast_as_the_motors_allow(vehicle: Vehicle, axis: int) -> None:
    mock = SimulatedVehicle(vehicle, options=QUIET)
    take_off(mock)
    setpoint = ControlSetpoint("rates", rate_body=np.eye(3)[axis], thrust=mock.tuning.hover_thrust)
    rate = response(mock, setpoint, 0.4, lambda v: float(v.truth.rate_body[axis]))
    lag = 0.05 if vehicle.name == "px4_sih" else 0.02
    assert milliseconds_to(0.63, rate) <= 2200 * lag
    assert rate.max() < 1.25
    assert rate[-1] == pytest.approx(1.0, abs=0.15)


def test_rate_setpoints_are_not_limited_by_the_attitude_loops_limit(small: SimulatedVehicle) -> None:
    take_off(small, height=20.0, duration=12.0)
    small.advance(rates(8.0, 0, 0, small.tuning.hover_thrust), True, 0.3)
    assert small.truth.rate_body[0] > 6.0 > small.tuning.rate_limit[0]


def test_attitude_setpoints_are_limited_by_the_rate_limit(small: SimulatedVehicle) -> None:
    take_off(small, height=20.0, duration=12.0)
    setpoint = ControlSetpoint("attitude", attitude=quaternion.from_euler(2.0, 0, 0), thrust=small.tuning.hover_thrust)
    rate = response(small, setpoint, 0.5, lambda v: float(v.truth.rate_body[0]))
    assert 0.9 * small.tuning.rate_limit[0] < rate.max() < 1.25 * small.tuning.rate_limit[0]


def test_yaw_rate_is_fed_forward_beside_an_attitude(small: SimulatedVehicle) -> None:
    take_off(small)
    yaw = 0.0
    for _ in range(100):
        yaw += 0.01
        setpoint = ControlSetpoint(
            "attitude",
            attitude=quaternion.from_euler(0, 0, yaw),
            rate_body=np.array([0.0, 0.0, 1.0]),
            thrust=small.tuning.hover_thrust,
        )
        small.advance(setpoint, True, 0.01)
    assert quaternion.to_euler(small.truth.attitude)[2] == pytest.approx(yaw, abs=0.05)


def test_an_axis_without_a_rate_is_left_alone(small: SimulatedVehicle) -> None:
    take_off(small)
    small.advance(rates(0.0, 0.0, 1.0, small.tuning.hover_thrust), True, 0.5)
    small.advance(rates(0.0, 0.0, float("nan"), small.tuning.hover_thrust), True, 0.3)
    assert small.truth.rate_body[2] > 0.5
    assert abs(small.truth.rate_body[0]) < 0.05


def test_a_setpoint_of_nan_never_reaches_the_plant(small: SimulatedVehicle) -> None:
    take_off(small)
    nothing = float("nan")
    small.advance(ControlSetpoint("attitude", attitude=np.full(4, nothing), thrust=nothing), True, 0.2)
    small.advance(ControlSetpoint("attitude", attitude=np.zeros(4), thrust=0.5), True, 0.2)
    small.advance(rates(nothing, nothing, nothing, float("inf")), True, 0.2)
    assert np.isfinite(small.truth.attitude).all()
    assert np.isfinite(small.motor_signal).all()
    take_off(small, duration=8.0)
    np.testing.assert_allclose(small.truth.position_world, [0, 0, 3], atol=0.1)


def test_saturated_motors_keep_roll_and_pitch(small: SimulatedVehicle) -> None:
    take_off(small, height=20.0, duration=12.0)
    small.advance(rates(3.0, 0.0, 6.0, 1.3), True, 0.15)  # more thrust and yaw than there is
    assert small.truth.rate_body[0] == pytest.approx(3.0, abs=0.8)
    assert abs(small.truth.rate_body[1]) < 0.3
    assert small.motor_signal.max() <= 1.0


def test_wrong_gains_are_used_at_once(small: SimulatedVehicle) -> None:
    take_off(small)
    small.tune(dataclasses.replace(small.tuning, rate_gain_p=(0.0, 0.0, 0.0), rate_gain_i=(0.0, 0.0, 0.0)))
    small.advance(rates(2.0, 0, 0, small.tuning.hover_thrust), True, 0.2)
    assert abs(small.truth.rate_body[0]) < 0.1


# time and randomness


def flown(vehicle: Vehicle, seed: int, chunks: list[float]) -> np.ndarray:
    mock = SimulatedVehicle(vehicle, seed=seed)
    setpoint = rates(0.3, -0.2, 0.1, 0.6)
    for chunk in chunks:
        mock.advance(setpoint, True, chunk)
    estimate, imu = mock.estimate, mock.imu
    return np.concatenate(
        [mock.plant_state, estimate.position_world, estimate.attitude, imu.specific_force_body, mock.rotor_speed]
    )


def test_one_seed_gives_one_flight_however_time_is_cut(arpl_250g: Vehicle) -> None:
    first = flown(arpl_250g, 3, [0.7])
    assert np.array_equal(first, flown(arpl_250g, 3, [0.004] * 175))
    assert np.array_equal(first, flown(arpl_250g, 3, [0.0005] * 1400))
    assert np.array_equal(first, flown(arpl_250g, 3, [0.123, 0.377, 0.2]))


def test_another_seed_gives_another_flight(arpl_250g: Vehicle) -> None:
    assert not np.allclose(flown(arpl_250g, 3, [0.7]), flown(arpl_250g, 4, [0.7]), atol=1e-4)


def test_time_counts_every_part_of_a_millisecond(small: SimulatedVehicle) -> None:
    for _ in range(3000):
        small.advance(IDLE, False, 1 / 3000)
    assert small.time == pytest.approx(1.0, abs=1e-9)


# sensors


def test_the_age_of_the_estimate_is_that_of_its_time(small: SimulatedVehicle) -> None:
    take_off(small)
    turning = rates(1.0, 0.0, 0.0, small.tuning.hover_thrust)
    small.advance(turning, True, 0.1)
    then = small.truth
    small.advance(turning, True, 0.010)
    assert small.estimate.time == pytest.approx(then.time)
    np.testing.assert_allclose(small.estimate.position_world, then.position_world, atol=1e-12)
    np.testing.assert_allclose(small.estimate.attitude, then.attitude, atol=1e-9)
    assert not np.allclose(small.estimate.attitude, small.truth.attitude, atol=1e-3)


def test_the_estimates_errors_have_their_size_and_wander(arpl_250g: Vehicle) -> None:
    mock = SimulatedVehicle(arpl_250g, options=VehicleOptions(sensors=SensorErrors(delay=0.0)), seed=1)
    errors = []
    for _ in range(3000):
        mock.advance(IDLE, False, 0.01)
        truth, estimate = mock.truth, mock.estimate
        errors.append(
            np.concatenate(
                [estimate.position_world - truth.position_world, estimate.velocity_world - truth.velocity_world]
            )
        )
    position, velocity = np.array(errors)[:, :3], np.array(errors)[:, 3:]
    assert 0.002 < position.std() < 0.008
    assert 0.005 < velocity.std() < 0.02
    assert np.diff(position, axis=0).std() < 0.3 * position.std()  # no jumps from sample to sample


def test_the_gyro_has_noise_and_bias(arpl_250g: Vehicle) -> None:
    sensors = SensorErrors(gyro=0.02, gyro_bias=0.05, imu_average=0.001)
    mock = SimulatedVehicle(arpl_250g, options=VehicleOptions(sensors=sensors), seed=2)
    samples = []
    for _ in range(500):
        mock.advance(IDLE, False, 0.001)
        samples.append(mock.imu.rate_body)
    assert np.std(samples, axis=0) == pytest.approx(0.02, rel=0.2)
    assert np.abs(np.mean(samples, axis=0)).max() > 0.01


def test_the_measured_rotor_speed_has_a_resolution_and_may_be_wrong(arpl_250g: Vehicle) -> None:
    sensors = dataclasses.replace(SensorErrors().without_noise(), rotor_speed_step=25.0)
    options = VehicleOptions(sensors=sensors, rotor_noise=0.0, rotor_speed_fault=((2, 0.5),))
    mock = SimulatedVehicle(arpl_250g, options=options)
    take_off(mock)
    np.testing.assert_allclose(mock.rotor_speed % 25.0, 0)
    np.testing.assert_allclose(mock.rotor_speed / mock.true_rotor_speed, [1, 1, 0.5, 1], atol=0.02)


# battery


def test_the_battery_empties_and_sags(arpl_250g: Vehicle) -> None:
    mock = SimulatedVehicle(arpl_250g, options=QUIET)
    full = mock.battery
    take_off(mock, duration=20.0)
    assert mock.battery.voltage < full.voltage - 0.2
    assert mock.battery.remaining == pytest.approx(1 - 20 / 900, abs=0.01)
    assert mock.battery.current > 1.0


def test_a_sagging_battery_lowers_the_thrust(arpl_250g: Vehicle) -> None:
    lift = []
    for gain in (0.0, 1.0):
        mock = SimulatedVehicle(arpl_250g, effects=[EffectUse("battery_sag", {"gain": gain})], options=QUIET)
        mock.advance(rates(0, 0, 0, 0.8), True, 1.0)
        lift.append(mock.imu.specific_force_body[2])
        voltage = mock.battery.voltage
    ratio = voltage / (3 * 4.2)
    assert lift[1] / lift[0] == pytest.approx(ratio**2, rel=0.01)
    assert ratio < 0.98


# ground


def test_it_lands_and_notices(vehicle: Vehicle) -> None:
    mock = SimulatedVehicle(vehicle)
    take_off(mock, height=1.5, duration=6.0)
    for _ in range(800):
        mock.advance(ControlSetpoint("land"), True, 0.01)
        if mock.on_ground:
            break
    assert mock.on_ground
    assert mock.ground_force == pytest.approx(1.0, abs=0.05)
    assert quaternion.angle_between(mock.truth.attitude, np.array([1.0, 0, 0, 0])) < 0.05
    np.testing.assert_allclose(mock.motor_signal, 0, atol=1e-3)


def test_it_returns_home_and_lands_there(arpl_250g: Vehicle) -> None:
    mock = SimulatedVehicle(arpl_250g, options=QUIET)
    mock.tune(dataclasses.replace(mock.tuning, return_altitude=5.0))
    take_off(mock)
    mock.advance(hover_at(8.0, -5.0, 2.0), True, 8.0)
    assert np.hypot(*mock.truth.position_world[:2]) > 8.0
    highest = 0.0
    for _ in range(300):
        mock.advance(ControlSetpoint("rtl"), True, 0.1)
        highest = max(highest, mock.truth.position_world[2])
    assert highest == pytest.approx(5.0, abs=0.4)
    assert mock.on_ground
    assert np.hypot(*mock.truth.position_world[:2]) < 0.5


def test_a_crash_ends_on_the_ground_and_stays_finite(arpl_250g: Vehicle) -> None:
    mock = SimulatedVehicle(arpl_250g, options=QUIET)
    take_off(mock, height=8.0, duration=8.0)
    mock.advance(rates(6.0, 3.0, 0.0, 0.4), True, 0.4)  # tumbling
    mock.advance(IDLE, False, 8.0)
    assert np.isfinite(mock.plant_state).all()
    assert 0.0 < mock.truth.position_world[2] < 0.3
    assert np.linalg.norm(mock.truth.velocity_world) < 0.02
    assert np.linalg.norm(mock.truth.rate_body) < 0.05


def test_armed_on_the_ground_in_hold_it_stays_there(small: SimulatedVehicle) -> None:
    small.advance(ControlSetpoint("hold"), True, 3.0)
    assert small.on_ground
    np.testing.assert_allclose(small.motor_signal, 0, atol=1e-9)


# vehicles of other sizes


def crazyflie() -> Vehicle:
    square = ((0.03, 0.03, 0.0), (-0.03, 0.03, 0.0), (-0.03, -0.03, 0.0), (0.03, -0.03, 0.0))
    rotors = Rotors(square, (1, -1, 1, -1), 3.2e-8, 8e-10, 2400.0, thrust_curve=0.6)
    lag = EffectUse("motor_lag", {"time_constant": 0.04})
    return Vehicle("crazyflie", Body(0.03, (1.6e-5, 1.6e-5, 2.9e-5)), rotors, effects=(lag,))


def hexacopter() -> Vehicle:
    angles = np.radians(np.arange(30, 390, 60))
    ring = tuple((0.3 * float(np.cos(a)), 0.3 * float(np.sin(a)), 0.02) for a in angles)
    rotors = Rotors(ring, (1, -1, 1, -1, 1, -1), 1e-5, 2e-7, 800.0)
    return Vehicle("hexacopter", Body(2.0, (0.04, 0.04, 0.07), (0.01, 0.0, -0.02)), rotors)


@pytest.mark.parametrize("build", [crazyflie, hexacopter])
def test_vehicles_of_other_sizes_fly_untouched(build: Callable[[], Vehicle]) -> None:
    mock = SimulatedVehicle(build(), options=QUIET)
    take_off(mock, duration=12.0)
    np.testing.assert_allclose(mock.truth.position_world, [0, 0, 3], atol=0.05)
    assert np.linalg.norm(mock.truth.rate_body) < 0.02


def test_faults_of_sensors_show_in_the_measurements(arpl_250g):
    faults = (
        EffectUse("imu_bias", {"x": 0.5, "y": 0.0, "z": 0.0}),
        EffectUse("gyro_bias", {"x": 0.0, "y": 0.0, "z": 0.1}),
        EffectUse("time_delay", {"delay": 0.05}),
        EffectUse("rotor_speed_fault", {"gain": 0.5}, 2),
    )
    vehicle = SimulatedVehicle(arpl_250g, effects=faults, options=QUIET)
    take_off(vehicle, duration=1.0)  # it still climbs
    before = vehicle.truth
    vehicle.advance(hover_at(0.0, 0.0, 3.0), True, 0.06)
    assert vehicle.estimate.time == pytest.approx(vehicle.time - QUIET.sensors.delay)
    np.testing.assert_allclose(vehicle.estimate.position_world, before.position_world, atol=1e-9)
    take_off(vehicle)
    assert vehicle.imu.specific_force_body[0] == pytest.approx(0.5, abs=0.05)
    assert vehicle.imu.rate_body[2] == pytest.approx(vehicle.truth.rate_body[2] + 0.1, abs=0.01)
    np.testing.assert_allclose(vehicle.rotor_speed / vehicle.true_rotor_speed, [1, 1, 0.5, 1], rtol=1e-6)


def test_sensors_off_the_centre_of_mass_and_a_late_attitude_show_in_the_measurements(arpl_250g):
    arm, turn = {"x": 0.3, "y": 0.0, "z": 0.0}, {"x": 0.0, "y": 0.0, "z": 0.1}
    faults = (
        EffectUse("imu_lever_arm", arm),
        EffectUse("pose_lever_arm", arm),
        EffectUse("imu_misalignment", turn),
        EffectUse("attitude_delay", {"delay": 0.05}),
    )
    vehicle = SimulatedVehicle(arpl_250g, effects=faults, options=QUIET)
    take_off(vehicle)
    spin = ControlSetpoint("rates", rate_body=np.array([0.0, 0.0, 1.5]), thrust=0.5)
    vehicle.advance(spin, True, 0.5)
    before = vehicle.truth
    vehicle.advance(spin, True, 0.05)
    truth, estimate = vehicle.truth, vehicle.estimate
    forward = quaternion.rotate(truth.attitude, np.array([0.3, 0.0, 0.0]))
    delay = QUIET.sensors.delay
    np.testing.assert_allclose(estimate.position_world, truth.position_world + forward, atol=0.02)
    assert quaternion.angle_between(estimate.attitude, before.attitude) < 1.6 * (delay + 0.002)
    centripetal = -(truth.rate_body[2] ** 2) * 0.3
    inwards = centripetal * np.cos(0.1)  # along the accelerometer's own x
    assert vehicle.imu.specific_force_body[0] == pytest.approx(inwards, abs=0.1)
    assert abs(centripetal) > 0.3


def test_late_rotor_speeds_are_those_of_before(arpl_250g: Vehicle) -> None:
    mock = SimulatedVehicle(arpl_250g, effects=(EffectUse("rotor_delay", {"delay": 0.01}),), options=QUIET)
    mock.advance(IDLE, True, 1.0)
    mock.advance(rates(3.0, 0.0, 0.0, 0.4), True, 0.02)
    before = mock.true_rotor_speed
    mock.advance(rates(3.0, 0.0, 0.0, 0.4), True, 0.01)
    assert np.abs(mock.true_rotor_speed - before).max() > 10.0
    np.testing.assert_allclose(mock.rotor_speed, before, rtol=1e-6)
    np.testing.assert_allclose(mock.mean_rotor_speed(0.001), before, rtol=1e-3)


def test_a_mean_rotor_speed_is_that_of_the_last_milliseconds_with_the_sensors_fault(arpl_250g: Vehicle) -> None:
    options = dataclasses.replace(QUIET, rotor_speed_fault=((1, 0.5),))
    mock = SimulatedVehicle(arpl_250g, options=options)
    mock.advance(IDLE, True, 1.0)
    speeds = []
    for _ in range(10):
        mock.advance(rates(3.0, 0.0, 0.0, 0.4), True, 0.001)
        speeds.append(mock.true_rotor_speed)
    mean = np.mean(speeds, axis=0)
    assert np.ptp([s[0] for s in speeds]) > 10.0
    np.testing.assert_allclose(mock.mean_rotor_speed(0.01), mean * [1.0, 0.5, 1.0, 1.0], rtol=1e-6)


def test_a_blow_adds_to_the_body_rates_and_to_nothing_else(arpl_250g: Vehicle) -> None:
    mock = SimulatedVehicle(arpl_250g, options=QUIET)
    before = mock.truth
    mock.knock(np.array([5.0, -3.0, 1.0]))
    mock.advance(IDLE, False, 0.001)
    np.testing.assert_allclose(mock.truth.position_world, before.position_world, atol=0.01)
    assert np.abs(mock.truth.rate_body - [5.0, -3.0, 1.0]).max() < 1.0
