"""The filter: its recursion, its gain, its slopes in the noise, and the error state it stands on."""

from __future__ import annotations

import numpy as np
import pytest

from diagnosis.likelihood.gain import Gain, Plant, make_gain, noise_slopes, slopes
from diagnosis.likelihood.innovations import Linearised, start
from diagnosis.likelihood.noise_fit import STRUCTURES, compose
from diagnosis.likelihood.rigid_body import FlightModel, moved_reference
from diagnosis.noise.component import hover
from dynamics.rotation_matrix import exponential, logarithm, orthonormal, skew
from dynamics.vehicle import GRAVITY
from dynamics.vehicle_file import read_vehicle
from tests.diagnosis.likelihood.flights import problem_of
from tests.diagnosis.noise.kalman_filter import filter_rows
from vehicles import FOLDER

VEHICLE = read_vehicle(FOLDER / "px4_sih.toml")
READINGS = ("velocity", "attitude", "gyro", "accelerometer", "rotor_speed")
PERIOD = 0.01


def plant(readings: tuple[str, ...] = READINGS) -> Plant:
    """Hover with a linear drag and rotors that twist and lift."""
    slope = np.zeros((6, 9))
    slope[:3, :3], slope[3:, 6:] = -0.3 * np.eye(3), -0.5 * np.eye(3)
    by_rotor = np.zeros((6, 4))
    by_rotor[2], by_rotor[3], by_rotor[4] = 0.01, [0.2, -0.2, -0.2, 0.2], [0.2, 0.2, -0.2, -0.2]
    return Plant(hover(VEHICLE, PERIOD, 100.0, 250.0), slope, by_rotor, readings)


def gain_at(structure: str, place: Plant) -> tuple[Gain, dict[str, float]]:
    """The filter at the priors' medians."""
    composition = compose(structure, place.readings)
    values = composition.medians(VEHICLE)
    return make_gain(composition, values, place), values


def still(gain: Gain, rows: int, rotors: int = 4) -> Linearised:
    """A model that is hover's in each row."""
    A = np.tile(gain.model.A[:9, :9], (rows, 1, 1))
    C = np.tile(gain.model.C[:, :9], (rows, 1, 1))
    return Linearised(A, C, np.zeros((rows, 6)))


def test_rotations_are_those_of_their_vectors():
    vectors = np.random.default_rng(1).uniform(-1.5, 1.5, (50, 3))
    vectors[0] = 0.0
    rotations = exponential(vectors)
    np.testing.assert_allclose(rotations @ np.swapaxes(rotations, 1, 2), np.tile(np.eye(3), (50, 1, 1)), atol=1e-14)
    np.testing.assert_allclose(logarithm(rotations), vectors, atol=1e-12)
    np.testing.assert_allclose(skew(vectors[3]) @ vectors[4], np.cross(vectors[3], vectors[4]), atol=1e-14)
    np.testing.assert_allclose(orthonormal(rotations + 1e-6), rotations, atol=1e-5)


@pytest.mark.parametrize("structure", STRUCTURES)
def test_innovations_are_those_of_the_plain_kalman_filter(structure):
    place = plant()
    gain, _ = gain_at(structure, place)
    random = np.random.default_rng(2)
    readings = random.standard_normal((400, len(gain.V))) * 1e-3
    plain = filter_rows(gain.model, gain.P, readings)  # in its steady state from the first row on
    B, D = np.zeros((400, 9, 1)), np.ascontiguousarray(readings[:, :, None])
    white, _ = start(gain, 1).advance(still(gain, 400), B, D)
    np.testing.assert_allclose(white[:, :, 0], plain.whitened, atol=2e-6 * np.abs(plain.whitened).max())


def test_a_pass_goes_on_where_it_stopped_and_columns_do_not_mix():
    gain, _ = gain_at("filtered pose", plant())
    random = np.random.default_rng(3)
    B, D = random.standard_normal((60, 17, 3)), random.standard_normal((60, len(gain.V), 3))
    together, _ = start(gain, 3).advance(still(gain, 60), B, D)
    parts = start(gain, 3)
    outputs = [parts.advance(still(gain, 20), B[i : i + 20].copy(), D[i : i + 20].copy())[0] for i in (0, 20, 40)]
    np.testing.assert_allclose(np.concatenate(outputs), together, atol=1e-10)
    alone, _ = start(gain, 1).advance(still(gain, 60), B[:, :, [1]].copy(), D[:, :, [1]].copy())
    np.testing.assert_allclose(alone[:, :, 0], together[:, :, 1], atol=1e-10)


