"""The physics-inspired loss: its points are consistent, and the nominal model itself has none of it."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest
from numpy.typing import NDArray

from dynamics import quaternion
from dynamics.vehicle import Vehicle
from dynamics.vehicle_file import parse_effect
from tests.training.conftest import MakePlan
from training.data.collocation import collocation_points
from training.data.features import columns, outputs_from
from training.effects_fit import named_effects
from training.physics import nominal_model
from training.plan import Plan
from training.recipe import PAPER


def states_of(plan: Plan, window_columns: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """States (n, 13) and rotor speeds that have these columns; yaw and position, which no column holds, are any."""
    if plan.config.inputs == "world":
        moving = window_columns[:, :10]
    else:
        down = window_columns[:, 3:6]
        roll, pitch = np.arctan2(-down[:, 1], -down[:, 2]), np.arcsin(down[:, 0])
        zero = np.zeros(len(down))
        turn = quaternion.multiply(
            quaternion.exponential(np.stack([zero, pitch, zero], 1)),
            quaternion.exponential(np.stack([roll, zero, zero], 1)),
        )
        moving = np.hstack([quaternion.rotate(turn, window_columns[:, :3]), turn, window_columns[:, 6:9]])
    motors = window_columns[:, -plan.config.rotors :]
    return np.hstack([np.zeros((len(moving), 3)), moving]), motors


@pytest.mark.parametrize("points", ["plausible", "space"])
@pytest.mark.parametrize("frame", ["body", "world"])
def test_the_physics_inspired_loss_of_the_nominal_model_is_zero(
    plan_for: MakePlan, arpl_250g: Vehicle, points: str, frame: str
) -> None:
    plan = plan_for(
        "pi_tcn",
        config={"inputs": frame, "outputs": frame},
        physics_weight=0.01,
        physics_points=points,
        physics_pool=64,
    )
    assert plan.collocation is not None
    state, speed = states_of(plan, plan.collocation.windows[:, -1])
    nominal = nominal_model(arpl_250g, dt=0.01, label="mean_increment")(state, speed).body
    outputs = outputs_from(plan.config, arpl_250g, nominal, None, state[:, 6:10])
    np.testing.assert_allclose(outputs, plan.collocation.targets, atol=1e-6)


def test_histories_of_points_are_motion_of_the_nominal_model(plan_for: MakePlan, arpl_250g: Vehicle) -> None:
    plan = plan_for("pi_tcn", physics_weight=0.01, physics_pool=32)
    assert plan.collocation is not None
    for points, tolerance in ((plan.collocation.windows, 1e-9), (space_points(plan, arpl_250g), 2e-3)):
        state, speed = states_of(plan, points[:, 7])
        after = nominal_model(arpl_250g, dt=0.01, label="mean_increment")(state, speed).following
        again = columns(plan.config, after, points[:, 8, -4:])
        np.testing.assert_allclose(again, points[:, 8], atol=tolerance)


def space_points(plan: Plan, vehicle: Vehicle) -> NDArray[np.float64]:
    recipe = msgspec.structs.replace(PAPER, physics_pool=32)
    return collocation_points(plan.config, recipe, vehicle, plan.training, seed=0).windows


def test_points_of_the_whole_space_lie_far_from_the_flights_and_plausible_ones_near(
    plan_for: MakePlan, arpl_250g: Vehicle
) -> None:
    plan = plan_for("pi_tcn", physics_weight=0.01, physics_pool=256)
    assert plan.collocation is not None
    recorded = plan.training.nominal[:, 3:].std()
    paper = collocation_points(plan.config, PAPER, arpl_250g, plan.training, seed=0)
    assert paper.targets[:, 3:].std() > 5 * recorded
    assert 0.7 * recorded < plan.collocation.targets[:, 3:].std() < 2 * recorded


def test_the_same_seed_draws_the_same_points(plan_for: MakePlan) -> None:
    one, same, other = (
        plan_for("pi_mlp", physics_weight=0.01, physics_pool=16, seed=seed).collocation for seed in (1, 1, 2)
    )
    assert one is not None
    assert same is not None
    assert other is not None
    np.testing.assert_array_equal(one.windows, same.windows)
    assert not np.array_equal(one.windows, other.windows)


def with_effect(vehicle: Vehicle, name: str) -> Vehicle:
    return named_effects(vehicle, [parse_effect(name, 4)])


def test_a_pulse_changes_motors_while_it_lasts_and_motion_from_then_on(plan_for: MakePlan, arpl_250g: Vehicle) -> None:
    plan = plan_for(
        "grey_box",
        vehicle=with_effect(arpl_250g, "motor_lag"),
        physics_weight=1.0,
        physics_points="pulses",
        physics_pool=64,
    )
    assert plan.collocation is not None
    assert plan.collocation.unperturbed is not None
    np.testing.assert_allclose(plan.collocation.targets, 0, atol=1e-9)  # of a residual on what has answered
    changed = plan.collocation.windows - plan.collocation.unperturbed
    pulsed = np.abs(changed[:, :, -4:]).max(axis=2) > 1e-9
    begin = pulsed.argmax(axis=1)
    for window, first in zip(changed, begin, strict=True):
        np.testing.assert_allclose(window[: first + 1, :9], 0, atol=1e-9)
    early = begin < 10
    assert early.any()
    assert (np.abs(changed[early, -1, 6:9]).max(axis=1) > 1e-6).all()


def test_a_pulse_turns_the_vehicle_as_its_rotors_stand(plan_for: MakePlan, arpl_250g: Vehicle) -> None:
    plan = plan_for(
        "grey_box",
        vehicle=with_effect(arpl_250g, "rotor_drag"),
        physics_weight=1.0,
        physics_points="pulses",
        physics_pool=256,
    )
    assert plan.collocation is not None
    assert plan.collocation.unperturbed is not None
    changed, unperturbed = plan.collocation.windows - plan.collocation.unperturbed, plan.collocation.unperturbed
    late = np.abs(changed[:, :16, -4:]).max(axis=(1, 2)) < 1e-9  # no time for anything else to follow
    thrust = ((2 * unperturbed + changed) * changed)[late, :-1, -4:].sum(axis=1)
    leverage = np.array(arpl_250g.rotors.position)[:, 1]
    assert np.corrcoef(thrust @ leverage, changed[late, -1, 6])[0, 1] > 0.98


def test_a_network_by_itself_is_taught_what_physics_answers_to_a_pulse(plan_for: MakePlan, arpl_250g: Vehicle) -> None:
    plan = plan_for("pi_tcn", vehicle=arpl_250g, physics_weight=1.0, physics_points="pulses", physics_pool=256)
    without_lag = collocation_points(plan.config, plan.recipe, arpl_250g, plan.training, seed=0)
    assert plan.collocation is not None
    for points in (without_lag, plan.collocation):
        assert points.unperturbed is not None
        changed, unperturbed = points.windows - points.unperturbed, points.unperturbed
        squares = ((2 * unperturbed + changed) * changed)[:, :, -4:]
        lift = arpl_250g.rotors.thrust_constant * squares.sum(axis=2) / arpl_250g.body.mass
        if points is without_lag:  # at once, and what is past is past
            np.testing.assert_allclose(points.targets[:, 2], lift[:, -1], atol=0.02 * np.abs(lift).max())
        else:  # with the lag that these flights show
            late = np.abs(lift[:, -2:]).max(axis=1) > 0.5 * np.abs(lift).max(axis=1)
            share = np.abs(points.targets[late, 2]).mean() / np.abs(lift[late, -1]).mean()
            assert 0.1 < share < 0.9


def test_kept_effects_are_not_fitted_for_pulses_either(plan_for: MakePlan, arpl_250g: Vehicle) -> None:
    recipe = {"physics_weight": 1.0, "physics_points": "pulses", "physics_pool": 64}
    plan = plan_for("pi_tcn", vehicle=arpl_250g, fit=False, **recipe)
    as_in_file = collocation_points(plan.config, plan.recipe, arpl_250g, plan.training, seed=0)
    assert plan.collocation is not None
    np.testing.assert_array_equal(plan.collocation.targets, as_in_file.targets)
