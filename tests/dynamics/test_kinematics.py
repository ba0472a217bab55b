"""The kinematic step and a network's inputs: one definition for arrays, expressions and tensors."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from numpy.testing import assert_allclose

from dynamics import quaternion
from dynamics.arrays import Floats
from dynamics.kinematics import kinematic_step
from dynamics.network_inputs import STATE_INPUTS, Frame, state_inputs
from dynamics.state import ATTITUDE, POSITION, RATE, VELOCITY

DT = 0.01


@pytest.fixture
def states() -> Floats:
    states = np.random.default_rng(0).normal(size=(8, 13))
    states[:, ATTITUDE] = quaternion.normalise(states[:, ATTITUDE])
    return states


@pytest.fixture
def accelerations() -> Floats:
    return np.random.default_rng(1).normal(size=(8, 6))


def test_a_step_is_the_motion_of_a_constant_acceleration(states: Floats, accelerations: Floats) -> None:
    after = kinematic_step(states, accelerations[:, :3], accelerations[:, 3:], DT)
    velocity, rate = states[:, VELOCITY], states[:, RATE]
    assert_allclose(after[:, POSITION], states[:, POSITION] + DT * velocity + DT**2 / 2 * accelerations[:, :3])
    assert_allclose(after[:, VELOCITY], velocity + DT * accelerations[:, :3])
    assert_allclose(after[:, RATE], rate + DT * accelerations[:, 3:])
    turn = quaternion.exponential(DT * (rate + after[:, RATE]) / 2)
    assert_allclose(after[:, ATTITUDE], quaternion.multiply(states[:, ATTITUDE], turn), atol=1e-15)


def test_arrays_expressions_and_tensors_move_alike(states: Floats, accelerations: Floats) -> None:
    torch = pytest.importorskip("torch")
    arguments = states, accelerations[:, :3], accelerations[:, 3:]
    after = kinematic_step(*arguments, DT)
    tensors = kinematic_step(*(torch.from_numpy(argument) for argument in arguments), DT)
    assert_allclose(tensors.numpy(), after, atol=1e-15)
    for row in range(len(states)):
        expression = kinematic_step(*(ca.DM(argument[row]) for argument in arguments), DT)
        assert_allclose(np.array(expression).ravel(), after[row], atol=1e-15)


@pytest.mark.parametrize("frame", ["world", "body"])
def test_arrays_expressions_and_tensors_have_the_same_inputs(states: Floats, frame: Frame) -> None:
    torch = pytest.importorskip("torch")
    inputs = state_inputs(frame, states)
    assert inputs.shape == (8, len(STATE_INPUTS[frame]))
    assert_allclose(state_inputs(frame, torch.from_numpy(states)).numpy(), inputs, atol=1e-15)
    for row in range(len(states)):
        assert_allclose(np.array(state_inputs(frame, ca.DM(states[row]))).ravel(), inputs[row], atol=1e-15)


def test_inputs_in_the_body_frame_do_not_depend_on_yaw(states: Floats) -> None:
    yaw = quaternion.from_euler(0.0, 0.0, 1.2)
    turned = states.copy()
    turned[:, VELOCITY] = quaternion.rotate(yaw, states[:, VELOCITY])
    turned[:, ATTITUDE] = quaternion.multiply(yaw, states[:, ATTITUDE])
    assert_allclose(state_inputs("body", turned), state_inputs("body", states), atol=1e-12)


def test_the_step_of_a_tensor_has_gradients_at_rest() -> None:
    torch = pytest.importorskip("torch")
    state = torch.tensor([[0.0] * 6 + [1.0] + [0.0] * 6])
    acceleration = torch.zeros(1, 6, requires_grad=True)
    kinematic_step(state, acceleration[:, :3], acceleration[:, 3:], DT)[:, 3:].sum().backward()
    assert torch.isfinite(acceleration.grad).all()
    assert_allclose(acceleration.grad.numpy()[0, :3], DT, rtol=1e-6)
