"""Each component's spectrum, variance and discretisation are those of its state space, and of its own definition."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest
import scipy
from scipy import stats
from scipy.spatial.transform import Rotation

from diagnosis.noise.component import Component, FlightConditions, Hyperparameter, LogNormal, fixed_prior, hover
from diagnosis.noise.components import CATALOGUE
from diagnosis.noise.composition import Composition
from diagnosis.noise.discretisation import discretise
from diagnosis.noise.linear_model import LinearModel, compose, gauss_markov, random_walk, read_noise, white
from dynamics.arrays import Floats
from dynamics.vehicle import Vehicle
from dynamics.vehicle_file import read_vehicle
from vehicles import FOLDER

VEHICLES = [read_vehicle(path) for path in sorted(FOLDER.glob("*.toml"))]
FREQUENCIES = np.geomspace(1e-3, 300.0, 40)
WALKS = {"gyro", "accelerometer", "rotor_motion"}  # without a stationary variance


def conditions(vehicle: Vehicle, random: np.random.Generator) -> FlightConditions:
    at = hover(vehicle, 0.02, pose_rate=120.0, command_rate=250.0)
    return FlightConditions(
        vehicle, at.period, at.specific_force, at.rate_body, random.normal(0, 3, 3),
        at.rotor_thrust * random.uniform(0.7, 1.3, vehicle.rotors.count), at.pose_rate, at.command_rate,
    )  # fmt: skip


def drawn(name: str, seed: int) -> tuple[Composition, dict[str, float], FlightConditions]:
    """A component with those that it needs, values anywhere between their bounds."""
    random = np.random.default_rng([seed, len(name)])
    component = CATALOGUE[name]
    composition = Composition((component, *(CATALOGUE[other] for other in component.needs)))
    values = {n: float(np.exp(random.uniform(*np.log([p.lower, p.upper])))) for n, p in composition.parameters.items()}
    return composition, values, conditions(VEHICLES[seed % len(VEHICLES)], random)


def transfer_density(model: LinearModel, frequency: float) -> Floats:
    """H (i omega - F)^-1 L + D, its squares summed over the noises."""
    inverse = scipy.linalg.inv(2j * np.pi * frequency * np.eye(len(model.F)) - model.F) if len(model.F) else model.F
    transfer = model.H @ inverse @ model.L + model.D
    return np.asarray((np.abs(transfer) ** 2 * model.Qc).sum(1))


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("name", CATALOGUE)
def test_the_spectrum_is_the_squared_transfer_function(name: str, seed: int) -> None:
    composition, values, at = drawn(name, seed)
    model = composition.model(values, at)
    spectrum = composition.spectrum(values, at, FREQUENCIES)
    assert set(spectrum) == set(model.outputs)
    transfer = np.array([transfer_density(model, frequency) for frequency in FREQUENCIES]) + model.R * at.period
    for place, output in enumerate(model.outputs):
        np.testing.assert_allclose(spectrum[output], transfer[:, place], rtol=1e-6, atol=0)
        cross = model.density(FREQUENCIES, at.period)[:, place, place]
        np.testing.assert_allclose(cross.real, transfer[:, place], rtol=1e-6, atol=0)


@pytest.mark.parametrize("name", [name for name in CATALOGUE if name not in WALKS | {"integrating_estimator"}])
def test_the_integral_of_the_spectrum_is_the_stationary_variance(name: str) -> None:
    for vehicle in VEHICLES:
        composition = Composition((CATALOGUE[name],))
        at = conditions(vehicle, np.random.default_rng(1))
        values = composition.medians(vehicle)
        model = composition.model(values, at)
        if not model.states:
            assert np.all(model.Qc + model.R > 0)
            continue
        variance = np.diag(model.H @ model.start_covariance() @ model.H.T)
        grid = np.geomspace(1e-7, 1e7, 40_000)
        for place, output in enumerate(model.outputs):
            density = composition.spectrum(values, at, grid)[output]
            assert 2 * np.trapezoid(density * grid, np.log(grid)) == pytest.approx(variance[place], rel=1e-5)


@pytest.mark.parametrize(("name", "sizes"), [
    ("turbulence", {"force_x": "force_xy", "force_z": "force_z", "torque_y": "torque_xy", "torque_z": "torque_z"}),
    ("slow_turbulence", {"force_y": "force_xy", "torque_z": "torque_z"}),
    ("smooth_estimator", {"attitude_x": "attitude_std", "velocity_y": "velocity_std", "position_z": "position_std"}),
    ("dryden_gust", {"air_x": "std", "air_y": "std", "air_z": "std"}),
])  # fmt: skip
def test_a_standard_deviation_is_that_of_its_output(name: str, sizes: dict[str, str]) -> None:
    for seed in range(4):
        composition, values, at = drawn(name, seed)
        model = composition.model(values, at)
        variance = np.diag(model.H @ model.start_covariance() @ model.H.T)
        for output, parameter in sizes.items():
            expected = values[f"{name}.{parameter}"] ** 2
            assert variance[model.outputs.index(output)] == pytest.approx(expected, rel=1e-8)


@pytest.mark.parametrize("name", CATALOGUE)
def test_two_half_steps_are_one_step(name: str) -> None:
    for seed in range(3):
        composition, values, at = drawn(name, seed)
        model = composition.model(values, at)
        period = float(np.exp(np.random.default_rng(seed).uniform(np.log(0.002), np.log(2.0))))
        one, half = (discretise(model, step, model.outputs) for step in (period, period / 2))
        A, C, Q, S = half.A, half.C, half.Q, half.S
        means = half.R - np.diag(model.R)  # the noise of single readings is no integral
        np.testing.assert_allclose(one.A, A @ A, rtol=1e-8, atol=1e-12)
        _close(one.Q, A @ Q @ A.T + Q)
        np.testing.assert_allclose(
            one.C, (C + C @ A) / 2, rtol=1e-8, atol=1e-11 * max(1.0, float(np.abs(C).max(initial=0)))
        )
        _close(one.R - np.diag(model.R), (means + means + C @ Q @ C.T + C @ S + S.T @ C.T) / 4)
        # [A w1 + w2; (v1 + C w1 + v2) / 2]
        assert np.allclose(
            one.S, (A @ (S + Q @ C.T) + S) / 2, rtol=1e-7, atol=1e-9 * float(np.abs(one.S).max(initial=0))
        )


def _close(computed: Floats, expected: Floats) -> None:
    """Equal by the size of their diagonals, which are of different units."""
    size = np.sqrt(np.abs(np.diag(expected)))
    np.testing.assert_array_less(np.abs(computed - expected), 1e-8 * np.outer(size, size) + 1e-300)


@pytest.mark.parametrize("period", [0.003, 0.1, 1.5])
def test_the_discretisation_is_the_integral(period: float) -> None:
    model = compose([gauss_markov("x", 0.3, 0.006), gauss_markov("y", 0.2, 3.0), random_walk("z", 0.1, 1.0)])
    computed = discretise(model, period)
    np.testing.assert_allclose(
        computed.A, np.diag(np.exp(-period / np.array([0.006, 3.0, np.inf]))), rtol=1e-11, atol=0
    )
    variances = [0.09 * -np.expm1(-2 * period / 0.006), 0.04 * -np.expm1(-2 * period / 3.0), 0.01 * period]
    np.testing.assert_allclose(computed.Q, np.diag(variances), rtol=1e-10, atol=0)


def test_what_has_no_value_is_refused() -> None:
    sensor = Composition((CATALOGUE["accelerometer"],))
    at = hover(VEHICLES[0], 0.01, 100.0, 250.0)
    model = sensor.model(sensor.medians(VEHICLES[0]), at)
    with pytest.raises(ValueError, match="accelerometer_x holds white noise"):
        discretise(model, 0.01)
    with pytest.raises(ValueError, match="no outputs force_x; there are accelerometer_x"):
        discretise(model, 0.01, {"force_x"})
    with pytest.raises(ValueError, match="shares noises of accelerometer, gyro"):
        Composition((CATALOGUE["integrating_estimator"],))
    with pytest.raises(ValueError, match="gyro occurs twice"):
        Composition((CATALOGUE["gyro"], CATALOGUE["gyro"]))
    with pytest.raises(ValueError, match="no stationary variance"):
        random_walk("x", 0.1, np.nan).start_covariance()
    borrowed = LinearModel(("x",), ("gyro.x",), ("attitude_x",), -np.eye(1), np.eye(1), np.eye(1), np.full(1, np.nan))
    with pytest.raises(ValueError, match=r"no component gives the noise gyro\.x"):
        discretise(borrowed, 0.01)
    with pytest.raises(ValueError, match=r"F is \(1, 1\); 2 states"):
        LinearModel(("a", "b"), ("w",), ("y",), np.eye(1), np.eye(1), np.eye(1), np.ones(1))
    numbers = CATALOGUE["motion_capture"].parameters
    own = Component("own", "", "", numbers, lambda *_: white("thrust", 1.0), lambda *_: {})
    with pytest.raises(ValueError, match="outputs thrust are no channels"):
        Composition((own,)).model({"own.position": 1.0, "own.attitude": 1.0}, at)
    with pytest.raises(ValueError, match=r"bounds 0\.0 and 1\.0"):
        Component("own", "", "", (Hyperparameter("a", "1", "", 0.0, 1.0, fixed_prior(1, 1)),), *[lambda *_: None] * 2)


def test_the_composition_is_block_diagonal_but_for_shared_noise() -> None:
    composition = Composition(
        tuple(CATALOGUE[n] for n in ("gyro", "accelerometer", "integrating_estimator", "turbulence"))
    )
    model = composition.model(composition.medians(VEHICLES[0]), hover(VEHICLES[0], 0.01, 100.0, 250.0))
    rooms = np.array([name.split(".")[0] for name in model.states])
    assert not np.any(model.F[rooms[:, None] != rooms])
    driven = {noise: {str(room) for room in rooms[model.L[:, k] != 0]} for k, noise in enumerate(model.noises)}
    assert driven["gyro.x"] == {"gyro", "integrating_estimator"}  # the estimator integrates before the low-pass
    assert driven["accelerometer.x"] == {"integrating_estimator"}
    assert model.D[model.outputs.index("accelerometer_x"), model.noises.index("accelerometer.x")] == 1
    assert all(len(names) == 1 for noise, names in driven.items() if noise not in ("gyro.x", "gyro.y", "gyro.z"))
    assert not np.isnan(model.Qc).any()


def test_outputs_of_one_name_add_and_noises_of_one_name_are_one() -> None:
    twice = compose(
        [white("y", 0.3, noise="w"), white("y", 0.3, noise="w"), read_noise("y", 2.0), read_noise("y", 3.0)]
    )
    shared = discretise(twice, 0.5, {"y"}).R.item()
    assert shared == pytest.approx((2 * 0.3) ** 2 / 0.5 + 2.0 + 3.0)
    apart = compose([white("y", 0.3, noise="w"), white("y", 0.3, noise="v")])
    separate = discretise(apart, 0.5, {"y"}).R.item()
    assert separate == pytest.approx(2 * 0.3**2 / 0.5)


def test_an_estimators_error_moves_as_that_of_a_strapdown_integration() -> None:
    """Error and constant errors of the sensors, integrated with rotations of any size, against the linear model."""
    random = np.random.default_rng(3)
    force, rate = random.normal(0, 8, 3), random.normal(0, 2, 3)
    vehicle, duration, steps = VEHICLES[0], 0.3, 3000
    at = FlightConditions(vehicle, 0.01, force, rate, np.zeros(3), np.ones(vehicle.rotors.count), 100.0, 250.0)
    composition = Composition(tuple(CATALOGUE[n] for n in ("integrating_estimator", "gyro", "accelerometer")))
    values = composition.medians(vehicle) | {
        f"integrating_estimator.{k}_time": 1e12 for k in ("attitude", "velocity", "position")
    }
    model = composition.model(values, at)
    states = [
        model.states.index(f"integrating_estimator.{k}_{a}")
        for k in ("attitude", "velocity", "position")
        for a in "xyz"
    ]
    noises = [model.noises.index(f"{sensor}.{axis}") for sensor in ("gyro", "accelerometer") for axis in "xyz"]
    start, errors = 1e-6 * random.standard_normal(9), 1e-6 * random.standard_normal(6)
    F = np.block([[model.F[np.ix_(states, states)], model.L[np.ix_(states, noises)]], [np.zeros((6, 15))]])
    expected = (scipy.linalg.expm(F * duration) @ np.concatenate([start, errors]))[:9]

    step = duration / steps
    R, v, s = Rotation.identity(), np.zeros(3), np.zeros(3)
    E, u, t = Rotation.from_rotvec(start[:3]), start[3:6].copy(), start[6:].copy()
    for _ in range(steps):
        half, half_error = (
            R * Rotation.from_rotvec(rate * step / 2),
            E * Rotation.from_rotvec((rate + errors[:3]) * step / 2),
        )
        push, push_error = half.apply(force), half_error.apply(force + errors[3:])
        s, t = s + step * v + step**2 / 2 * push, t + step * u + step**2 / 2 * push_error
        v, u = v + step * push, u + step * push_error
        R, E = R * Rotation.from_rotvec(rate * step), E * Rotation.from_rotvec((rate + errors[:3]) * step)
    computed = np.concatenate([(R.inv() * E).as_rotvec(), R.inv().apply(u - v), R.inv().apply(t - s)])
    np.testing.assert_allclose(computed, expected, rtol=2e-4, atol=1e-10)


@pytest.mark.parametrize("m", [1, 2, 5, 40])
def test_commands_between_rows_vary_as_a_sampled_random_walk(m: int) -> None:
    vehicle, period, walk = VEHICLES[0], 0.04, 20.0
    at = hover(vehicle, period, 100.0, command_rate=m / period)
    steps = walk**2 * period / m * np.eye(m)
    values = np.tril(np.ones((m, m)), -1)  # of the row's m commands about the first, by the m steps to the next row
    mean, end = values.mean(0), np.ones(m)
    about_first = mean @ steps @ mean
    about_line = about_first - (mean @ steps @ end) ** 2 / (end @ steps @ end)
    for name, variance in (("held_commands", about_first), ("linear_commands", about_line)):
        model = Composition((CATALOGUE[name],)).model({f"{name}.walk": walk}, at)
        discrete = discretise(model, period, model.outputs)
        assert model.outputs == tuple(f"rotor_speed_{rotor}" for rotor in range(vehicle.rotors.count))
        np.testing.assert_allclose(discrete.R, variance * np.eye(vehicle.rotors.count), rtol=1e-12, atol=1e-12)


def test_a_rotors_turbulence_acts_at_its_place() -> None:
    off_centre = msgspec.structs.replace(VEHICLES[0].body, centre_of_mass=(0.01, -0.02, 0.005))
    for vehicle in (*VEHICLES, msgspec.structs.replace(VEHICLES[0], body=off_centre)):
        at = conditions(vehicle, np.random.default_rng(4))
        model = Composition((CATALOGUE["rotor_turbulence"],)).model(
            {"rotor_turbulence.share": 0.02, "rotor_turbulence.time": 0.1}, at
        )
        rotors = vehicle.rotors
        for rotor, (place, spin) in enumerate(zip(rotors.position, rotors.spin, strict=True)):
            arm = np.subtract(place, vehicle.body.centre_of_mass)
            thrust = np.array([0.0, 0.0, at.rotor_thrust[rotor]])
            torque = np.cross(arm, thrust) + spin * rotors.torque_constant / rotors.thrust_constant * thrust
            column = model.H[:, rotor]
            np.testing.assert_allclose(column, [thrust[2], *torque], rtol=1e-12, atol=1e-15)


def test_priors_lie_within_the_bounds_and_are_normal_in_the_logarithm() -> None:
    composition = Composition(tuple(CATALOGUE.values()))
    for vehicle in VEHICLES:
        medians = composition.medians(vehicle)
        for name, parameter in composition.parameters.items():
            assert parameter.lower < parameter.prior(vehicle).median < parameter.upper
            assert medians[name] == parameter.prior(vehicle).median
        moved = {name: 1.7 * value for name, value in medians.items()}
        spreads = [p.prior(vehicle).spread for p in composition.parameters.values()]
        expected = sum(stats.norm.logpdf(np.log(1.7), scale=spread) for spread in spreads)
        assert composition.log_prior(moved, vehicle) == pytest.approx(expected)
    assert LogNormal(2.0, 0.5).log_density(2.0) == pytest.approx(stats.norm.logpdf(0, scale=0.5))


def test_two_time_scales_have_no_place_to_exchange() -> None:
    fast, slow = ({p.name: p for p in CATALOGUE[n].parameters} for n in ("turbulence", "slow_turbulence"))
    for name in ("force_time", "torque_time"):
        assert fast[name].upper <= slow[name].lower
