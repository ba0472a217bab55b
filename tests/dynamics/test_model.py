"""The rigid body and its rotors: conservation laws, equilibria, and equation 2 for any layout."""

import msgspec
import numpy as np
import pytest
from numpy.testing import assert_allclose

from dynamics import quaternion
from dynamics.effects import CATALOGUE
from dynamics.errors import RequestError
from dynamics.integrators import step_function
from dynamics.model import ENVIRONMENT_DEFAULT, build_model
from dynamics.vehicle import GRAVITY, Body, EffectUse, Rotors, Vehicle

LEVEL = np.array([0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])


def hexarotor():
    """Six rotors on a ring, one arm higher, with the centre of mass off the middle."""
    angle = np.pi / 3 * np.arange(6)
    position = np.column_stack([0.3 * np.cos(angle), 0.3 * np.sin(angle), 0.02 * (angle > 3)])
    return Vehicle(
        name="hexarotor",
        body=Body(1.5, (0.02, 0.021, 0.035), centre_of_mass=(0.01, -0.02, 0.005)),
        rotors=Rotors(tuple(map(tuple, position.tolist())), (1, -1) * 3, 1e-5, 2e-7, speed_max=900.0),
    )


def derivative(model, state, speed, parameters=None):
    """Time derivative of the state."""
    p = model.parameter_values if parameters is None else parameters
    return np.array(model.derivative(state, speed, p, ENVIRONMENT_DEFAULT, 0)).ravel()


def flown(model, state, speed, *, duration, dt=1e-3):
    """The state after some time at constant rotor speeds."""
    step = step_function(model)
    for _ in range(round(duration / dt)):
        state = np.array(step(state, speed, model.parameter_values, ENVIRONMENT_DEFAULT, 0, dt)).ravel()
    return state


def tumbling(seed):
    """A random rigid-body state far from level."""
    random = np.random.default_rng(seed)
    attitude = quaternion.normalise(random.normal(size=4))
    return np.concatenate([random.normal(size=6), attitude, random.normal(scale=5.0, size=3)])


def test_without_thrust_the_vehicle_falls_and_its_accelerometer_reads_nothing(arpl_250g):
    model = build_model(arpl_250g)
    specific_force, _, _ = model.observe(tumbling(0), np.zeros(4), model.parameter_values, ENVIRONMENT_DEFAULT)
    assert_allclose(specific_force, 0.0)
    after = flown(model, LEVEL, np.zeros(4), duration=0.5, dt=0.01)
    assert_allclose(after[:6], [0, 0, 1 - GRAVITY / 8, 0, 0, -GRAVITY / 2], atol=1e-12)


@pytest.mark.parametrize("yaw", [0.0, 2.0])
def test_hover_is_an_equilibrium_at_any_heading(arpl_250g, yaw):
    state = LEVEL.copy()
    state[6:10] = quaternion.from_euler(0, 0, yaw)
    model = build_model(arpl_250g)
    assert_allclose(derivative(model, state, np.full(4, arpl_250g.hover_speed)), 0.0, atol=1e-12)


@pytest.mark.parametrize("name", sorted({*CATALOGUE} - {"weak_rotor"}))
def test_hidden_states_rest_in_hover(arpl_250g, name):
    model = build_model(arpl_250g, effects=[EffectUse(name)])
    state = model.initial_state(LEVEL)
    rates = derivative(model, state, np.full(4, arpl_250g.hover_speed))
    assert model.state_count == state.size == rates.size
    assert model.hidden_count == state.size - 13
    assert_allclose(rates[13:], 0.0, atol=1e-12)


@pytest.mark.parametrize("seed", range(3))
def test_free_rotation_conserves_energy_and_angular_momentum(arpl_250g, seed):
    model = build_model(arpl_250g)
    inertia = np.array(arpl_250g.body.inertia)
    before = tumbling(seed)
    after = flown(model, before, np.zeros(4), duration=1.0)

    def energy(state):
        rotation = 0.5 * state[10:13] @ (inertia * state[10:13])
        return rotation + arpl_250g.body.mass * (0.5 * state[3:6] @ state[3:6] + GRAVITY * state[2])

    def angular_momentum(state):
        return quaternion.rotate(state[6:10], inertia * state[10:13])

    assert quaternion.angle_between(before[6:10], after[6:10]) > 0.1
    assert energy(after) == pytest.approx(energy(before), rel=1e-8)
    assert_allclose(angular_momentum(after), angular_momentum(before), rtol=1e-6, atol=1e-9)


