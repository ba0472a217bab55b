"""Integration: the order of the method, the length of the quaternion, substeps and noise."""

import casadi as ca
import numpy as np
import pytest
from numpy.testing import assert_allclose

from dynamics import quaternion
from dynamics.integrators import exponential_step, relaxation_of, relaxes_alone, rk4, rk4_driven, step_function
from dynamics.model import ENVIRONMENT_DEFAULT, build_model
from dynamics.vehicle import EffectUse

EFFECTS = [EffectUse("motor_lag", {"time_constant": 0.04}), EffectUse("parasitic_drag", {"coefficient": 0.01})]
START = np.array([0.0, 0.0, 1.0, 2.0, -1.0, 0.5, 0.8, 0.3, -0.4, 0.33166247903554, 3.0, -2.0, 1.0])
SPEED = np.array([1100.0, 1150.0, 1200.0, 1250.0])


def flown(model, duration, steps, substeps=1):
    """The state after a duration in a number of steps."""
    step = step_function(model, substeps=substeps)
    state, dt = model.initial_state(START), duration / steps
    for _ in range(steps):
        state = np.array(step(state, SPEED, model.parameter_values, ENVIRONMENT_DEFAULT, 0, dt)).ravel()
    return state


def test_rk4_of_an_exponential_is_its_series_to_the_fourth_order():
    h = 0.3
    assert rk4(lambda x: x, 1.0, h) == pytest.approx(1 + h + h**2 / 2 + h**3 / 6 + h**4 / 24)


def test_halving_the_step_divides_the_error_by_sixteen(arpl_250g):
    model = build_model(arpl_250g, effects=EFFECTS)
    exact = flown(model, 0.4, 1280)
    errors = np.array([np.linalg.norm(flown(model, 0.4, steps) - exact) for steps in (20, 40, 80)])
    order = np.log2(errors[:-1] / errors[1:])
    assert np.all(order > 3.8)
    assert np.all(order < 4.4)


def test_the_attitude_stays_of_unit_length_through_a_long_tumble(arpl_250g):
    model = build_model(arpl_250g, effects=[])
    step = step_function(model)
    state = START.copy()
    state[10:13] = [30.0, -20.0, 10.0]
    for _ in range(1000):
        state = np.array(step(state, np.zeros(4), model.parameter_values, ENVIRONMENT_DEFAULT, 0, 0.01)).ravel()
        assert np.linalg.norm(state[6:10]) == pytest.approx(1.0, abs=1e-14)


def test_a_steady_spin_turns_by_rate_times_time(arpl_250g):
    model = build_model(arpl_250g, effects=[])
    step = step_function(model, substeps=4)
    state = np.array([0, 0, 1, 0, 0, 0, 1.0, 0, 0, 0, 0, 0, 2.0])
    hover = np.full(4, arpl_250g.hover_speed)
    for _ in range(100):
        state = np.array(step(state, hover, model.parameter_values, ENVIRONMENT_DEFAULT, 0, 0.01)).ravel()
    assert quaternion.angle_between(state[6:10], quaternion.from_euler(0, 0, 2.0)) < 1e-7
    assert_allclose(state[:6], [0, 0, 1, 0, 0, 0], atol=1e-9)


def test_substeps_are_shorter_steps(arpl_250g):
    model = build_model(arpl_250g, effects=EFFECTS)
    assert_allclose(flown(model, 0.2, 10, substeps=4), flown(model, 0.2, 40), atol=1e-8)


def test_noise_moves_only_the_hidden_states_that_have_it(arpl_250g):
    model = build_model(arpl_250g, effects=[EffectUse("gust", {"intensity": 1.0, "correlation_time": 1.0})])
    step = step_function(model)
    hover = np.full(4, arpl_250g.hover_speed)
    arguments = (model.initial_state(START), hover, model.parameter_values, ENVIRONMENT_DEFAULT)
    moved = np.array(step(*arguments, np.ones(3), 0.01) - step(*arguments, np.zeros(3), 0.01)).ravel()
    assert_allclose(moved[13:], np.sqrt(2) * np.array([1, 1, 0.5]) * 0.01, rtol=0.01)


def relaxed(lag, dt, steps, before=0.0):
    """A first-order lag behind a ramp of 1 a second from rest, at the end of each step."""
    x, at = ca.SX.sym("x"), ca.SX.sym("at")
    after = exponential_step(lambda state, share: (at + share * dt - state) / lag, x, ca.SX(-1 / lag), dt)
    step = ca.Function("step", [x, at], [after])
    values = [before]
    for i in range(steps):
        values.append(float(step(values[-1], i * dt)))
    return np.array(values)


@pytest.mark.parametrize("lag", [1e-4, 0.002, 0.01, 0.1, 10.0])
def test_a_lag_of_any_length_follows_a_ramp_exactly(lag):
    time = 0.02 * np.arange(20)
    assert_allclose(relaxed(lag, 0.02, 19), time - lag * (1 - np.exp(-time / lag)), atol=1e-12)


def test_without_relaxation_the_exponential_step_is_the_classical_one():
    x, dt = ca.SX.sym("x", 2), 0.1

    def field(state, share):
        return ca.vertcat(ca.sin(state[1]) + share, state[0] * state[1])

    steps = [exponential_step(field, x, ca.SX.zeros(2), dt), rk4_driven(field, x, dt)]
    mine, classical = ca.Function("steps", [x], steps)([0.3, -0.8])
    assert_allclose(np.array(mine), np.array(classical), atol=1e-14)


def test_states_that_relax_are_recognised_and_those_that_do_so_alone():
    h, p = ca.SX.sym("h", 4), ca.SX.sym("p")
    derivative = ca.vertcat((p - h[0]) / p, h[2], -h[1] - h[2], -(h[3] ** 2))
    rates = ca.Function("rates", [h, p], [relaxation_of(derivative, h)])([0.1, 0.2, 0.3, 0.4], 0.5)
    assert_allclose(np.array(rates).ravel(), [-2.0, 0.0, -1.0, 0.0])
    assert [relaxes_alone(derivative, h, slice(i, i + 1)) for i in range(4)] == [True, False, False, False]
