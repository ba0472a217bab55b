"""The trainer that all models share: composite loss of PI-TCN eq. 4 in two stages, best step by validation.

A member of an ensemble is one call of `train` with its own seed. Every `evaluate_every` steps the network is evaluated
on the validation flights and everything is saved; a run that was killed continues from there, bit for bit.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn

from training.config import ModelConfig
from training.data.labelled_rows import RowNames
from training.data.tensors import CollocationTensors, Tensors, with_noise
from training.networks import build_network
from training.non_finite_loss import non_finite_loss
from training.optimiser import StepRule
from training.process_group import join_group, shared, wait_for_all
from training.progress import Run
from training.recipe import Recipe
from training.reports import Report
from training.rollout_loss import RolloutLoss
from training.schedule import Schedule

EVALUATION_BATCH = 8192  # windows


@dataclass(frozen=True, eq=False)
class Task:
    """Training task of one member.

    config, recipe: the model's and the training's definition.
    training, validation: standardised flights.
    collocation: points of the physics-inspired loss, None without it.
    rollout: the loss over several steps, None for one step.
    rows: flight and time of a row, for errors.
    fingerprint: of everything but the seed that determines the result.
    member: its number in the ensemble.
    seed: of weights and batches.
    state_file: where progress is saved, None for nowhere.
    """

    config: ModelConfig
    recipe: Recipe
    training: Tensors
    validation: Tensors
    collocation: CollocationTensors | None
    rollout: RolloutLoss | None
    rows: RowNames
    fingerprint: str
    member: int
    seed: int
    state_file: Path | None = None


@dataclass(frozen=True, eq=False)
class Member:
    """A trained member.

    weights: the best ones.
    validation: their mean squared standardised error.
    best_step: at which they were reached.
    steps: trained in all.
    seconds: of training.
    """

    weights: dict[str, Any]
    validation: float
    best_step: int
    steps: int
    seconds: float


def train(task: Task, report: Callable[[Report], None]) -> Member:
    """Train one member, from its state file if there is one. report: called at every evaluation.

    Raises DataError when the loss is not finite, RequestError when progress cannot be written or read.
    """
    recipe, device = task.recipe, task.training.inputs.device
    rank, size = join_group(device)
    torch.manual_seed(task.seed)
    network = build_network(task.config).to(device)
    schedule = Schedule.of(recipe, len(task.training.ends))
    generator = torch.Generator().manual_seed(task.seed)
    run = Run(network, StepRule(network, recipe), generator, f"{task.fingerprint} {task.seed}")
    if task.state_file is not None and task.state_file.exists():
        run.resume(task.state_file)
    elif task.config.base != "none":
        run.keep_best(evaluate(network, task.validation))  # a residual of zero is the first candidate for the best step
    learner, began = shared(network, size), time.monotonic() - run.seconds
    stopped = run.is_exhausted(recipe.patience) and not run.step < schedule.restart < schedule.steps
    while run.step < schedule.steps and not stopped:
        if schedule.starts_anew(run.step):
            run.rule = StepRule(network, recipe)
            if run.step:  # a stage with another loss has its own best step
                run.best, run.without_better = float("inf"), 0
        network.train()
        chosen = torch.randint(len(task.training.ends), (recipe.batch,), generator=generator)[rank::size]
        loss, physics = _losses(task, learner, chosen.to(device), run, schedule.physics_weight(run.step), (rank, size))
        if not torch.isfinite(loss):
            raise non_finite_loss(task.rows, task.training, chosen, step=run.step, batch=recipe.batch)
        run.rule.clear_gradients()
        loss.backward()  # type: ignore[no-untyped-call]
        rate = schedule.learning_rate(run.step)
        run.rule.step(rate)
        run.step += 1
        if run.step % recipe.evaluate_every and run.step < schedule.steps:
            continue
        validation = evaluate(network, task.validation)
        run.keep_best(validation)
        run.seconds = time.monotonic() - began
        if rank == 0:
            if task.state_file is not None:
                run.save(task.state_file)
            losses = loss.item(), None if physics is None else physics.item()
            report(Report(task.member, run.step, schedule.steps, *losses, validation, run.best, rate))
        stopped = run.is_exhausted(recipe.patience) and not run.step < schedule.restart < schedule.steps
    wait_for_all()
    return Member(run.best_weights, run.best, run.best_step, run.step, run.seconds)


def evaluate(network: nn.Module, data: Tensors) -> float:
    """Mean squared standardised error over all windows. Leaves the network in evaluation mode."""
    network.eval()
    total = 0.0
    with torch.no_grad():
        for ends in torch.split(data.ends, EVALUATION_BATCH):
            total += float((network(data.windows(ends)) - data.targets[ends]).square().sum())
    return total / (6 * len(data.ends))


def _losses(
    task: Task, learner: nn.Module, chosen: Tensor, run: Run, weight: float, share: tuple[int, int]
) -> tuple[Tensor, Tensor | None]:
    """The composite loss of a batch (eq. 4), and its physics-inspired part if there is one."""
    recipe, data = task.recipe, task.training
    if task.rollout is not None:
        return task.rollout.loss(run.network, chosen, run.generator), None
    ends = data.ends[chosen]
    windows, targets = data.windows(ends), data.targets[ends]
    windows = with_noise(windows, task.config.state_inputs, recipe.input_noise, run.generator)
    if task.collocation is None or weight == 0:
        return (learner(windows) - targets).square().mean(), None
    count, pool = recipe.physics_batch, len(task.collocation.windows)
    rows = (torch.arange(count) + run.step * count)[share[0] :: share[1]] % pool
    outputs, physics = task.collocation.loss(learner, windows, rows)
    return (outputs - targets).square().mean() + weight * physics, physics
