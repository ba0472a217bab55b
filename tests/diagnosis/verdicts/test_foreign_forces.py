"""A steady force that no effect of the catalogue has is no gust, and no effect that resembles a part of it is named."""

from dataclasses import replace

import numpy as np
import pytest

from diagnosis.data.dataset import read_dataset
from diagnosis.diagnose import diagnose_dataset
from dynamics.effects import CATALOGUE
from dynamics.vehicle_file import read_vehicle
from fixtures.outside_cases import Campaign, flown, sized, write_campaign
from fixtures.outside_sensors import Recorder

SOME = {name: CATALOGUE[name] for name in ("linear_drag", "parasitic_drag", "wind", "gust", "thrust_constant")}
FORCES = ("dry_drag", "crosswise_lift")


@pytest.fixture(scope="module")
def diagnosed(tmp_path_factory):
    """What is said of flights that hide a force outside the catalogue, and of flights in a gust."""
    plain = Campaign({}, {}, Recorder(50.0), lag_declared=False, fast=False, flights=4, seed=5, duration=9.0)
    frame = plain.frame
    hidden = {
        "dry_drag": {"dry_drag": {"force": 0.5 * frame.mass}},
        "crosswise_lift": {"crosswise_lift": {"coefficient": 0.4 * frame.mass}},
        "warming": {"warming": {"loss": 0.022}},
        "gust": {"gust": {"intensity": 1.5, "correlation_time": 1.2}},
    }
    drag = {"linear_drag": sized("linear_drag", frame, np.random.default_rng(0))}
    campaigns = [replace(plain, hidden=one, declared=drag if name == "gust" else {}) for name, one in hidden.items()]
    answers = {}
    for name, campaign, truths in zip(hidden, campaigns, flown(campaigns), strict=True):
        folder = tmp_path_factory.mktemp(name)
        write_campaign(campaign, truths, folder)
        vehicle = read_vehicle(folder / "vehicle.toml")
        dataset = read_dataset(sorted(folder.glob("*.csv")), vehicle)
        answers[name] = diagnose_dataset(dataset, vehicle, SOME).diagnosis
    return answers


@pytest.mark.parametrize("name", FORCES)
def test_a_force_outside_the_catalogue_is_unknown_and_nothing_is_named(diagnosed, name):
    diagnosis = diagnosed[name]
    assert diagnosis.verdict == "unknown"
    assert diagnosis.effects == ()
    assert ("gust", "predictable") in [(one.name, one.reason) for one in diagnosis.refused]
    assert "predictable_from_state" in [one.test for one in diagnosis.leftover]


def test_a_constant_that_stands_in_for_what_warms_up_is_not_named(diagnosed):
    """It halves the error: no test of the residuals rejects what is left, and all resamples agree on it."""
    diagnosis = diagnosed["warming"]
    assert diagnosis.verdict == "unknown"
    assert diagnosis.effects == ()
    assert ("thrust_constant", "drifts") in [(one.name, one.reason) for one in diagnosis.refused]


def test_a_gust_is_one(diagnosed):
    assert [effect.name for effect in diagnosed["gust"].effects] == ["gust"]
    assert diagnosed["gust"].verdict == "effect"
