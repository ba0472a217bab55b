"""Predictions along a flight are the model's own, and slopes are their derivatives."""

import numpy as np
import pytest

from diagnosis.data.segment import segments
from diagnosis.models import channels
from diagnosis.models.predictor import Predictor
from diagnosis.selection.candidates import make_candidates
from dynamics.effects import CATALOGUE
from dynamics.model import build_model
from dynamics.vehicle import EffectUse


@pytest.fixture(scope="module")
def segment(plain_flights, arpl_250g):
    return segments(plain_flights[4], arpl_250g)[0]


def make(vehicle, name, values, free=(), rotor=None):
    keys = [f"{name}.{n}" if rotor is None else f"{name}[{rotor}].{n}" for n in free]
    return Predictor(vehicle, [EffectUse(name, values, rotor)], CATALOGUE, keys, speed_measured=True)


def test_a_prediction_is_the_models_at_every_row(segment, arpl_250g):
    predictor = make(arpl_250g, "rotor_drag", {"coefficient": 3e-5})
    prediction = predictor.predict(segment)
    model = build_model(arpl_250g, effects=[EffectUse("rotor_drag", {"coefficient": 3e-5})])
    for row in (0, 100, 500):
        arguments = (segment.smooth[row], segment.rotor_speed[row], model.parameter_values, segment.environment[row])
        force, angular, _ = model.observe(*arguments)
        np.testing.assert_allclose(prediction.specific_force[row], np.array(force).ravel(), rtol=1e-9)
        np.testing.assert_allclose(prediction.angular_acceleration[row], np.array(angular).ravel(), rtol=1e-9)


@pytest.mark.parametrize(
    ("name", "at", "free", "rotor"),
    [
        ("inertia", {"ratio_x": 1.1, "ratio_y": 0.9, "ratio_z": 1.0}, "ratio_y", None),
        ("ground_effect", {"gain": 0.5, "radius": 0.1}, "radius", None),
        ("rotor_speed_fault", {"gain": 0.8}, "gain", 2),
        ("gyro_bias", {"x": 0.1, "y": 0.0, "z": 0.0}, "x", None),
        ("imu_bias", {"x": 0.1, "y": 0.0, "z": 0.0}, "z", None),
    ],
)
def test_slopes_are_derivatives(segment, arpl_250g, name, at, free, rotor):
    predictor = make(arpl_250g, name, at, [free], rotor)
    key, step = predictor.free[0], 1e-5
    slope = predictor.slopes(segment)[0]
    more, less = (predictor.predict(segment, {key: at[free] + sign * step}) for sign in (1, -1))
    for part in ("specific_force", "angular_acceleration", "rate"):
        expected = (getattr(more, part) - getattr(less, part)) / (2 * step)
        np.testing.assert_allclose(getattr(slope, part), expected, rtol=1e-4, atol=1e-5)


def test_a_faulty_speed_sensor_is_undone_before_the_model_sees_it(segment, arpl_250g):
    import dataclasses

    halved = dataclasses.replace(segment, rotor_speed=segment.rotor_speed * np.array([1, 1, 0.5, 1]))
    healed = make(arpl_250g, "rotor_speed_fault", {"gain": 0.5}, rotor=2).predict(halved)
    plain = Predictor(arpl_250g, [], CATALOGUE, speed_measured=True).predict(segment)
    np.testing.assert_allclose(healed.specific_force, plain.specific_force, rtol=1e-9)


def test_a_late_pose_shows_the_force_of_before(segment, arpl_250g):
    late = make(arpl_250g, "time_delay", {"delay": 0.05}).predict(segment)
    plain = Predictor(arpl_250g, [], CATALOGUE, speed_measured=True).predict(segment)
    np.testing.assert_allclose(late.attitude_rate(segment)[5:], plain.rate[:-5], atol=1e-9)
    np.testing.assert_allclose(late.specific_force, plain.specific_force)


def test_late_rotor_speeds_show_the_thrust_of_before(segment, arpl_250g):
    late = make(arpl_250g, "rotor_delay", {"delay": 0.05}).predict(segment)
    plain = Predictor(arpl_250g, [], CATALOGUE, speed_measured=True).predict(segment)
    np.testing.assert_allclose(late.specific_force[5:-10], plain.specific_force[10:-5], atol=1e-9)
    np.testing.assert_allclose(late.rate, plain.rate)


def test_where_commands_are_all_there_is_their_gain_is_no_candidate_but_every_other_effect_is(plain_flights, arpl_250g):
    from tests.diagnosis.conftest import with_columns

    without = {f"rotor_speed_{i}": None for i in range(4)}
    of_speeds = {"gust", "rotor_speed_fault", "rotor_delay", "thrust_constant", "thrust_exponent"}
    part = segments(with_columns(plain_flights[0], without), arpl_250g)[0]
    names = {c.effect.name for c in make_candidates(arpl_250g, CATALOGUE, [part])}
    assert names == set(CATALOGUE) - {*of_speeds, "mass"}
    with_drag = arpl_250g.with_effects(EffectUse("linear_drag", {"coefficient": 0.1}))
    names = {c.effect.name for c in make_candidates(with_drag, CATALOGUE, [part])}
    assert names == set(CATALOGUE) - of_speeds
    assert part.rotor_source == "command"


def test_channels_of_a_flight_that_hides_nothing_are_small(segment, arpl_250g):
    rows = channels.residual(segment, Predictor(arpl_250g, [], CATALOGUE, speed_measured=True).predict(segment))
    errors = channels.norms([rows])
    assert errors["imu"] < 0.2
    assert errors["mocap"] < 0.3
    assert errors["attitude_rate"] < 0.05


def test_models_share_the_hidden_states_that_are_the_same(segment, arpl_250g):
    def rotors(*uses):
        predictor = Predictor(
            arpl_250g, [EffectUse("motor_lag", {"time_constant": 0.04}), *uses], CATALOGUE, speed_measured=False
        )
        return predictor.states(segment)[:, predictor.model.rotor_speed_places[-1]]

    alone = rotors()
    np.testing.assert_array_equal(rotors(EffectUse("rotor_drag", {"coefficient": 3e-5})), alone)
    halved = rotors(EffectUse("rotor_speed_fault", {"gain": 0.5}, 2))
    np.testing.assert_allclose(halved[500:], alone[500:] * np.array([1, 1, 2, 1]), rtol=1e-6)
