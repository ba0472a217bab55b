import dataclasses

import numpy as np
import pytest

from dynamics import quaternion
from dynamics.arrays import Floats
from dynamics.vehicle import Vehicle
from dynamics.vehicle_file import read_vehicle
from sitl_mock.mock import MockOptions, Surroundings, build_autopilot, usual_surroundings
from sitl_mock.vehicle.estimator import ERRORS, PX4_SENSORS, PX4_WANDER, Drift, Wander
from sitl_mock.vehicle.sensors import next_wander
from sitl_mock.vehicle.vehicle import SimulatedVehicle, VehicleOptions
from sitl_mock.vehicle.vehicle_interface import ControlSetpoint
from tests.support.flights import hover_at
from vehicles import FOLDER

IDLE = ControlSetpoint("idle")


@pytest.fixture(scope="module")
def px4_sih() -> Vehicle:
    return read_vehicle(FOLDER / "px4_sih.toml")


def errors_of(vehicle: SimulatedVehicle, duration: float, setpoint: ControlSetpoint | None = None) -> Floats:
    """(samples, 9) errors of position, velocity and rotation at 25 Hz."""
    rows = []
    for _ in range(round(duration / 0.04)):
        vehicle.advance(setpoint or IDLE, setpoint is not None, 0.04)
        estimate, truth = vehicle.estimate_now, vehicle.truth
        turned = quaternion.multiply(estimate.attitude, quaternion.conjugate(truth.attitude))
        rotation = 2 * turned[1:] * np.sign(turned[0])
        position = estimate.position_world - truth.position_world
        rows.append(np.concatenate([position, estimate.velocity_world - truth.velocity_world, rotation]))
    return np.array(rows)


def wandering(flights: int, duration: float, step: float = 0.004) -> Floats:
    """(samples, flights, 9) smooth errors of as many flights at 25 Hz."""
    random = np.random.default_rng(40)
    constants = PX4_WANDER.constants()
    error, rate = (PX4_WANDER.spread * random.standard_normal((flights, 9)) for _ in range(2))
    rate, rows = rate * PX4_WANDER.frequency, []
    for i in range(round(duration / step)):
        error, rate = next_wander(error, rate, random.standard_normal((flights, 9)), constants, step)
        if i % 10 == 0:
            rows.append(error)
    return np.array(rows)


def test_px4s_estimate_errs_as_it_was_measured() -> None:
    centred = wandering(40, 45.0)
    centred = centred - centred.mean(axis=0)
    spread = np.median(centred.std(axis=0), axis=0)
    inertial = np.array([0.15, 0.10])  # m, m/s, vertically, that the filter integrates of the accelerometer's noise
    spread[[2, 5]] = np.hypot(spread[[2, 5]], inertial)
    measured = [0.11, 0.15, 0.24, 0.18, 0.23, 0.14, *np.radians([0.75, 0.63, 0.59])]
    np.testing.assert_allclose(spread, measured, rtol=0.15)
    correlation = {}
    for seconds in (0.3, 1.0, 3.0, 10.0):
        n = round(seconds / 0.04)
        correlation[seconds] = np.sum(centred[:-n] * centred[n:], axis=(0, 1)) / np.sum(centred[n:] ** 2, axis=(0, 1))
    np.testing.assert_allclose(correlation[0.3], 0.98, atol=0.02)
    np.testing.assert_allclose(correlation[1.0][:8], [0.87] * 2 + [0.93] + [0.80] * 5, atol=0.09)
    np.testing.assert_allclose(correlation[3.0], [0.39, 0.39, 0.61] + [0.28] * 6, atol=0.25)
    assert np.all(correlation[10.0] < 0.0)


def test_px4s_height_is_wrong_at_the_start_and_by_the_seed(px4_sih: Vehicle) -> None:
    options = VehicleOptions(sensors=PX4_SENSORS, wander=PX4_WANDER)
    heights = [
        Drift(options.wander, np.random.default_rng(seed)).offset[2] for seed in range(300)
    ]  # what the vehicle adds to it comes and goes
    assert np.std(heights) == pytest.approx(0.42, rel=0.15)
    first, again = (errors_of(SimulatedVehicle(px4_sih, options=options, seed=4), 0.2) for _ in range(2))
    np.testing.assert_array_equal(first, again)


def test_a_height_error_stays_while_the_vehicle_stands(px4_sih: Vehicle) -> None:
    options = VehicleOptions(sensors=PX4_SENSORS, wander=PX4_WANDER, start_height_error=1.5)
    height = errors_of(SimulatedVehicle(px4_sih, options=options, seed=3), 20.0)[:, 2]
    assert abs(height.mean() - 1.5) < 0.5
    walks = [Drift(PX4_WANDER, np.random.default_rng(seed), 1.5) for seed in range(300)]
    for walk in walks:
        walk.advance(60.0)
    assert np.std([walk.offset[2] - 1.5 for walk in walks]) == pytest.approx(0.3, rel=0.2)


def test_an_estimate_of_motion_capture_can_be_off_in_height_too(px4_sih: Vehicle) -> None:
    sensors, wander = ERRORS["perfect"]
    options = VehicleOptions(sensors=sensors, wander=wander, start_height_error=-0.7)
    errors = errors_of(SimulatedVehicle(px4_sih, options=options), 2.0)
    np.testing.assert_allclose(errors[:, 2], -0.7, atol=1e-9)
    np.testing.assert_allclose(np.delete(errors, 2, axis=1), 0.0, atol=1e-9)


