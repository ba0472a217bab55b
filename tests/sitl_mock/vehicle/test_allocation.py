import casadi as ca
import msgspec
import numpy as np
import pytest

from dynamics.allocation import effectiveness, mixer, torque_authority
from dynamics.vehicle import Body, Rotors, Vehicle
from dynamics.vehicle_file import read_vehicle
from sitl_mock.vehicle.allocation import allocate, rotor_speed_command, signal_for_thrust
from vehicles import FOLDER


@pytest.fixture(scope="module")
def sih() -> Vehicle:
    return read_vehicle(FOLDER / "px4_sih.toml")


def motors(vehicle: Vehicle, *demand: float) -> np.ndarray:
    return np.array(ca.evalf(allocate(ca.SX(ca.DM(mixer(vehicle))), ca.SX(ca.DM(demand))))).ravel()


def allocated(vehicle: Vehicle, thrusts: np.ndarray) -> np.ndarray:
    """The normalised torques and thrust that motor thrusts amount to."""
    return np.linalg.pinv(mixer(vehicle)) @ thrusts


def test_the_mixer_of_a_quadrotor_is_px4s(sih: Vehicle) -> None:
    # PX4: +-0.707 in roll and pitch, +-1 in yaw, 1 in thrust; here in FLU, rotors front left, back left, ...
    half = np.sqrt(0.5)
    expected = [[half, -half, 1, 1], [half, half, -1, 1], [-half, half, 1, 1], [-half, -half, -1, 1]]
    np.testing.assert_allclose(mixer(sih), expected, atol=1e-12)


def test_torque_authority_of_sih(sih: Vehicle) -> None:
    np.testing.assert_allclose(torque_authority(sih), [4 * np.sqrt(0.5) * 5 * 0.2] * 2 + [4 * 0.1], rtol=1e-9)


def test_the_mixer_takes_arms_from_the_centre_of_mass(sih: Vehicle) -> None:
    shifted = msgspec.structs.replace(sih, body=msgspec.structs.replace(sih.body, centre_of_mass=(0.05, -0.02, 0.0)))
    hover = mixer(shifted) @ [0, 0, 0, 0.5]
    torque = effectiveness(shifted)[0:3] @ hover
    np.testing.assert_allclose(torque, 0, atol=1e-9)
    assert hover[0] > hover[2]  # more lift in front and on the left, where the weight is not


@pytest.mark.parametrize("demand", [(0.1, -0.05, 0.02, 0.5), (0, 0, 0, 0.3), (-0.2, 0.1, 0.0, 0.6)])
def test_a_demand_that_fits_is_allocated_exactly(sih: Vehicle, demand: tuple[float, ...]) -> None:
    np.testing.assert_allclose(allocated(sih, motors(sih, *demand)), demand, atol=1e-9)


def test_roll_goes_before_thrust(sih: Vehicle) -> None:
    reached = allocated(sih, motors(sih, 0.4, 0.0, 0.0, 0.95))
    assert reached[0] == pytest.approx(0.4, abs=1e-9)
    assert reached[3] < 0.95


def test_roll_and_pitch_go_before_yaw(sih: Vehicle) -> None:
    thrusts = motors(sih, 0.3, 0.0, 0.9, 0.5)
    reached = allocated(sih, thrusts)
    assert reached[0] == pytest.approx(0.3, abs=1e-6)
    assert reached[1] == pytest.approx(0.0, abs=1e-6)
    assert 0 < reached[2] < 0.5
    assert thrusts.min() >= 0
    assert thrusts.max() <= 1


def test_airmode_is_off_thrust_never_grows(sih: Vehicle) -> None:
    random = np.random.default_rng(5)
    for _ in range(50):
        demand = random.uniform([-1, -1, -1, 0], [1, 1, 1, 1])
        thrusts = motors(sih, *demand)
        assert allocated(sih, thrusts)[3] <= demand[3] + 1e-9
        assert thrusts.min() >= 0
        assert thrusts.max() <= 1


def test_without_thrust_the_motors_stand(sih: Vehicle) -> None:
    np.testing.assert_allclose(motors(sih, 0.5, -0.3, 0.2, 0.0), 0, atol=1e-12)


def test_a_hexacopter_is_allocated(sih: Vehicle) -> None:
    angles = np.radians(np.arange(30, 390, 60))
    ring = tuple((0.3 * float(np.cos(a)), 0.3 * float(np.sin(a)), 0.0) for a in angles)
    hexa = Vehicle("hexa", Body(2.0, (0.04, 0.04, 0.07)), Rotors(ring, (1, -1, 1, -1, 1, -1), 1e-5, 2e-7, 800.0))
    np.testing.assert_allclose(allocated(hexa, motors(hexa, 0.1, 0.1, 0.02, 0.5)), [0.1, 0.1, 0.02, 0.5], atol=1e-9)


@pytest.mark.parametrize("factor", [0.0, 0.3, 1.0])
def test_thrust_model_factor_is_inverted(factor: float) -> None:
    thrust = np.linspace(0, 1, 11)
    signal = np.array([float(signal_for_thrust(ca.DM(value), ca.DM(factor))) for value in thrust])
    np.testing.assert_allclose(factor * signal**2 + (1 - factor) * signal, thrust, atol=1e-9)


@pytest.mark.parametrize("curve", [0.0, 0.4, 1.0])
def test_a_motor_thrusts_by_its_curve(curve: float) -> None:
    speed = float(rotor_speed_command(ca.DM(0.6), curve=curve, speed_max=1000.0))
    assert (speed / 1000) ** 2 == pytest.approx(curve * 0.36 + (1 - curve) * 0.6)
