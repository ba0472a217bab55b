"""A load that swings when the log starts is found swinging, and one that hangs still is not set swinging."""

import dataclasses

import numpy as np
import pytest

from diagnosis.data.segment import segments
from diagnosis.models.predictor import Predictor
from dynamics.effects import CATALOGUE
from dynamics.vehicle import EffectUse
from fixtures.outside_cases import Campaign, captured_flights, flown, vehicle_of
from fixtures.outside_sensors import Recorder
from tests.diagnosis.set_fits import fitted_to

LOAD = {"mass": 0.025, "length": 0.5}
SWINGS = np.array([0.2, -0.1, -1.0, 0.5, 0.9, 0.0])


@pytest.fixture(scope="module")
def segment(plain_flights, arpl_250g):
    return segments(plain_flights[3], arpl_250g)[0]


def predictor(vehicle, **load):
    return Predictor(vehicle, [EffectUse("slung_load", {**LOAD, **load})], CATALOGUE, speed_measured=True)


def with_load(segment, vehicle, start, noise=0.1):
    """The segment as its accelerometer reads it with a load that starts so."""
    feels = predictor(vehicle).predict_from(segment, {}, [start])[0].specific_force
    random = np.random.default_rng(3)
    return dataclasses.replace(segment, specific_force=feels + noise * random.standard_normal(feels.shape))


@pytest.mark.parametrize("mass", [LOAD["mass"], 0.0], ids=["given", "sought"])
def test_a_swinging_load_is_found_swinging(segment, arpl_250g, mass):
    loaded = with_load(segment, arpl_250g, SWINGS)
    start = predictor(arpl_250g, mass=mass).states(loaded)[0, 13:]
    np.testing.assert_allclose(start[[0, 1, 3, 4]], SWINGS[[0, 1, 3, 4]], atol=0.15)
    np.testing.assert_allclose(start[[2, 5]], SWINGS[[2, 5]])


def test_a_load_that_is_not_there_hangs_still(segment, arpl_250g):
    bare = Predictor(arpl_250g, [], CATALOGUE, speed_measured=True).predict(segment).specific_force
    noisy = bare + 0.1 * np.random.default_rng(3).standard_normal(bare.shape)
    quiet = dataclasses.replace(segment, specific_force=noisy)
    start = predictor(arpl_250g, mass=0.0).states(quiet)[0, 13:]
    np.testing.assert_array_equal(start, [0, 0, -1, 0, 0, 0])


def test_the_joint_fit_finds_mass_and_line_of_a_load_that_swings_from_the_start():
    campaign = Campaign({}, {}, Recorder(), lag_declared=False, fast=False, flights=4, seed=4)
    load = {"mass": 0.1 * campaign.frame.mass, "length": 0.5}
    campaign = dataclasses.replace(campaign, hidden={"slung_load": load})
    (truths,) = flown([campaign])
    assert truths is not None
    vehicle = vehicle_of(campaign)
    estimates = fitted_to(captured_flights(campaign, truths), vehicle, EffectUse("slung_load", load)).estimates
    assert estimates["slung_load", "mass"].value == pytest.approx(load["mass"], rel=0.03)
    assert estimates["slung_load", "length"].value == pytest.approx(load["length"], rel=0.03)
