"""The lag of the rotors, which every vehicle has and few vehicle files name, is found in the flights."""

from __future__ import annotations

from pathlib import Path

import msgspec
import pytest

from dynamics.effects import motor_lag
from dynamics.vehicle import EffectUse, Vehicle
from dynamics.vehicle_file import parse_effect
from tests.support.own_effects import given_catalogue
from tests.training.conftest import MakePlan
from training.effects_fit import fit_effects, named_effects, with_rotor_lag


def test_a_vehicle_answers_with_the_lag_that_its_flights_show(plan_for: MakePlan, arpl_250g: Vehicle) -> None:
    plan = plan_for("pi_tcn", vehicle=arpl_250g)
    fitted = with_rotor_lag(plan.config, arpl_250g, plan.training)
    assert [use.name for use in fitted.effects] == ["motor_lag"]
    assert fitted.effects[0].parameters["time_constant"] == pytest.approx(0.04, rel=0.2)  # as planted
    assert plan.vehicle.effects == ()  # the model's own file stays as it was given


def test_a_users_own_lag_is_fitted_by_its_own_time_constant(
    plan_for: MakePlan, arpl_250g: Vehicle, tmp_path: Path
) -> None:
    text = Path(motor_lag.__file__).read_text()
    for old, new in (
        ('name="motor_lag"', 'name="own_lag"'),
        ('"time_constant"', '"tau"'),
        ('"rotor_speed"', '"omega"'),
    ):
        text = text.replace(old, new)
    path = tmp_path / "own_lag.py"
    path.write_text(text)
    catalogue = given_catalogue([path], arpl_250g)
    plan = plan_for("pi_tcn", vehicle=arpl_250g)
    named = named_effects(arpl_250g, [EffectUse("own_lag")], catalogue)
    assert with_rotor_lag(plan.config, named, plan.training, catalogue) is named
    fitted = fit_effects(plan.config, named, plan.training, catalogue)
    ours = with_rotor_lag(plan.config, arpl_250g, plan.training)
    assert fitted.effects[0].parameters["tau"] == ours.effects[0].parameters["time_constant"]


def test_a_lag_that_is_named_or_that_measured_speeds_contain_is_left_alone(
    plan_for: MakePlan, arpl_250g: Vehicle
) -> None:
    plan = plan_for("pi_tcn", vehicle=arpl_250g)
    named = named_effects(arpl_250g, [parse_effect("motor_lag:time_constant=0.02", 4)])
    assert with_rotor_lag(plan.config, named, plan.training) is named
    measured = msgspec.structs.replace(plan.config, motors="measured")
    assert with_rotor_lag(measured, arpl_250g, plan.training) is arpl_250g
