"""Multi-step training: kinematics are those of `dynamics`, and one step of a roll-out is the one-step loss."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from dynamics.errors import RequestError
from tests.training.conftest import MakePlan
from training.data.features import columns
from training.data.tensors import Tensors
from training.networks import build_network
from training.plan import Plan
from training.rollout_loss import RolloutLoss

CPU = torch.device("cpu")
FRAMES = [{"inputs": "body", "outputs": "body"}, {"inputs": "world", "outputs": "world"}]


def rollout_loss_of(plan: Plan, steps: int) -> RolloutLoss:
    tensors = Tensors.of(plan.training, plan.scaling, plan.config.history, CPU)
    return RolloutLoss.of(plan.config, plan.vehicle, plan.training, tensors, plan.scaling, steps, 0.0)


@pytest.mark.parametrize("kind", ["mse_tcn", "window_mlp", "res_tcn"])
@pytest.mark.parametrize("frame", FRAMES)
def test_a_roll_out_of_one_step_is_the_one_step_loss(plan_for: MakePlan, kind: str, frame: dict[str, str]) -> None:
    config = frame if kind != "res_tcn" else {"inputs": frame["inputs"]}
    plan = plan_for(kind, config=config)
    rollout = rollout_loss_of(plan, 1)
    torch.manual_seed(0)
    network = build_network(plan.config)
    for weight in network.parameters():
        torch.nn.init.normal_(weight, std=0.2)
    chosen = torch.arange(50)
    rows = torch.from_numpy(plan.training.ends)[:50]
    tensors = rollout.tensors
    plain = (network(tensors.windows(rows)) - tensors.targets[rows]).square().mean()
    loss = rollout.loss(network, chosen, torch.Generator())
    torch.testing.assert_close(loss, plain, rtol=1e-3, atol=1e-4)


@pytest.mark.parametrize("frame", FRAMES)
def test_columns_of_predicted_states_are_those_of_recorded_ones(plan_for: MakePlan, frame: dict[str, str]) -> None:
    plan = plan_for("mse_tcn", config=frame)
    rollout, data = rollout_loss_of(plan, 2), plan.training
    predicted = rollout._column(rollout.state[:40], rollout.tensors.inputs[:40])
    recorded = (columns(plan.config, data.state[:40], data.rotor_speed[:40]) - plan.scaling.input_mean) / (
        plan.scaling.input_std
    )
    np.testing.assert_allclose(predicted.numpy(), recorded, atol=1e-4)


def test_roll_outs_begin_only_where_all_their_steps_have_labels(plan_for: MakePlan) -> None:
    plan = plan_for("mse_tcn")
    starts, ends = rollout_loss_of(plan, 30).starts.numpy(), plan.training.ends
    assert len(starts) == len(ends) - 29 * len(plan.training.flights)
    for step in range(30):
        assert np.isin(starts + step, ends).all()


def test_roll_outs_that_make_no_sense_are_refused(plan_for: MakePlan) -> None:
    for config, recipe in (({"batch_norm": True}, {}), ({}, {"physics_weight": 0.1, "physics_pool": 16})):
        with pytest.raises(RequestError, match="roll-outs are for causal inputs"):
            plan_for("pi_tcn", config=config, rollout=5, **recipe)
