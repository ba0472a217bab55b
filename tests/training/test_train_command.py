"""`alula train`: from a folder of flights to a checkpoint with its card, and what it refuses."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import torch
from typer.testing import CliRunner, Result

from alula.cli.app import app
from dynamics.errors import DataError, RequestError
from training import checkpoint
from training.data.tensors import PAPER_ROTOR_UNIT
from training.folder import claimed
from training.run import TrainOptions, settled

QUICK = ("--steps", "40", "--batch", "64", "--ensemble", "2", "--jobs", "1")


def train(*arguments: object) -> Result:
    result = CliRunner().invoke(app, ["train", *map(str, arguments)])
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    return result


def test_a_folder_of_flights_becomes_a_checkpoint_with_its_card(folder: Path, tmp_path: Path) -> None:
    out = tmp_path / "m.pt"
    curves = tmp_path / "curves"
    done = train(
        folder,
        "--vehicle",
        "arpl_250g",
        "--model",
        "pi_tcn",
        "--out",
        out,
        *QUICK,
        "--tensorboard",
        curves,
    )
    model = checkpoint.load(out)
    card = json.loads((tmp_path / "m.json").read_text())
    assert len(model.networks) == 2
    assert model.reliability is not None
    assert card["kind"] == "pi_tcn"
    assert (card["recipe"]["physics_weight"], card["recipe"]["physics_points"]) == (1.0, "pulses")
    assert set(card["flights"]) | set(card["validation"]) == {f"flight_{place}.parquet" for place in range(4)}
    assert [error["flight"] for error in card["errors"]] == ["flight_2.parquet"]
    assert card["seeds"] == [0, 1]
    assert "flight_2.parquet" in done.output
    assert list(curves.glob("events*"))
    assert sorted(path.name for path in tmp_path.iterdir()) == ["curves", "m.json", "m.progress.jsonl", "m.pt"]
    with pytest.raises(RequestError, match=r"m.pt exists. Give another --out, or --overwrite"):
        train(folder, "--vehicle", "arpl_250g", "--model", "pi_tcn", "--out", out, *QUICK)


def test_a_grey_box_brings_its_fitted_effects_along(folder: Path, tmp_path: Path) -> None:
    out = tmp_path / "g.pt"
    done = train(
        folder,
        "--vehicle",
        "arpl_250g",
        "--model",
        "grey_box",
        "--effect",
        "motor_lag",
        "--effect",
        "rotor_drag",
        "--out",
        out,
        *QUICK,
        "--json",
    )
    card = json.loads(done.stdout)
    model = checkpoint.load(out)
    lag, drag = model.vehicle.effects
    assert lag.parameters["time_constant"] == pytest.approx(0.04, rel=0.05)
    assert drag.parameters["coefficient"] == pytest.approx(6e-5, rel=0.05)
    assert all(error["combined"] < 1.1 * error["base"] for error in card["errors"])
    with pytest.raises(RequestError, match="arpl_250g names no effect"):
        train(folder, "--vehicle", "arpl_250g", "--model", "grey_box", "--out", tmp_path / "h.pt", *QUICK)


def test_a_grey_box_can_stand_on_diagnosed_effects(folder: Path, tmp_path: Path) -> None:
    out = tmp_path / "g.pt"
    how = ("--model", "grey_box", "--effect", "diagnosed", "--validation", "flight_3*")
    done = train(folder, "--vehicle", "arpl_250g", *how, "--out", out, *QUICK, "--json")
    card = json.loads(done.stdout)
    effects = {use.name: use.parameters for use in checkpoint.load(out).vehicle.effects}
    assert list(effects) == ["rotor_drag", "motor_lag"]
    assert effects["rotor_drag"]["coefficient"] == pytest.approx(6e-5, rel=0.05)
    assert effects["motor_lag"]["time_constant"] == pytest.approx(0.04, rel=0.05)
    assert any(
        "effects by diagnosis of 3 flights" in note and "rotor_drag, motor_lag" in note for note in card["notes"]
    )


def test_the_recipe_of_the_paper_is_the_papers(folder: Path, tmp_path: Path) -> None:
    out = tmp_path / "p.pt"
    train(
        folder,
        "--vehicle",
        "arpl_250g",
        "--model",
        "pi_tcn",
        "--recipe",
        "paper",
        "--out",
        out,
        "--steps",
        4,
        "--ensemble",
        1,
    )
    model = checkpoint.load(out)
    assert (model.config.inputs, model.config.label, model.config.batch_norm) == ("world", "instantaneous", True)
    assert (model.config.dropout, model.config.filtered_inputs, model.config.motors) == (0.1, True, "measured")
    recipe = model.card.recipe
    assert (recipe.batch, recipe.physics_batch, recipe.learning_rate) == (1024, 1024, 1e-4)
    assert (recipe.physics_weight, recipe.physics_points, recipe.physics_pool) == (1.0, "space", 1024)
    np.testing.assert_array_equal(model.scaling.input_std, [1.0] * 10 + [PAPER_ROTOR_UNIT] * 4)


@pytest.mark.parametrize(("kind", "outputs"), [("mse_tcn", "world"), ("res_tcn", "wrench")])
def test_the_frame_of_the_inputs_is_that_of_the_outputs_unless_they_are_a_wrench(kind: str, outputs: str) -> None:
    options = TrainOptions((), "arpl_250g", kind, Path("m.pt"), config={"inputs": "world", "history": 10})
    config, _ = settled(options)
    assert (config.inputs, config.outputs) == ("world", outputs)
    assert config.receptive_field <= 10


@pytest.mark.parametrize(
    ("arguments", "error", "message"),
    [
        (("--model", "lstm"), RequestError, "unknown model 'lstm'. Known: nominal, pi_tcn"),
        (("--model", "pi_tcn", "--recipe", "slow"), RequestError, "unknown recipe 'slow'. Known: paper, fast"),
        (
            ("--model", "pi_tcn", "--label", "guess"),
            RequestError,
            "label = guess: required is one of instantaneous",
        ),
        (("--model", "pi_tcn", "--learning-rate", "-1"), RequestError, "learning_rate = -1.0: expected `float` > 0"),
        (
            ("--model", "pi_tcn", "--learning-rate", "inf"),
            RequestError,
            "learning_rate = inf: required is a finite",
        ),
        (("--model", "pi_tcn", "--physics-weight", "inf"), RequestError, "physics_weight = inf: required is a finite"),
        (("--model", "pi_tcn", "--seed", "99999999999999"), RequestError, "seed 99999999999999: required is 0 to"),
        (("--model", "grey_box", "--effect", "warp_drive"), RequestError, "unknown effect 'warp_drive'"),
        (("--model", "pi_tcn", "--tensorboard", "/proc/no"), RequestError, "cannot write to /proc/no"),
        (("--model", "pi_tcn", "--device", "mps"), RequestError, "networks train on a CPU or a CUDA GPU"),
        (("--model", "mse_tcn", "--batch", "1000000000000"), RequestError, "not enough memory for this training"),
        (("--model", "res_tcn", "--physics-weight", "1"), RequestError, "for models without a base"),
        (("--model", "pi_tcn", "--validation", "x*"), RequestError, "matches none"),
        (("--model", "pi_tcn", "--device", "abacus"), RequestError, "unknown device 'abacus'"),
        (("--model", "pi_tcn", "--vehicle", "px4_sih"), DataError, "px4_sih does not fit these flights"),
    ],
)
def test_what_makes_no_sense_is_refused(
    folder: Path, tmp_path: Path, arguments: tuple[str, ...], error: type[Exception], message: str
) -> None:
    command = arguments if "--vehicle" in arguments else ("--vehicle", "arpl_250g", *arguments)
    with pytest.raises(error, match=message):
        train(folder, *command, "--ensemble", 1, "--out", tmp_path / "m.pt")
    assert not list(tmp_path.iterdir())


def test_a_gpu_that_is_not_there_is_refused(folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    with pytest.raises(RequestError, match="--device cuda: torch finds no GPU"):
        train(folder, "--vehicle", "arpl_250g", "--model", "pi_tcn", "--device", "cuda", "--out", tmp_path / "m.pt")


def test_nothing_is_overwritten_and_no_model_gets_a_name_that_other_commands_do_not_know(
    folder: Path, tmp_path: Path
) -> None:
    command = (folder, "--vehicle", "arpl_250g", "--model", "nominal")
    with pytest.raises(RequestError, match=r"m.json: required is a name in .pt"):
        train(*command, "--out", tmp_path / "m.json")  # where its own card would have overwritten it
    (tmp_path / "m.json").write_text("mine")
    with pytest.raises(RequestError, match=r"m.json exists. Give another --out, or --overwrite"):
        train(*command, "--out", tmp_path / "m.pt")
    assert (tmp_path / "m.json").read_text() == "mine"
    train(*command, "--out", tmp_path / "m.pt", "--overwrite")
    assert json.loads((tmp_path / "m.json").read_text())["kind"] == "nominal"


def test_only_one_training_at_a_time_writes_a_model(tmp_path: Path) -> None:
    out, run = tmp_path / "m.pt", tmp_path / "m.pt.run"
    with (
        claimed(out, run, overwrite=False, resume=False),
        pytest.raises(RequestError, match=r"another training is writing .*m.pt now"),
        claimed(out, run, overwrite=False, resume=False),
    ):
        pass
    assert not list(tmp_path.iterdir())


def test_only_states_that_members_can_continue_from_outlive_a_failure(tmp_path: Path) -> None:
    out, run = tmp_path / "m.pt", tmp_path / "m.pt.run"

    def fail(*files: Path) -> None:
        with claimed(out, run, overwrite=True, resume=False):
            for file in files:
                file.touch()
            raise DataError("the loss of batch 3 is not finite")

    with pytest.raises(DataError):
        fail()
    assert not run.exists()
    with pytest.raises(DataError):
        fail(run / "member_0.state", out)  # the latter of an earlier training
    assert (run / "member_0.state").exists()


@pytest.mark.realtime(repeats_only=True)  # repeated where it was starved; it bears company
def test_a_training_that_was_killed_continues_to_the_same_model(folder: Path, tmp_path: Path) -> None:
    command = [sys.executable, "-m", "alula", "train", str(folder), "--vehicle", "arpl_250g", "--model", "pi_mlp",
               "--steps", "1500", "--batch", "64", "--ensemble", "1"]  # fmt: skip
    environment = {**os.environ, "OMP_NUM_THREADS": "1"}
    train(*command[4:], "--out", tmp_path / "whole.pt")
    state = tmp_path / "m.pt.run" / "member_0.state"
    with subprocess.Popen([*command, "--out", str(tmp_path / "m.pt")], env=environment) as killed:
        deadline = time.monotonic() + 250
        while not state.exists():
            assert time.monotonic() < deadline
            assert killed.poll() is None
            time.sleep(0.01)
        killed.send_signal(signal.SIGKILL)
    assert not (tmp_path / "m.pt").exists()
    with pytest.raises(RequestError, match=r"holds a training that did not end. Continue with --resume"):
        train(*command[4:], "--out", tmp_path / "m.pt")
    train(*command[4:], "--out", tmp_path / "m.pt", "--resume")
    one, other = (checkpoint.load(tmp_path / name).networks[0].state_dict() for name in ("whole.pt", "m.pt"))
    assert all(torch.equal(one[name], other[name]) for name in one)
    assert not state.parent.exists()


def test_members_in_processes_of_their_own_are_those_of_one_process(folder: Path, tmp_path: Path) -> None:
    common = (folder, "--vehicle", "arpl_250g", "--model", "pi_mlp", "--steps", 20, "--ensemble", 2)
    train(*common, "--jobs", 1, "--out", tmp_path / "one.pt")
    train(*common, "--jobs", 2, "--out", tmp_path / "two.pt")
    windows = np.random.default_rng(0).normal(size=(9, 1, 13))
    one, two = (checkpoint.load(tmp_path / name).outputs(windows) for name in ("one.pt", "two.pt"))
    np.testing.assert_array_equal(one, two)
