"""The lag of the rotors, which every vehicle has and few vehicle files name, is found in the flights."""

from __future__ import annotations

import msgspec
import pytest

from dynamics.vehicle import Vehicle
from dynamics.vehicle_file import parse_effect
from tests.training.conftest import MakePlan
from training.effects_fit import named_effects, with_rotor_lag


def test_a_vehicle_answers_with_the_lag_that_its_flights_show(plan_for: MakePlan, arpl_250g: Vehicle) -> None:
    plan = plan_for("pi_tcn", vehicle=arpl_250g)
    found = with_rotor_lag(plan.config, arpl_250g, plan.training)
    assert [use.name for use in found.effects] == ["motor_lag"]
    assert found.effects[0].parameters["time_constant"] == pytest.approx(0.04, rel=0.2)  # as planted
    assert plan.vehicle.effects == ()  # the model's own file stays as it was given


def test_a_lag_that_is_named_or_that_measured_speeds_contain_is_left_alone(
    plan_for: MakePlan, arpl_250g: Vehicle
) -> None:
    plan = plan_for("pi_tcn", vehicle=arpl_250g)
    named = named_effects(arpl_250g, [parse_effect("motor_lag:time_constant=0.02", 4)])
    assert with_rotor_lag(plan.config, named, plan.training) is named
    measured = msgspec.structs.replace(plan.config, motors="measured")
    assert with_rotor_lag(measured, arpl_250g, plan.training) is arpl_250g
