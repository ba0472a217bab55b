"""The nominal model and a grey box over rows: the same numbers as the model itself, called row by row."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from dynamics import quaternion
from dynamics.integrators import step_function
from dynamics.model import ENVIRONMENT_DEFAULT, build_model
from dynamics.vehicle import GRAVITY, EffectUse, Vehicle
from dynamics.vehicle_file import parse_effect
from training.config import Label
from training.data.features import body_accelerations, world_accelerations
from training.physics import BLOCK, RowModel

USES = [parse_effect(text, 4) for text in ("motor_lag:time_constant=0.04", "rotor_drag:coefficient=4e-5")]


def some_rows(vehicle: Vehicle, count: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    random = np.random.default_rng(2)
    attitude = quaternion.normalise(random.normal(size=(count, 4)))
    state = np.hstack([random.normal(size=(count, 6)), attitude, random.normal(size=(count, 3))])
    return state, vehicle.hover_speed * random.uniform(0.7, 1.3, (count, 4))


@pytest.mark.parametrize("uses", [[], USES])
def test_increments_are_those_of_one_integrator_step_with_hidden_states_carried_on(
    arpl_250g: Vehicle, uses: list[EffectUse]
) -> None:
    state, speed = some_rows(arpl_250g, 2 * BLOCK + 3)
    rows = RowModel(arpl_250g, uses, dt=0.01, label="mean_increment", motors="command")(state, speed)
    model = build_model(arpl_250g, effects=uses)
    step = step_function(model)
    hidden = speed[0] if uses else np.zeros(0)
    noise = np.zeros(model.hidden_count)
    for x, u, body, following in zip(state, speed, rows.body, rows.following, strict=True):
        after = np.array(
            step(np.concatenate([x, hidden]), u, model.parameter_values, ENVIRONMENT_DEFAULT, noise, 0.01)
        ).ravel()
        hidden = after[13:]
        np.testing.assert_allclose(following, after[:13], rtol=0, atol=1e-10)
        force = quaternion.rotate_inverse(x[6:10], (after[3:6] - x[3:6]) / 0.01 + [0, 0, GRAVITY])
        np.testing.assert_allclose(body, [*force, *(after[10:13] - x[10:13]) / 0.01], rtol=0, atol=1e-8)


def test_instantaneous_accelerations_are_the_models_own(arpl_250g: Vehicle) -> None:
    state, speed = some_rows(arpl_250g, 5)
    rows = RowModel(arpl_250g, USES[1:], dt=0.01, label="instantaneous", motors="command")(state, speed)
    model = build_model(arpl_250g, effects=USES[1:])
    for x, u, body in zip(state, speed, rows.body, strict=True):
        force, angular, _ = model.observe(x, u, model.parameter_values, ENVIRONMENT_DEFAULT)
        np.testing.assert_allclose(body, np.array([*force.full().ravel(), *angular.full().ravel()]), atol=1e-12)


def test_measured_rotor_speeds_have_no_lag_left(arpl_250g: Vehicle) -> None:
    state, speed = some_rows(arpl_250g, 9)

    def bodies(uses: list[EffectUse]) -> NDArray[np.float64]:
        label: Label = "mean_increment"
        return RowModel(arpl_250g, uses, dt=0.01, label=label, motors="measured")(state, speed).body

    np.testing.assert_array_equal(bodies(USES), bodies(USES[1:]))


def test_body_and_world_accelerations_are_each_others_inverse(arpl_250g: Vehicle) -> None:
    state, _ = some_rows(arpl_250g, 20)
    world = np.random.default_rng(0).normal(size=(20, 6))
    there = body_accelerations(world, state[:, 6:10])
    np.testing.assert_allclose(world_accelerations(there, state[:, 6:10]), world, atol=1e-12)
    at_rest = body_accelerations(np.zeros((1, 6)), np.array([[1.0, 0.0, 0.0, 0.0]]))
    np.testing.assert_allclose(at_rest, [[0, 0, GRAVITY, 0, 0, 0]])