def test_the_rotors_wrench_is_the_papers_equation_2(arpl_250g):
    speed = np.array([1000.0, 1100.0, 1200.0, 1300.0])
    s0, s1, s2, s3 = speed**2
    k_f, k_tau, arm = arpl_250g.rotors.thrust_constant, arpl_250g.rotors.torque_constant, 0.076
    torque = [k_f * arm * (s0 + s1 - s2 - s3), k_f * arm * (-s0 + s1 + s2 - s3), k_tau * (s0 - s1 + s2 - s3)]
    model = build_model(arpl_250g)
    specific, angular, _ = model.observe(LEVEL, speed, model.parameter_values, ENVIRONMENT_DEFAULT)
    assert_allclose(np.array(specific).ravel(), [0, 0, k_f * (s0 + s1 + s2 + s3) / 0.25])
    assert_allclose(np.array(angular).ravel(), np.array(torque) / arpl_250g.body.inertia)


def test_a_hexarotors_wrench_is_the_sum_of_levers_times_thrusts():
    vehicle = hexarotor()
    speed = np.random.default_rng(3).uniform(300, 900, 6)
    thrust = np.column_stack([np.zeros((6, 2)), vehicle.rotors.thrust_constant * speed**2])
    arms = np.array(vehicle.rotors.position) - vehicle.body.centre_of_mass
    torque = np.cross(arms, thrust).sum(axis=0)
    torque[2] += vehicle.rotors.torque_constant * np.array(vehicle.rotors.spin) @ speed**2
    state = tumbling(1)
    inertia, rate = np.array(vehicle.body.inertia), state[10:13]
    expected = (torque - np.cross(rate, inertia * rate)) / inertia
    model = build_model(vehicle)
    specific, angular, real = model.observe(state, speed, model.parameter_values, ENVIRONMENT_DEFAULT)
    assert_allclose(np.array(angular).ravel(), expected, rtol=1e-10)
    assert_allclose(np.array(specific).ravel(), thrust.sum(axis=0) / 1.5)
    assert_allclose(np.array(real).ravel(), speed)
    acceleration = derivative(model, state, speed)[3:6]
    assert_allclose(acceleration, quaternion.rotate(state[6:10], thrust.sum(axis=0) / 1.5) - [0, 0, GRAVITY])


def test_positive_roll_torque_lifts_the_left_side_and_positive_pitch_drops_the_nose(arpl_250g):
    model = build_model(arpl_250g)
    hover = arpl_250g.hover_speed
    left_faster = flown(model, LEVEL, hover + np.array([20, 20, -20, -20]), duration=0.1)
    assert quaternion.rotate(left_faster[6:10], [0, 1, 0])[2] > 0.01
    back_faster = flown(model, LEVEL, hover + np.array([-20, 20, 20, -20]), duration=0.1)
    assert quaternion.rotate(back_faster[6:10], [1, 0, 0])[2] < -0.01


def test_one_function_serves_every_vehicle_with_as_many_rotors(arpl_250g):
    effects = [EffectUse("rotor_drag", {"coefficient": 1e-5})]
    model = build_model(arpl_250g, effects=effects)
    other = msgspec.structs.replace(arpl_250g, body=Body(0.4, (1e-3, 1.1e-3, 1.5e-3), (0.01, 0.0, 0.0)))
    stronger = build_model(other, effects=[EffectUse("rotor_drag", {"coefficient": 5e-5})])
    state, speed = tumbling(2), np.array([1000.0, 1100.0, 1200.0, 1300.0])
    assert_allclose(derivative(model, state, speed, stronger.parameter_values), derivative(stronger, state, speed))
    changed = model.parameter_values.copy()
    changed[model.parameter_index("body.mass")] *= 2
    assert derivative(model, state, speed, changed)[2] == state[5]
    assert not np.allclose(derivative(model, state, speed, changed)[3:6], derivative(model, state, speed)[3:6])


def test_a_model_takes_the_files_effects_unless_it_is_given_others(arpl_250g):
    vehicle = arpl_250g.with_effects(EffectUse("rotor_drag"), EffectUse("motor_lag"))
    assert [item.key for item in build_model(vehicle).effects] == ["rotor_drag", "motor_lag"]
    assert build_model(vehicle, effects=[]).effects == ()


def test_an_effect_given_twice_is_refused(arpl_250g):
    with pytest.raises(RequestError, match="rotor_drag is given twice"):
        build_model(arpl_250g, effects=[EffectUse("rotor_drag"), EffectUse("rotor_drag", {"coefficient": 1e-5})])


def test_mass_and_thrust_constants_are_those_with_the_effects_on(arpl_250g):
    effects = [EffectUse("mass", {"ratio": 1.2}), EffectUse("weak_rotor", {"loss": 0.25}, 2)]
    model = build_model(arpl_250g, effects=effects)
    assert model.mass == pytest.approx(0.3)
    assert_allclose(model.thrust_constants, arpl_250g.rotors.thrust_constant * np.array([1, 1, 0.75, 1]))
