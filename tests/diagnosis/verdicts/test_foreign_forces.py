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


@pytest.mark.parametrize(("seed", "linear", "quadratic"), [(6, 0.8, 0.2), (8, 0.6, 0.3)])
def test_both_drags_of_a_body_that_is_slimmer_along_z_are_named(tmp_path, seed, linear, quadratic):
    """Their form is not quite right, and two that resemble each other trade values: neither was named."""
    plain = Campaign({}, {}, Recorder(50.0), lag_declared=False, fast=True, flights=5, seed=seed, duration=9.0)
    sizes = {"linear_drag": linear * plain.frame.mass, "parasitic_drag": quadratic * plain.frame.mass}
    shaped = {"linear": sizes["linear_drag"], "quadratic": sizes["parasitic_drag"], "vertical": 0.6}
    campaign = replace(plain, hidden={"shaped_drag": shaped})
    write_campaign(campaign, flown([campaign])[0], tmp_path)
    vehicle = read_vehicle(tmp_path / "vehicle.toml")
    dataset = read_dataset(sorted(tmp_path.glob("*.csv")), vehicle)
    diagnosis = diagnose_dataset(dataset, vehicle, SOME).diagnosis
    named = {effect.name: effect.parameters["coefficient"].value for effect in diagnosis.effects}
    assert named.keys() == sizes.keys()
    for name, value in named.items():
        assert value == pytest.approx(sizes[name], rel=0.2)
    assert diagnosis.verdict == "unknown"  # what the form leaves is said
    assert diagnosis.channels["mocap"].after < 0.3 * diagnosis.channels["mocap"].before


@pytest.mark.parametrize("name", FORCES)
def test_a_force_outside_the_catalogue_is_unknown_and_nothing_is_named(diagnosed, name):
    diagnosis = diagnosed[name]
    assert diagnosis.verdict == "unknown"
    assert diagnosis.effects == ()
    assert "predictable_from_state" in [one.test for one in diagnosis.leftover]


def test_a_drag_that_stands_in_for_another_form_is_refused_for_that(diagnosed):
    assert ("linear_drag", "another_form") in [(one.name, one.reason) for one in diagnosed["dry_drag"].refused]


def test_a_constant_that_stands_in_for_what_warms_up_is_not_named(diagnosed):
    assert diagnosed["warming"].effects == ()


def test_a_gust_is_one(diagnosed):
    assert [effect.name for effect in diagnosed["gust"].effects] == ["gust"]
    assert diagnosed["gust"].verdict == "effect"