@pytest.mark.parametrize("structure", STRUCTURES)
def test_slopes_in_the_noise_are_those_of_differences(structure):
    place = plant()
    gain, values = gain_at(structure, place)
    composition, names = compose(structure, place.readings), list(values)
    logs = np.log(list(values.values()))
    analytic = slopes(composition, logs, names, place, gain)
    for number, change in enumerate(analytic):
        ends = []
        for sign in (1, -1):
            moved = logs.copy()
            moved[number] += sign * 1e-3
            ends.append(make_gain(composition, dict(zip(names, np.exp(moved), strict=True)), place))
        for name, size in (("K", gain.K), ("V", gain.V)):
            numeric = (getattr(ends[0], name) - getattr(ends[1], name)) / 2e-3
            error = np.abs(getattr(change, name) - numeric).max()
            assert error < 2e-3 * np.abs(numeric).max() + 2e-6 * np.abs(size).max(), names[number]


def test_innovations_move_with_the_noise_as_their_slopes_say():
    place = plant()
    composition = compose("filtered pose", place.readings)
    values = composition.medians(VEHICLE)
    names, logs = list(values), np.log(list(values.values()))
    gain = make_gain(composition, values, place)
    random = np.random.default_rng(4)
    B, D = np.zeros((200, 9, 1)), random.standard_normal((200, len(gain.V), 1)) * 1e-3
    white, states = start(gain, 1).advance(still(gain, 200), B, D, path=True)
    inverse = np.linalg.inv(gain.whitening)
    maps = noise_slopes(slopes(composition, logs, names, place, gain), gain, np.ones(len(logs)), np.zeros(len(logs)))
    moved, _ = start(gain, len(logs)).advance(still(gain, 200), *maps.inputs(states, white[:, :, 0] @ inverse.T))
    for name in ("turbulence.torque_xy", "gyro.density_x", "rotor_motion.drive", "slow_turbulence.force_time"):
        number, ends = names.index(name), []
        for sign in (1, -1):
            other = logs.copy()
            other[number] += sign * 1e-3
            near = make_gain(composition, dict(zip(names, np.exp(other), strict=True)), place)
            out, _ = start(near, 1).advance(still(near, 200), B, D)
            ends.append(out[:, :, 0] @ np.linalg.inv(near.whitening).T)
        numeric = (ends[0] - ends[1]) / 2e-3
        analytic = moved[:, :, number] @ inverse.T
        np.testing.assert_allclose(analytic, numeric, atol=2e-3 * np.abs(numeric).max())


def test_the_compiled_pass_leaves_the_processors_arithmetic_as_it_was():
    """A library that is compiled for fast mathematics sets small numbers to zero in the whole process."""
    gain, _ = gain_at("filtered pose", plant())
    start(gain, 1).advance(still(gain, 2), np.zeros((2, 9, 1)), np.zeros((2, len(gain.V), 1)))
    assert np.nextafter(0.0, 1.0) * 1.0 > 0.0


def test_states_that_no_reading_shows_are_left_out():
    place = plant()
    composition = compose("smooth estimator", place.readings)
    noise = composition.model(composition.medians(VEHICLE), place.conditions)
    assert "position_x" in noise.outputs
    assert "position_x" not in place.outputs
    gain, _ = gain_at("smooth estimator", place)
    of_position = [name for name in noise.states if "position" in name]
    assert len(gain.transition) == 9 + len(noise.states) - len(of_position)


def test_the_error_state_is_the_slope_of_the_model():
    problem = problem_of("nothing", "speeds", 90002, 1)
    rows, reference = problem.flights[0], problem.reference(0)
    model = FlightModel(problem.vehicle, problem.uses, problem.catalogue)
    lift = np.array([0.0, 0.0, GRAVITY])
    here = model.along(rows, reference, lift)
    random = np.random.default_rng(5)
    error = np.zeros((len(rows), 17))
    error[:, :9] = random.standard_normal((len(rows), 9)) * 1e-5
    error[0] = 0.0  # rows' ends are shared, so each is compared with the defect that its own error leaves
    there = model.along(rows, moved_reference(reference, error), lift)
    after = np.concatenate([error[1:, :9], error[-1:, :9]])
    expected = here.defect[:, :9] + np.einsum("tij,tj->ti", here.model.A, error[:, :9]) - after
    np.testing.assert_allclose(there.defect[:-1, :9], expected[:-1], atol=3e-7)
    read = here.difference - np.einsum("tij,tj->ti", here.model.C, error[:, :9])
    np.testing.assert_allclose(there.difference[:-1], read[:-1], atol=2e-7)
