"""Planted effects are named: pairs, effects that held-out flights do not show; others are called unknown."""

import dataclasses

import msgspec
import numpy as np
import pytest

from diagnosis.data.dataset import make_dataset
from diagnosis.diagnose import diagnose_dataset
from dynamics.effects import CATALOGUE
from dynamics.vehicle import EffectUse
from fixtures.compiled_flights import compiled_flights
from fixtures.foreign_effects import FOREIGN


def diagnosed(vehicle, *effects, noise=1.0, seed=5, commands=False, catalogue=CATALOGUE):
    uses = [EffectUse(name, values, rotor) for name, values, rotor in effects]
    everything = {**CATALOGUE, **FOREIGN}
    flights = compiled_flights(vehicle, uses, catalogue=everything, seed=seed, noise=noise, commands=commands)
    return diagnose_dataset(make_dataset(flights, vehicle), vehicle, catalogue).diagnosis


@pytest.mark.slow
def test_a_wrong_mass_beside_a_strong_drag_is_not_taken_for_a_wrong_thrust_constant(arpl_250g):
    diagnosis = diagnosed(
        arpl_250g, ("mass", {"ratio": 1.18}, None), ("rotor_drag", {"coefficient": 4.7e-5}, None), noise=3.0
    )
    values = {effect.name: effect.parameters for effect in diagnosis.effects}
    assert set(values) == {"mass", "rotor_drag"}
    assert values["mass"]["ratio"].value == pytest.approx(1.18, rel=0.01)
    assert values["rotor_drag"]["coefficient"].value == pytest.approx(4.7e-5, rel=0.02)


def test_an_effect_that_the_held_out_flights_do_not_show_is_named_from_the_others(arpl_250g):
    wall = {"gain": -0.17, "heading": -np.pi / 2, "distance": 2.12, "scale": 0.14}  # only the second flight is near it
    diagnosis = diagnosed(arpl_250g, ("wall_effect", wall, None))
    assert [effect.name for effect in diagnosis.effects] == ["wall_effect"]


def test_an_effect_that_the_held_out_flights_refute_is_not_named(arpl_250g):
    """Sure as it is in the fitted flights: in the others it makes an error that is not there without it."""
    some = {name: CATALOGUE[name] for name in ("rotor_drag", "mass", "imu_bias", "gyro_bias")}
    drag = EffectUse("rotor_drag", {"coefficient": 3e-5})
    dragging, free = (
        make_dataset(compiled_flights(arpl_250g, uses, catalogue=CATALOGUE, seed=5), arpl_250g) for uses in ([drag], [])
    )
    mixed = dataclasses.replace(dragging, held_out=free.held_out)
    diagnosis = diagnose_dataset(mixed, arpl_250g, some).diagnosis
    assert diagnosis.effects == ()
    (refused,) = (one for one in diagnosis.refused if one.name == "rotor_drag")
    assert refused.reason == "held_out_worse"
    assert refused.detail["after"] > 1.2 * refused.detail["before"]


@pytest.mark.slow
def test_standing_air_that_pushes_by_place_is_no_gust(arpl_250g):
    gusty = diagnosed(arpl_250g, ("gust", {"intensity": 0.8, "correlation_time": 1.0}, None))
    assert [effect.name for effect in gusty.effects] == ["gust"]
    assert gusty.verdict == "effect"
    assert diagnosed(arpl_250g, ("swirling", {"amplitude": 0.04}, None)).verdict == "unknown"


@pytest.mark.slow
def test_two_drags_in_a_steady_wind_are_named_without_a_gust(arpl_250g):
    wind = {"x": 4.2, "y": -0.3, "z": 0.0}
    drags = [("rotor_drag", {"coefficient": 1.4e-5}, None), ("parasitic_drag", {"coefficient": 0.0114}, None)]
    values = {e.name: e.parameters for e in diagnosed(arpl_250g, *drags, ("wind", wind, None)).effects}
    assert set(values) == {"wind", "rotor_drag", "parasitic_drag"}
    assert values["wind"]["x"].value == pytest.approx(4.2, abs=0.05)
    assert values["parasitic_drag"]["coefficient"].value == pytest.approx(0.0114, rel=0.03)


@pytest.mark.slow
def test_commanded_speeds_are_used_as_they_are(arpl_250g):
    diagnosis = diagnosed(
        arpl_250g, ("motor_lag", {"time_constant": 0.03}, None), ("mass", {"ratio": 1.1}, None), commands=True
    )
    first = {effect.name: effect for effect in diagnosis.effects}
    assert set(first) <= {"motor_lag", "mass", "thrust_constant"}
    assert first["motor_lag"].parameters["time_constant"].value == pytest.approx(0.03, rel=0.05)
    assert len(first) == 2


@pytest.mark.slow
def test_no_more_than_two_effects_are_named_as_ambiguous(arpl_250g):
    body = msgspec.structs.replace(arpl_250g.body, mass=0.97 * arpl_250g.body.mass)
    flights = compiled_flights(arpl_250g, [], catalogue=CATALOGUE, seed=6)
    light = msgspec.structs.replace(arpl_250g, body=body)
    diagnosis = diagnose_dataset(make_dataset(flights, light), light, CATALOGUE).diagnosis
    assert all(len(effect.ambiguous_with) <= 1 for effect in diagnosis.effects)
    assert "mass" in {diagnosis.effects[0].name, *diagnosis.effects[0].ambiguous_with}
