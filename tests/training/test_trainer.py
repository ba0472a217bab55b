"""The trainer: interrupted runs continue bit for bit, errors name the flight, planted effects are learned."""

from __future__ import annotations

import dataclasses
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import msgspec
import numpy as np
import pytest
import torch

from dynamics.arrays import Floats
from dynamics.errors import DataError, RequestError
from dynamics.vehicle import Vehicle
from dynamics.vehicle_file import parse_effect
from fixtures.planted import noisy, planted_flights
from tests.training.conftest import EFFECTS, MakePlan
from training.data.labelled_rows import LabelledRows, label_rows
from training.data.logged_flights import Split, read_logged_flights
from training.data.tensors import with_noise
from training.effects_fit import named_effects
from training.models import named_kind
from training.plan import Plan, make_plan
from training.prediction import flight_errors, pooled, predict
from training.recipe import FAST
from training.reports import Report
from training.trainer import Member, Task, train

CPU = torch.device("cpu")
SHORT = {"steps": 60, "batch": 64, "evaluate_every": 10}


class KilledError(Exception):
    """In place of kill -9 between two evaluations."""


def quietly(_: Report) -> None:
    """Nobody watches."""


def killing_at(step: int) -> Callable[[Report], None]:
    def report(progress: Report) -> None:
        if progress.step == step:
            raise KilledError

    return report


def task_of(plan: Plan, state_file: Path | None = None, *, seed: int = 0) -> Task:
    return plan.task(0, seed, device=CPU, state_file=state_file)


def assert_same(one: Member, other: Member) -> None:
    assert (one.validation, one.best_step, one.steps) == (other.validation, other.best_step, other.steps)
    for name, weight in one.weights.items():
        assert torch.equal(weight, other.weights[name])


@pytest.mark.parametrize(
    ("kind", "config", "recipe"),
    [
        (
            "pi_tcn",
            {"batch_norm": True, "dropout": 0.1},
            {"physics_weight": 0.1, "physics_pool": 256, "annealed": True},
        ),
        ("window_mlp", {"history": 4}, {"input_noise": 0.05}),
        ("res_tcn", {}, {"rollout": 3, "input_noise": 0.01}),
    ],
)
@pytest.mark.parametrize("step", [20, pytest.param(50, marks=pytest.mark.slow)])
def test_a_killed_training_continues_bit_for_bit(
    plan_for: MakePlan, tmp_path: Path, kind: str, config: dict[str, object], recipe: dict[str, object], step: int
) -> None:
    plan = plan_for(kind, config=config, **{**SHORT, **recipe})
    uninterrupted = train(task_of(plan), quietly)
    with pytest.raises(KilledError):
        train(task_of(plan, tmp_path / "state"), killing_at(step))
    torch.manual_seed(99)  # another process
    reports: list[Report] = []
    resumed = train(task_of(plan, tmp_path / "state"), reports.append)
    assert_same(resumed, uninterrupted)
    assert reports[0].step == step + 10


def test_progress_of_another_training_is_refused(plan_for: MakePlan, tmp_path: Path) -> None:
    with pytest.raises(KilledError):
        train(task_of(plan_for("pi_mlp", **SHORT), tmp_path / "state"), killing_at(20))
    other = plan_for("pi_mlp", **{**SHORT, "learning_rate": 1e-3})
    with pytest.raises(RequestError, match="is of another training"):
        train(task_of(other, tmp_path / "state"), quietly)
    with pytest.raises(RequestError, match="is of another training"):
        train(task_of(plan_for("pi_mlp", **SHORT), tmp_path / "state", seed=1), quietly)


def test_a_full_disk_is_an_error(plan_for: MakePlan, tmp_path: Path) -> None:
    (tmp_path / "state.part").symlink_to("/dev/full")
    with pytest.raises(RequestError, match=r"cannot write .*state"):
        train(task_of(plan_for("pi_mlp", **SHORT), tmp_path / "state"), quietly)