def test_errors_go_on_on_the_ground_but_smaller(px4_sih: Vehicle) -> None:
    options = VehicleOptions(sensors=PX4_SENSORS, wander=PX4_WANDER)
    standing = errors_of(SimulatedVehicle(px4_sih, options=options, seed=60), 60.0)
    spread = np.median([part.std(axis=0)[3:6] for part in np.array_split(standing, 20)], axis=0)
    np.testing.assert_allclose(spread, [0.06, 0.03, 0.05], rtol=0.5)


def test_with_turning_rotors_the_estimate_climbs_at_rest_with_the_accelerometer_s_noise(px4_sih: Vehicle) -> None:
    """As in the take-offs of PX4: by up to 0.3 m/s, where the mean of the samples is above gravity's."""

    def at_rest_with_rotors(seed: int, wander: Wander) -> tuple[float, float]:
        vehicle = SimulatedVehicle(px4_sih, options=VehicleOptions(sensors=PX4_SENSORS, wander=wander), seed=seed)
        forces = []
        for _ in range(140):
            vehicle.advance(ControlSetpoint("rates", rate_body=np.zeros(3), thrust=0.1), True, 0.01)
            forces.append(vehicle.imu.specific_force_body[2])
        return float(np.mean(forces)), float(vehicle.estimate_now.velocity_world[2])

    without = dataclasses.replace(PX4_WANDER, inertial_time=(0.0, 0.0))
    means, climbs = np.array([at_rest_with_rotors(seed, PX4_WANDER) for seed in range(12)]).T
    rest = [at_rest_with_rotors(seed, without)[1] for seed in range(12)]
    integrated = climbs - rest
    assert np.corrcoef(means, integrated)[0, 1] > 0.6
    assert np.std(integrated) == pytest.approx(1.4 * np.sqrt(0.004 * 1.4), rel=0.5)


def test_inertial_samples_are_means_of_two_and_quiet_while_the_rotors_stand(px4_sih: Vehicle) -> None:
    vehicle = SimulatedVehicle(px4_sih, options=VehicleOptions(sensors=PX4_SENSORS, wander=PX4_WANDER), seed=7)

    def samples(setpoint: ControlSetpoint | None) -> Floats:
        rows = []
        for _ in range(1000):
            vehicle.advance(setpoint or IDLE, setpoint is not None, 0.004)
            rows.append(np.concatenate([vehicle.imu.specific_force_body, vehicle.imu.rate_body]))
        return np.array(rows)

    np.testing.assert_allclose(samples(None).std(axis=0), [0.071] * 3 + [0.0071] * 3, rtol=0.3)
    vehicle.advance(hover_at(0.0, 0.0, 3.0), True, 8.0)
    noise = samples(hover_at(0.0, 0.0, 3.0))
    fast = np.diff(noise, n=1, axis=0)  # without the motion: of means of two, the newest less the third
    np.testing.assert_allclose(fast.std(axis=0)[:3], [0.353, 1.20, 0.99], rtol=0.1)
    assert np.corrcoef(fast[2:, 1], fast[:-2, 1])[0, 1] == pytest.approx(-0.5, abs=0.1)


def test_body_rates_carry_the_filtered_noise(px4_sih: Vehicle) -> None:
    vehicle = SimulatedVehicle(px4_sih, options=VehicleOptions(sensors=PX4_SENSORS, wander=PX4_WANDER), seed=8)
    vehicle.advance(hover_at(0.0, 0.0, 3.0), True, 6.0)
    errors = []
    for _ in range(1500):
        vehicle.advance(hover_at(0.0, 0.0, 3.0), True, 0.004)
        errors.append(vehicle.estimate_now.rate_body - vehicle.truth.rate_body)
    np.testing.assert_allclose(np.std(errors, axis=0), [0.083, 0.044, 0.0175], rtol=0.15)


def test_the_quadrotor_of_px4s_simulation_has_px4s_estimate(px4_sih: Vehicle, arpl_250g: Vehicle) -> None:
    assert usual_surroundings(px4_sih) == Surroundings("px4", "sih", "sitl")
    assert usual_surroundings(arpl_250g) == Surroundings("mocap", "legs", "steady")
    mocks = {kind: build_autopilot(MockOptions(FOLDER / "px4_sih.toml", estimator=kind)) for kind in (None, *ERRORS)}
    sensors = {kind: mock.vehicle.options.sensors for kind, mock in mocks.items()}  # type: ignore[attr-defined]
    assert sensors[None] == sensors["px4"] == PX4_SENSORS
    assert sensors["mocap"] != sensors["px4"]


def test_without_satellites_the_estimate_drifts_off_and_returns(px4_sih: Vehicle) -> None:
    options = VehicleOptions(sensors=PX4_SENSORS, wander=PX4_WANDER, start_height_error=0.0)
    vehicle = SimulatedVehicle(px4_sih, options=options, seed=9)
    vehicle.use_gnss(False)
    lost = errors_of(vehicle, 20.0)[-1]
    assert np.hypot(*lost[3:5]) == pytest.approx(20.0 * 0.15, rel=0.2)
    assert np.hypot(*lost[0:2]) == pytest.approx(0.5 * 20.0**2 * 0.15, rel=0.1)
    vehicle.use_gnss(True)
    assert np.abs(errors_of(vehicle, 1.0)[-1][:6]).max() < 1.5


def test_a_held_vehicle_does_not_take_off(arpl_250g: Vehicle) -> None:
    vehicle = SimulatedVehicle(arpl_250g, seed=10)
    start = vehicle.truth.position_world
    vehicle.hold(True)
    vehicle.advance(hover_at(0.0, 0.0, 3.0), True, 3.0)
    assert np.linalg.norm(vehicle.truth.position_world - start) < 0.3
    vehicle.hold(False)
    vehicle.advance(hover_at(0.0, 0.0, 3.0), True, 5.0)
    assert vehicle.truth.position_world[2] > 2.0
