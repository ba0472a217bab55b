"""The bundled models: what they predict stays the same, whatever format their files are in."""

from __future__ import annotations

import json
from pathlib import Path

import msgspec
import numpy as np
import pytest
import torch

from dynamics import quaternion
from dynamics.arrays import Floats
from dynamics.units import RPM
from training.checkpoint import TrainedModel, load
from training.data.features import columns
from vehicles import FOLDER

KINDS = ("grey_box", "mse_tcn", "pi_mlp", "pi_tcn", "res_tcn")
PREDICTIONS = Path(__file__).parents[1] / "data" / "shipped_predictions.json"  # of the files as they were trained


def brisk_windows(model: TrainedModel) -> Floats:
    """(4, T, inputs) columns of made-up brisk motion."""
    row = np.arange(4.0 * model.config.history).reshape(4, -1, 1)
    wave = np.sin(0.07 * row + np.arange(14.0))
    attitude = quaternion.normalise([1.0, 0.0, 0.0, 0.0] + 0.3 * wave[..., 3:7])
    state = np.concatenate([0 * wave[..., :3], 3 * wave[..., :3], attitude, 2 * wave[..., 7:10]], axis=-1)
    return columns(model.config, state, 1200 + 300 * wave[..., 10:])


@pytest.mark.parametrize("kind", KINDS)
def test_bundled_models_predict_what_they_did_when_they_were_trained(kind: str) -> None:
    model = load(FOLDER / f"arpl_250g.{kind}.pt")
    trained = np.array(json.loads(PREDICTIONS.read_text())[kind])
    error = (model.outputs(brisk_windows(model)) - trained) / model.scaling.output_std
    assert np.abs(error).max() < 1e-5 * np.abs(trained / model.scaling.output_std).max()


def in_kilo_rpm(path: Path, target: Path) -> Path:
    """A checkpoint as version 1 wrote it."""
    content = torch.load(path, weights_only=True)
    card = msgspec.json.decode(content["card"])
    for name, limits in card["ranges"].items():
        if name.startswith("motor"):
            card["ranges"][name] = [limit / (1000 * RPM) for limit in limits]
    for part, names in (("scaling", ("input_mean", "input_std")), ("ranges", ("lowest", "highest"))):
        for name in names:
            content[part][name][-4:] /= 1000 * RPM
    torch.save({**content, "version": 1, "card": msgspec.json.encode(card).decode()}, target)
    return target


@pytest.mark.parametrize("kind", ["grey_box", "pi_mlp"])
def test_a_checkpoint_with_rotor_speeds_in_thousands_of_rpm_predicts_the_same(kind: str, tmp_path: Path) -> None:
    path = FOLDER / f"arpl_250g.{kind}.pt"
    model, old = load(path), load(in_kilo_rpm(path, tmp_path / "old.pt"))
    windows = brisk_windows(model)
    np.testing.assert_allclose(old.outputs(windows), model.outputs(windows), rtol=1e-5, atol=1e-7)
    np.testing.assert_allclose(old.ranges.highest, model.ranges.highest, rtol=1e-12)
    for name, limits in model.card.ranges.items():
        assert old.card.ranges[name] == pytest.approx(limits, rel=1e-12)
    assert model.card.ranges["motor_0"][1] == pytest.approx(1741.3)  # rad/s, the vehicle's highest