def test_the_physics_inspired_loss_starts_at_half_of_the_steps_with_a_restart(plan_for: MakePlan) -> None:
    reports: list[Report] = []
    plan = plan_for("pi_tcn", physics_weight=0.5, physics_pool=128, physics_batch=32, **SHORT)
    train(task_of(plan), reports.append)
    assert [report.physics_loss is None for report in reports] == [True] * 3 + [False] * 3
    assert reports[2].learning_rate < 0.1 * reports[3].learning_rate


def test_a_loss_that_is_no_number_names_the_flight(plan_for: MakePlan) -> None:
    plan = plan_for("window_mlp", config={"history": 4}, **SHORT)
    targets = plan.training.targets.copy()
    rows = plan.training.ends[plan.training.flight_of[plan.training.ends] == 1]
    targets[rows, 4] = 1e39  # more than 32 bits hold
    broken = dataclasses.replace(plan, training=dataclasses.replace(plan.training, targets=targets))
    with pytest.raises(
        DataError, match=r"batch 0 \(64 windows\) is not finite: flight_1.parquet at \d+.\d\d s has a va"
    ):
        train(task_of(broken), quietly)


def test_weights_that_diverge_are_an_error_with_the_most_extreme_window(plan_for: MakePlan) -> None:
    plan = plan_for("window_mlp", config={"history": 4}, **{**SHORT, "learning_rate": 1e25, "warm_up": 0.0})
    with pytest.raises(DataError, match=r"the weights diverged; .* is of flight_\d.parquet at"):
        train(task_of(plan), quietly)


def test_training_stops_when_validation_flights_get_no_better(plan_for: MakePlan) -> None:
    recipe = {"steps": 400, "batch": 32, "evaluate_every": 10, "patience": 3, "learning_rate": 0.05}
    member = train(task_of(plan_for("window_mlp", **recipe)), quietly)
    assert member.steps == member.best_step + 30
    assert member.steps < 400


def test_a_residual_that_does_not_help_is_not_kept(plan_for: MakePlan) -> None:
    plan = plan_for("res_tcn", **{**SHORT, "steps": 20, "learning_rate": 1.0, "warm_up": 0.0})
    model = plan.assemble([train(task_of(plan), quietly)], [0], command="")
    for error in model.card.errors:
        assert error.base is not None
        assert error.combined <= error.base


def test_planted_effects_of_a_grey_box_are_fitted_to_their_floor(plan_for: MakePlan, arpl_250g: Vehicle) -> None:
    """The floor is what the model with the planted effects itself leaves."""
    truth = arpl_250g.with_effects(*[parse_effect(text, 4) for text in EFFECTS])
    fitted = plan_for("grey_box", vehicle=named_effects(arpl_250g, [parse_effect(t.split(":")[0], 4) for t in EFFECTS]))
    for use, true in zip(fitted.vehicle.effects, truth.effects, strict=True):
        assert use.parameters == pytest.approx(true.parameters, rel=0.05)
    floor = label_rows(fitted.config, truth, fitted.split.validation)
    lowest, reached = (pooled(flight_errors(data, base_of(data))) for data in (floor, fitted.validation))
    assert reached.combined < 1.02 * lowest.combined
    assert lowest.combined < lowest.nominal / 5


