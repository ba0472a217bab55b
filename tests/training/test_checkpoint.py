"""Checkpoints: what was saved is what is loaded, and what cannot be used is refused by name."""

from __future__ import annotations

import pickle
from pathlib import Path

import numpy as np
import pytest
import torch

from dynamics.errors import RequestError
from dynamics.vehicle_file import read_vehicle
from training.card import Card
from training.checkpoint import Ranges, Reliability, Scaling, TrainedModel, load, save
from training.config import ModelConfig
from training.networks import build_network
from training.recipe import FAST
from vehicles import FOLDER


def some_model(config: ModelConfig, *, members: int = 2) -> TrainedModel:
    torch.manual_seed(1)
    inputs = len(config.input_names)
    random = np.random.default_rng(0)
    path = FOLDER / "arpl_250g.toml"
    return TrainedModel(
        config=config,
        networks=tuple(build_network(config).eval() for _ in range(members)),
        scaling=Scaling(random.normal(size=inputs), random.uniform(1, 2, inputs), np.zeros(6), np.full(6, 3.0)),
        ranges=Ranges(np.full(inputs, -1.0), np.full(inputs, 1.0)),
        vehicle=read_vehicle(path),
        vehicle_text=path.read_text(),
        card=Card(config.kind, "alula train", "2026-01-01", FAST, {"a.csv": "00"}, {}, "arpl_250g", "11"),
        reliability=Reliability(0.2, np.full(6, 0.1), np.full(6, 2.0)),
    )


@pytest.fixture
def model() -> TrainedModel:
    return some_model(ModelConfig("pi_tcn", "tcn"))


def test_a_loaded_model_predicts_what_the_saved_one_did(model: TrainedModel, tmp_path: Path) -> None:
    save(model, tmp_path / "m.pt")
    again = load(tmp_path / "m.pt")
    windows = np.random.default_rng(1).normal(size=(7, 20, 13))
    np.testing.assert_array_equal(again.outputs(windows), model.outputs(windows))
    np.testing.assert_array_equal(again.outputs(windows, member=1)[0], model.outputs(windows)[1])
    assert (again.config, again.card, again.vehicle) == (model.config, model.card, model.vehicle)
    assert again.reliability is not None
    assert again.reliability.disagreement == 0.2
    assert [path.name for path in tmp_path.iterdir()] == ["m.pt"]


def changed(path: Path, **entries: object) -> Path:
    content = torch.load(path, weights_only=True)
    torch.save({**content, **entries}, path)
    return path


def test_a_checkpoint_of_another_version_or_shape_is_refused(model: TrainedModel, tmp_path: Path) -> None:
    path = tmp_path / "m.pt"
    save(model, path)
    with pytest.raises(RequestError, match="model of version 7, this alula reads up to 2"):
        load(changed(path, version=7))
    save(model, path)
    config = torch.load(path, weights_only=True)["config"]
    with pytest.raises(RequestError, match="weights of another shape"):
        load(changed(path, config={**config, "channels": 8}))
    save(model, path)
    with pytest.raises(RequestError, match="are for 13 inputs and 6 outputs, its config has 15 and 6"):
        load(changed(path, config={**config, "rotors": 6}))
    save(model, path)
    with pytest.raises(RequestError, match="damaged model"):
        load(changed(path, config={**config, "colour": "blue"}))


def test_a_checkpoint_whose_parts_do_not_fit_is_refused(model: TrainedModel, tmp_path: Path) -> None:
    path, intact = tmp_path / "m.pt", tmp_path / "whole.pt"
    save(model, intact)
    content = torch.load(intact, weights_only=True)
    (first, *_) = content["members"]
    six = model.vehicle_text.replace("spin = [1, -1, 1, -1]", "spin = [1, -1, 1, -1, 1, -1]").replace(
        "[0.076, -0.076, 0.0]]", "[0.076, -0.076, 0.0], [0.1, 0.0, 0.0], [-0.1, 0.0, 0.0]]"
    )
    for entry, value, words in (
        ("members", [], "it has 0 networks and is a pi_tcn model"),
        ("members", None, "TypeError"),
        ("members", [3], "TypeError"),
        ("members", [{name: weight * torch.nan for name, weight in first.items()}], "weights that are not finite"),
        ("reliability", {"disagreement": 0.1}, "KeyError: 'error_floor'"),
        ("reliability", {**content["reliability"], "error_floor": torch.zeros(3)}, "are for 13 inputs and 6 outputs"),
        ("vehicle", "no file", "not valid TOML"),
        ("vehicle", six, "its vehicle has 6 rotors, its config 4"),
        ("config", {**content["config"], "history": 5}, "look back 19 columns, the history has 5"),
        ("card", "{}", "'kind' is missing"),
    ):
        torch.save({**content, entry: value}, path)
        with pytest.raises(RequestError, match=rf"m.pt is a damaged model: .*{words}.* Restore it from") as caught:
            load(path)
        assert "\n" not in str(caught.value)


def test_files_that_are_no_checkpoint_are_refused(tmp_path: Path) -> None:
    with pytest.raises(RequestError, match="there is no"):
        load(tmp_path / "missing.pt")
    (tmp_path / "text.pt").write_text("no checkpoint")
    (tmp_path / "code.pt").write_bytes(pickle.dumps({"members": print}))
    with pytest.raises(RequestError, match="torch cannot read it") as caught:
        load(tmp_path / "code.pt")
    assert "weights_only" not in str(caught.value)  # torch's advice is to run the file's code
    with pytest.raises(RequestError, match="no checkpoint"):
        load(tmp_path / "text.pt")
    torch.save({"weights": torch.zeros(3), "epoch": 4}, tmp_path / "other.pt")
    with pytest.raises(RequestError, match="no model of alula"):
        load(tmp_path / "other.pt")


def test_a_cut_off_checkpoint_is_refused(model: TrainedModel, tmp_path: Path) -> None:
    path = tmp_path / "m.pt"
    save(model, path)
    path.write_bytes(path.read_bytes()[:2000])
    with pytest.raises(RequestError, match="no checkpoint, or a damaged one"):
        load(path)


def test_a_full_disk_is_an_error_and_leaves_the_old_file(model: TrainedModel, tmp_path: Path) -> None:
    path = tmp_path / "m.pt"
    save(model, path)
    before = path.read_bytes()
    (tmp_path / "m.pt.part").symlink_to("/dev/full")
    with pytest.raises(RequestError, match=r"No space left on device|PytorchStreamWriter"):
        save(model, path)
    assert path.read_bytes() == before
    assert [file.name for file in tmp_path.iterdir()] == ["m.pt"]
