"""Simulated windows: their sensitivities are right, and fitting them finds a planted truth."""

import msgspec
import numpy as np
import pytest

from diagnosis.data.dataset import make_dataset
from diagnosis.estimation.equation_error import fit
from diagnosis.estimation.fitted import Fit, ParameterEstimate, with_candidates
from diagnosis.estimation.output_error import refit
from diagnosis.models.open_loop import open_loop_errors
from diagnosis.models.predictor import Predictor
from diagnosis.models.rollout import Simulator, healthy
from diagnosis.selection.regression_of_flights import make_regression
from dynamics.effects import CATALOGUE
from dynamics.rate_loop import ACTUATION_DELAY, DEFAULT_MOTOR_LAG
from dynamics.vehicle import EffectUse
from tests.diagnosis.conftest import with_columns

NUDGE = 1e-6


@pytest.fixture(scope="module")
def commanded(plain_flights, arpl_250g):
    """The flights as a log without measured rotor speeds holds them."""
    without = {f"rotor_speed_{i}": None for i in range(4)}
    return make_dataset([with_columns(flight, without) for flight in plain_flights], arpl_250g)


@pytest.fixture(scope="module")
def plain(plain_flights, arpl_250g):
    return make_dataset(plain_flights, arpl_250g)


def test_sensitivities_are_those_of_finite_differences(commanded, arpl_250g):
    vehicle = arpl_250g.with_effects(EffectUse("motor_lag"), EffectUse("slung_load"))
    name = "slung_load.mass"
    predictor = Predictor(vehicle, vehicle.effects, CATALOGUE, speed_measured=False)
    segment, p = commanded.fitted[0], predictor.values()
    simulator = Simulator(predictor, segment.rate, [name], speed_measured=False)
    windows = simulator.run(segment, [10, 200], 20, p)
    nx = windows.states.shape[2]
    first = np.zeros((2, nx, 2))
    first[:, 4, 0] = 1.0  # of the velocity to the north
    refitted = simulator.sensitivities(windows, p, first)
    mass = p[predictor.model.parameter_index(name)]
    moved = simulator.run(segment, [10, 200], 20, predictor.values({name: mass + NUDGE}))
    first[:, :, 0] = (moved.states[:, 0] - windows.states[:, 0]) / NUDGE  # where hidden states begin depends on it, too
    both = simulator.sensitivities(windows, p, first)[:, -1].sum(axis=2)
    assert (moved.states[:, -1] - windows.states[:, -1]) / NUDGE == pytest.approx(both, rel=1e-3, abs=1e-3)
    assert refitted[:, -1, 4, 0] == pytest.approx(1.0, abs=0.01)  # nothing drags
    assert refitted[:, -1, 1, 0] == pytest.approx(20 / segment.rate, rel=0.01)


def test_windows_end_where_the_vehicle_did_only_with_the_right_mass(plain, arpl_250g):
    heavier = arpl_250g.with_effects(EffectUse("mass", {"ratio": 1.06}))
    right, wrong = (open_loop_errors(v, CATALOGUE, plain.held_out)[1] for v in (arpl_250g, heavier))
    assert right.horizon == wrong.horizon == 0.5
    assert right.velocity < 0.25 * wrong.velocity


@pytest.mark.parametrize(("name", "begin", "truth"), [("mass", 1.02, 1.0), ("torque_constant", 1.1, 1.0)])
def test_output_error_finds_the_truth_from_a_wrong_beginning(plain, arpl_250g, name, begin, truth):
    some = {n: CATALOGUE[n] for n in (name, "gyro_bias", "imu_bias", "time_delay")}
    regression = make_regression(arpl_250g, some, plain.fitted, plain.flight_of)
    candidate = next(c for c in regression.candidates if c.effect.name == name)
    vehicle = with_candidates(arpl_250g, [candidate], {f"{name}.ratio": begin})
    started = Fit(vehicle, {(name, "ratio"): ParameterEstimate(begin, 0.01, "1")}, (candidate,))
    refitted = refit(started, arpl_250g, some, plain.fitted, plain.held_out)
    assert refitted is not None
    estimate = refitted.fit.estimates[name, "ratio"]
    assert estimate.value == pytest.approx(truth, abs=0.1 * (begin - truth))
    assert abs(estimate.value - truth) < 4 * estimate.std
    assert refitted.after < refitted.before
    assert refitted.fit.vehicle.effects[0].parameters["ratio"] == estimate.value


def test_the_lag_of_the_motors_is_left_to_equation_error(commanded, arpl_250g):
    """Over half a second feedback makes a lag look longer, and no instrument reaches hidden states there."""
    some = {n: CATALOGUE[n] for n in ("motor_lag", "gyro_bias", "imu_bias", "time_delay")}
    regression = make_regression(arpl_250g, some, commanded.fitted, commanded.flight_of)
    candidate = next(c for c in regression.candidates if c.effect.name == "motor_lag")
    started = fit(regression, [candidate])
    lag = DEFAULT_MOTOR_LAG + ACTUATION_DELAY  # commands are heard late, which is as good as more lag
    assert started.estimates["motor_lag", "time_constant"].value == pytest.approx(lag, abs=0.003)
    assert refit(started, arpl_250g, some, commanded.fitted, commanded.held_out) is None


def test_a_fault_of_a_sensor_alone_is_not_simulated(plain, arpl_250g):
    some = {n: CATALOGUE[n] for n in ("gyro_bias", "imu_bias", "time_delay")}
    regression = make_regression(arpl_250g, some, plain.fitted, plain.flight_of)
    candidate = next(c for c in regression.candidates if c.effect.name == "gyro_bias")
    estimates = {("gyro_bias", axis): ParameterEstimate(0.01, 0.01, "rad/s") for axis in "xyz"}
    started = Fit(with_candidates(arpl_250g, [candidate], {}), estimates, (candidate,))
    assert refit(started, arpl_250g, some, plain.fitted, plain.held_out) is None


def test_what_a_faulty_sensor_reads_is_put_right_before_simulating(plain, arpl_250g):
    faulty = arpl_250g.with_effects(
        EffectUse("rotor_speed_fault", {"gain": 0.5}, 2),
        EffectUse("gyro_bias", {"x": 0.1, "y": 0.0, "z": 0.0}),
        EffectUse("time_delay", {"delay": 0.02}),
        EffectUse("rotor_drag"),
    )
    rest, (mended,) = healthy(faulty, CATALOGUE, plain.held_out[:1])
    read = plain.held_out[0]
    assert [use.name for use in rest.effects] == ["rotor_drag"]
    assert mended.rotor_speed / read.rotor_speed == pytest.approx(np.tile([1, 1, 2, 1], (len(read), 1)))
    assert mended.gyro - read.gyro == pytest.approx(np.tile([-0.1, 0, 0], (len(read), 1)))
    late = round(0.02 * read.rate)
    assert mended.velocity[:-late] == pytest.approx(read.velocity[late:], abs=1e-9)
    same, untouched = healthy(msgspec.structs.replace(arpl_250g), CATALOGUE, plain.held_out)
    assert same == arpl_250g
    assert untouched == list(plain.held_out)