def test_a_planted_drag_is_learned_by_a_network(arpl_250g: Vehicle, tmp_path: Path) -> None:
    """Eight laps, of which the last ones but the slowing down validate: 96 % of the error go, the floor is 99 %."""
    drag = parse_effect("rotor_drag:coefficient=1e-4", 4)
    (flight,) = planted_flights(
        arpl_250g, [drag], seed=2, options=noisy(0.2), manoeuvres=["WarpedEllipse_2:laps=8,ramp=1,speed=0.8"]
    )
    (laps,) = read_logged_flights([flight.to_parquet(tmp_path / "laps.parquet")], dt=0.01)
    (segment,) = laps.segments
    first, last = round(0.65 * len(segment)), round(0.9 * len(segment))
    learned_from, judged = (
        dataclasses.replace(laps, segments=(segment.rows(*rows),)) for rows in ((0, first), (first, last))
    )
    config = msgspec.structs.replace(named_kind("res_tcn").config, network="mlp", history=1, motors="measured")
    recipe = msgspec.structs.replace(FAST, steps=800, evaluate_every=100)
    plan = make_plan(config, recipe, arpl_250g, Split((learned_from,), (judged,), ()), seed=0)
    model = plan.assemble([train(task_of(plan), quietly)], [0], command="")
    truth = label_rows(
        msgspec.structs.replace(plan.config, base="grey_box"), arpl_250g.with_effects(drag), [judged], min_windows=50
    )
    floor = pooled(flight_errors(truth, base_of(truth))).linear
    learned = pooled(flight_errors(plan.validation, predict(model, plan.validation).body)).linear
    untaught = pooled(flight_errors(plan.validation, base_of(plan.validation))).linear
    assert floor < 0.015 * untaught
    assert learned < 0.04 * untaught


def base_of(data: LabelledRows) -> Floats:
    assert data.base is not None
    return data.base[data.ends]


def test_the_same_seed_gives_the_same_weights_and_another_seed_others(plan_for: MakePlan) -> None:
    plan = plan_for("pi_mlp", **SHORT)
    assert_same(train(task_of(plan), quietly), train(task_of(plan), quietly))
    other = train(task_of(plan, seed=1), quietly)
    assert not np.array_equal(
        other.weights["decoder.0.weight"], train(task_of(plan), quietly).weights["decoder.0.weight"]
    )


TOGETHER = """
import sys, torch
from pathlib import Path
from training.plan import make_plan
from training.models import named_kind
from training.recipe import FAST
from training.data.logged_flights import read_logged_flights, split_flights
from training.trainer import train
from training.process_group import leave_group
from dynamics.vehicle_file import read_vehicle
from dynamics.vehicle_file import find_vehicle
import msgspec
torch.set_num_threads(1)
split = split_flights(read_logged_flights(sorted(Path(sys.argv[1]).iterdir()), dt=0.01), validation="flight_3*")
recipe = msgspec.structs.replace(FAST, steps=60, batch=64, evaluate_every=10, optimiser="adam")
plan = make_plan(named_kind("pi_mlp").config, recipe, read_vehicle(find_vehicle("arpl_250g")), split, seed=0)
member = train(plan.task(0, 0, device=torch.device("cpu"), state_file=None), lambda _: None)
if torch.distributed.get_rank() == 0:
    torch.save(member.weights, sys.argv[2])
leave_group()
"""


def test_two_processes_learn_what_one_does(plan_for: MakePlan, folder: Path, tmp_path: Path) -> None:
    script, out = tmp_path / "together.py", tmp_path / "weights.pt"
    script.write_text(TOGETHER)
    command = [sys.executable, "-m", "torch.distributed.run", "--standalone", "--nproc_per_node", "2", str(script)]
    environment = {**os.environ, "PYTHONPATH": str(Path(__file__).parents[2]), "OMP_NUM_THREADS": "1"}
    done = subprocess.run(
        [*command, str(folder), str(out)], env=environment, capture_output=True, text=True, check=False, timeout=250
    )
    assert done.returncode == 0, done.stderr[:2000]
    # Muon makes rounding grow: a gradient that is nearly nothing is a whole step as well
    alone = train(task_of(plan_for("pi_mlp", **SHORT, optimiser="adam")), quietly)
    for name, weight in torch.load(out, weights_only=True).items():
        torch.testing.assert_close(weight, alone.weights[name], rtol=1e-3, atol=1e-4)


def test_noise_falls_on_the_measured_state_and_never_on_the_rotors() -> None:
    windows = torch.zeros(500, 20, 13)
    noisy = with_noise(windows, 9, 0.3, torch.Generator().manual_seed(0))
    assert torch.equal(noisy[:, :, 9:], windows[:, :, 9:])
    assert float(noisy[:, :, :9].std()) == pytest.approx(0.3, rel=0.01)
    assert torch.equal(with_noise(windows, 9, 0.0, torch.Generator()), windows)
