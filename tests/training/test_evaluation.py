"""Evaluation against the ground truth of a campaign, open loop, pulses and calibration."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import msgspec
import numpy as np
import pytest

from dynamics.errors import DataError, RequestError
from dynamics.state import ATTITUDE
from dynamics.vehicle import GRAVITY, EffectUse, Vehicle
from dynamics.vehicle_file import parse_effect
from sitl_mock.vehicle.plant import plant_effects
from tests.support.small_campaign import fly_campaign
from tests.support.trained import untrained_model
from training.calibration import auroc, calibration
from training.checkpoint import Reliability, TrainedModel
from training.data.features import outputs_from
from training.data.logged_flights import CAMPAIGN, LoggedFlight, read_logged_flights
from training.evaluation import NOMINAL, PLANT, NamedModel, evaluate, physical_model, rows_for
from training.ground_truth import campaign_of, hidden_plant, true_label
from training.models import named_kind
from training.open_loop import OpenLoopSimulation, warm_up
from training.open_loop_errors import open_loop_errors, pulse_responses, start_rows
from training.prediction import pooled, predict

EFFECTS = ("motor_lag:time_constant=0.035", "rotor_drag:coefficient=6e-5")


@pytest.fixture(scope="module")
def campaign(tmp_path_factory: pytest.TempPathFactory, arpl_250g: Vehicle) -> Path:
    flights = {"test/Lemniscate": "Lemniscate:laps=2,ramp=1", "test/Parabola": "Parabola:laps=2,ramp=1"}
    return fly_campaign(tmp_path_factory.mktemp("small") / "campaign", arpl_250g, EFFECTS, flights)


@pytest.fixture(scope="module")
def recordings(campaign: Path) -> tuple[LoggedFlight, ...]:
    return read_logged_flights(sorted((campaign / "test").iterdir()), dt=0.01, may_be_tests=True)


def model_of(kind: str, vehicle: Vehicle, *, members: int = 2) -> TrainedModel:
    """An ensemble with random weights whose residual never fades."""
    model = untrained_model(named_kind(kind).config, vehicle, members=members, gain=0.1)
    return dataclasses.replace(model, reliability=Reliability(1e6, np.full(6, 0.1), np.full(6, 2.0)))


def test_the_plant_is_known_from_what_the_campaign_hid(campaign: Path, arpl_250g: Vehicle) -> None:
    logs = tuple(sorted((campaign / "test").iterdir()))
    assert campaign_of(logs) == campaign
    assert campaign_of((*logs, Path(__file__))) is None
    named = arpl_250g.with_effects(EffectUse("rotor_drag", {"coefficient": 1e-5}))
    assert [use.name for use in hidden_plant(campaign, named).effects] == ["motor_lag", "rotor_drag"]


def test_the_plant_has_the_lag_that_the_mock_gives_every_motor(tmp_path: Path, arpl_250g: Vehicle) -> None:
    drag = "rotor_drag:coefficient=1e-5"
    (tmp_path / CAMPAIGN).write_text(json.dumps({"effects": [drag]}))
    flown = plant_effects(arpl_250g, [parse_effect(drag, arpl_250g.rotors.count)])
    assert hidden_plant(tmp_path, arpl_250g).effects == flown
    assert {use.name for use in flown} == {"rotor_drag", "motor_lag"}


def test_against_the_truth_the_plant_errs_by_sensor_noise_alone(
    campaign: Path, recordings: tuple[LoggedFlight, ...], arpl_250g: Vehicle
) -> None:
    names: list[str] = []
    report, evaluated = evaluate(
        [NamedModel("ours", model_of("res_tcn", arpl_250g))], recordings, campaign=campaign, done=names.append
    )
    assert names == [NOMINAL, "ours", PLANT] == [model.name for model in report.models]
    nominal, ours, plant = report.models
    assert pooled(plant.true).combined < 0.1 * pooled(nominal.true).combined
    assert pooled(plant.true).combined < pooled(plant.label).combined
    assert len(ours.members) == 2
    assert [e.horizon for e in plant.open_loop] == pytest.approx([0.1, 0.5, 1.0])
    assert plant.open_loop[-1].position < 0.3 * nominal.open_loop[-1].position
    assert {peak.flight for peak in report.peaks} == {"Lemniscate.parquet", "Parabola.parquet"}
    assert report.peaks[0].linear > report.peaks[1].linear > 1
    assert all(len(one.body) == len(one.data.ends) for one in evaluated)


@pytest.mark.parametrize("kind", ["pi_tcn", "res_tcn", "grey_box", "pi_mlp"])
def test_a_simulation_begins_with_what_the_model_predicts(
    recordings: tuple[LoggedFlight, ...], arpl_250g: Vehicle, kind: str
) -> None:
    """Streams, batches and hidden states against whole windows and row after row."""
    model = model_of(kind, arpl_250g.with_effects(EffectUse("motor_lag"), EffectUse("rotor_drag")))
    data = rows_for(model, recordings)
    rows = np.intersect1d(start_rows(model, data, steps=1), data.ends)[::7]
    window = rows[:, None] + np.arange(1 - warm_up(model.config), 1)
    states = data.state[window]
    simulation = OpenLoopSimulation(model, states, data.rotor_speed[window[:, :-1]])
    before = simulation.state.copy()
    simulation.step(data.rotor_speed[rows])
    predicted = predict(model, data).body[np.searchsorted(data.ends, rows)]
    angular = (simulation.state - before)[:, 10:] / model.config.dt
    np.testing.assert_allclose(angular, predicted[:, 3:], rtol=2e-3, atol=2e-3)
    speed = np.linalg.norm((simulation.state - before)[:, 3:6] / model.config.dt + [0, 0, GRAVITY], axis=1)
    np.testing.assert_allclose(speed, np.linalg.norm(predicted[:, :3], axis=1), rtol=2e-3, atol=2e-3)


def test_a_grey_box_is_evaluated_with_and_without_its_network(
    recordings: tuple[LoggedFlight, ...], arpl_250g: Vehicle
) -> None:
    vehicle = arpl_250g.with_effects(EffectUse("motor_lag", {"time_constant": 0.035}), EffectUse("rotor_drag"))
    report, _ = evaluate(
        [NamedModel("ours", model_of("grey_box", vehicle))], recordings, campaign=None, done=lambda _: None
    )
    assert [model.name for model in report.models] == [NOMINAL, "ours base", "ours"]
    base, ours = (pooled(model.label) for model in report.models[1:])
    assert base.combined == pytest.approx(ours.base, rel=0.05)  # which has a row or two more, without a history
    assert base.combined < 0.5 * base.nominal


def test_pulse_responses_of_the_plant_itself_are_right_and_weaker_rotors_show(
    campaign: Path, recordings: tuple[LoggedFlight, ...], arpl_250g: Vehicle
) -> None:
    truth = hidden_plant(campaign, arpl_250g)
    plant = physical_model(PLANT, truth, named_kind("pi_tcn").config)
    weak = physical_model(PLANT, truth.with_effects(EffectUse("thrust_constant", {"ratio": 0.9})), plant.config)
    data = rows_for(plant, recordings)
    assert all((p.velocity, p.thrust) == (0, 0) for p in pulse_responses(plant, plant, data))
    one, together = pulse_responses(weak, plant, data)
    assert one.rate == pytest.approx(0.1, abs=0.01)
    assert together.thrust == pytest.approx(0.1, abs=0.01)
    assert together.rate is None


def test_no_segment_is_long_enough_for_open_loop_predictions(
    recordings: tuple[LoggedFlight, ...], arpl_250g: Vehicle
) -> None:
    model = physical_model(NOMINAL, arpl_250g, named_kind("pi_tcn").config)
    short = dataclasses.replace(recordings[0], segments=(recordings[0].segments[0].rows(0, 130),))
    data = rows_for(model, [short])
    assert open_loop_errors(model, data, data.state) == ()


def test_flights_that_a_model_learned_from_are_refused_and_those_that_chose_it_are_noted(
    recordings: tuple[LoggedFlight, ...], arpl_250g: Vehicle
) -> None:
    model = model_of("pi_mlp", arpl_250g)
    first, second = recordings
    learned = msgspec.structs.replace(model.card, flights={"elsewhere.csv": first.sha256})
    ours = NamedModel("ours", dataclasses.replace(model, card=learned))
    report, judged = evaluate([ours], recordings, campaign=None, done=lambda _: None)
    assert report.notes == ("left out, since ours learned from them: Lemniscate.parquet",)
    assert list(report.flights) == ["Parabola.parquet"]
    assert {error.flight for one in judged for error in one.evaluation.label} == {"Parabola.parquet"}
    with pytest.raises(RequestError, match=r"ours was trained on Lemniscate.parquet.* no other flight was given"):
        evaluate([ours], [first], campaign=None, done=lambda _: None)
    chosen = msgspec.structs.replace(model.card, flights={}, validation={"a.csv": second.sha256})
    report, _ = evaluate(
        [NamedModel("ours", dataclasses.replace(model, card=chosen))], recordings, campaign=None, done=lambda _: None
    )
    assert report.notes == ("the best step of ours was chosen on Parabola.parquet",)
    assert report.models[-1].name == "ours"
    assert not report.models[0].true
    assert not report.models[0].pulses


def test_flights_without_the_motors_that_a_model_takes_are_refused(
    recordings: tuple[LoggedFlight, ...], arpl_250g: Vehicle
) -> None:
    def without_commands(recording: LoggedFlight) -> LoggedFlight:
        segments = tuple(
            dataclasses.replace(s, values={n: c for n, c in s.columns.items() if not n.startswith("rotor_command")})
            for s in recording.segments
        )
        return dataclasses.replace(recording, segments=segments)

    with pytest.raises(DataError, match=r"the model takes command rotor speeds"):
        rows_for(model_of("pi_mlp", arpl_250g), [without_commands(r) for r in recordings])


def test_the_area_under_the_curve_is_the_chance_of_the_right_order() -> None:
    positive = np.array([False, False, True, True])
    assert auroc(np.array([1.0, 2.0, 3.0, 4.0]), positive) == 1
    assert auroc(np.array([4.0, 3.0, 2.0, 1.0]), positive) == 0
    assert auroc(np.array([1.0, 3.0, 2.0, 4.0]), positive) == 0.75
    assert auroc(np.ones(4), positive) == 0.5
    assert np.isnan(auroc(np.ones(4), np.ones(4, dtype=bool)))


def test_error_bars_that_are_known_cover_what_they_should(
    campaign: Path, recordings: tuple[LoggedFlight, ...], arpl_250g: Vehicle
) -> None:
    """Labels planted so that errors are normal with a known deviation: 1.645 of it covers 90 %."""
    model = model_of("pi_mlp", arpl_250g)
    data = rows_for(model, recordings)
    width = np.array([0.5] * 3 + [2.0] * 3)
    sure = dataclasses.replace(model, reliability=Reliability(1e6, 1.645 * width, np.zeros(6)))
    label = np.full_like(data.label, np.nan)
    label[data.ends] = predict(model, data).body + width * np.random.default_rng(0).normal(size=(len(data.ends), 6))
    result = calibration(sure, data, label)
    assert result is not None
    assert result.coverage == pytest.approx(0.9, abs=0.01)
    assert result.auroc == pytest.approx(0.5, abs=0.07)
    assert result.faded == 0
    assert calibration(model_of("pi_mlp", arpl_250g, members=1), data, label) is None
    truth = true_label(data, campaign, dt=0.01)
    attitude = data.state[data.ends, ATTITUDE]
    assert np.isfinite(outputs_from(model.config, arpl_250g, truth[data.ends], None, attitude)).mean() > 0.95
