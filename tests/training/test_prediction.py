"""Predictions: what members disagree on is flagged, a residual fades there, and errors are counted component-wise."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
import torch

from dynamics.errors import DataError
from dynamics.vehicle import Vehicle
from dynamics.vehicle_file import parse_effect
from flights import Flight
from tests.training.conftest import EFFECTS, MakePlan
from training.checkpoint import TrainedModel
from training.data.labelled_rows import LabelledRows, label_rows
from training.data.logged_flights import read_logged_flights
from training.ground_truth import true_label
from training.networks import build_network
from training.prediction import flight_errors, gate_of, judge_reliability, pooled, predict, rmse
from training.trainer import Member


def with_random_members(plan_for: MakePlan, vehicle: Vehicle, members: int) -> tuple[TrainedModel, LabelledRows]:
    plan = plan_for("grey_box", vehicle=vehicle.with_effects(*[parse_effect(text, 4) for text in EFFECTS]))
    trained = []
    for seed in range(members):
        torch.manual_seed(seed)
        network = build_network(plan.config)
        torch.nn.init.normal_(network.decoder[-1].weight, std=0.05)
        trained.append(Member(network.state_dict(), 1.0, 0, 0, 0.0))
    return plan.assemble(trained, list(range(members)), command="alula train"), plan.validation


def test_a_residual_fades_where_the_members_disagree(plan_for: MakePlan, arpl_250g: Vehicle) -> None:
    model, data = with_random_members(plan_for, arpl_250g, 3)
    assert model.reliability is not None
    sure = predict(model, data)
    assert sure.gate is not None
    assert (sure.gate == 1).mean() == pytest.approx(0.99, abs=0.005)
    doubting = dataclasses.replace(model.reliability, disagreement=1e-9 * model.reliability.disagreement)
    faded = predict(dataclasses.replace(model, reliability=doubting), data)
    assert data.base is not None
    np.testing.assert_allclose(faded.body, data.base[data.ends], atol=1e-9)
    ungated = predict(dataclasses.replace(model, reliability=doubting), data, gated=False)
    assert np.abs(ungated.body - faded.body).max() > 0.001


def test_the_gate_is_open_up_to_its_threshold_and_then_falls() -> None:
    np.testing.assert_allclose(gate_of(np.array([0.0, 0.5, 1.0, 2.0, 10.0]), 1.0), [1, 1, 1, 0.25, 0.01])


def test_intervals_of_an_ensemble_cover_nine_errors_in_ten() -> None:
    random = np.random.default_rng(0)
    spread = random.uniform(0.1, 3.0, (4000, 1)) * np.ones(6)
    targets = np.zeros((4000, 6))
    outputs = 2.0 * spread * random.normal(size=(4000, 6)) + spread * random.normal(size=(4, 4000, 6))
    outputs[0] += 0.3 * random.normal(size=(4000, 6))
    reliability = judge_reliability(outputs[:, :2000], targets[:2000], np.ones(6))
    assert reliability is not None
    deviation = outputs[:, 2000:].std(axis=0, ddof=1)
    width = np.hypot(reliability.error_floor, reliability.error_scale * deviation)
    covered = (np.abs(outputs[:, 2000:].mean(axis=0)) <= width).mean(axis=0)
    np.testing.assert_allclose(covered, 0.9, atol=0.03)


def test_one_network_alone_says_nothing_of_its_reliability(plan_for: MakePlan, arpl_250g: Vehicle) -> None:
    model, data = with_random_members(plan_for, arpl_250g, 1)
    prediction = predict(model, data)
    assert model.reliability is None
    assert prediction.half_width is None
    assert prediction.gate is None


def test_the_nominal_model_needs_no_network_and_errs_as_it_does(plan_for: MakePlan) -> None:
    plan = plan_for("nominal")
    model = plan.assemble([], [], command="alula train")
    for error in model.card.errors:
        assert error.combined == error.nominal == error.base


def test_errors_count_each_component_alike_and_pool_by_rows(plan_for: MakePlan) -> None:
    assert rmse(np.array([[3.0, 0, 0, 4.0, 0, 0]])) == pytest.approx((np.sqrt(3), np.sqrt(16 / 3), np.sqrt(25 / 6)))
    data = plan_for("nominal").training
    errors = flight_errors(data, data.nominal[data.ends] + 0.5)
    together = rmse(data.nominal[data.ends] + 0.5 - data.label[data.ends])
    assert pooled(errors).combined == pytest.approx(together[2])
    assert [error.flight for error in errors] == list(data.flights)


def test_the_truth_of_a_campaign_is_joined_row_by_row(
    plan_for: MakePlan, flights: list[Flight], tmp_path: Path
) -> None:
    data = plan_for("nominal").training
    (tmp_path / "truth").mkdir()
    with pytest.raises(DataError, match=r"truth/flight_0.parquet is missing"):
        true_label(data, tmp_path, dt=0.01)
    for place, name in enumerate(data.flights):
        flights[place].to_parquet(tmp_path / "truth" / name)  # as if the sensors had been perfect
    truth = true_label(data, tmp_path, dt=0.01)[data.ends]
    finite = np.isfinite(truth).all(axis=1)
    assert finite.mean() > 0.99
    assert np.corrcoef(truth[finite, 2], data.label[data.ends][finite, 2])[0, 1] > 0.9


def test_a_model_is_judged_on_other_flights_through_its_own_definition(
    plan_for: MakePlan, arpl_250g: Vehicle, folder: Path
) -> None:
    model, _ = with_random_members(plan_for, arpl_250g, 2)
    (other,) = read_logged_flights([folder / "flight_1.parquet"], dt=model.config.dt)
    data = label_rows(model.config, model.vehicle, [other])
    prediction = predict(model, data)
    assert prediction.body.shape == (len(data.ends), 6)
    assert prediction.half_width is not None
    assert (prediction.half_width > 0).all()
