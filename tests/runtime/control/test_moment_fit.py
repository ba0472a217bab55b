"""A centre of mass is named in flight beside the speeds that rotors had, and keeps its prior where none are known."""

import numpy as np
import pytest

from dynamics.references import named_reference
from dynamics.vehicle import EffectUse, Vehicle
from runtime.control.adaptation_settings import AdaptationSettings
from runtime.control.controller import Controller, ControllerOptions
from runtime.control.followed_parameters import followed_parameters, with_followed
from runtime.control.moment_fit import MomentFit, with_moments
from runtime.control.rti.prebuilt import flown_model
from runtime.control.rti.problem import Problem
from runtime.control.rti.solver import RtiSolver
from simulation.lockstep import ParameterStep, fly_reference

FOLLOW = ("centre_of_mass",)
HERE = {"x": 0.006, "y": -0.004, "z": 0.0, "sensors_stay": 1.0}


def named_in_flight(
    vehicle: Vehicle, before: dict[str, float], steps: tuple[ParameterStep, ...] = (), name: str = "circle"
) -> dict[str, tuple[float, float]]:
    options = ControllerOptions.for_vehicle(vehicle, adaptation=AdaptationSettings(mode="on", follow=FOLLOW))
    controller = Controller.build(vehicle, options)
    reference = named_reference(name, vehicle, duration=12.0)
    use = EffectUse("centre_of_mass", before)
    fly_reference(vehicle, reference, effects=[use], seed=3, controller=controller, steps=steps)
    assert controller.adaptation is not None
    return {name: (value.value, value.std) for name, value in controller.adaptation.followed.parameters.items()}


@pytest.mark.parametrize("name", ["Hover", "Lemniscate"])
def test_a_centre_of_mass_is_named_with_its_interval(arpl_250g: Vehicle, name: str) -> None:
    named = named_in_flight(arpl_250g, HERE, name=name)
    for axis in "xy":
        value, deviation = named[f"centre_of_mass.{axis}"]
        assert abs(value - HERE[axis]) < 2 * deviation
        assert deviation < 5e-4
    assert named["centre_of_mass.z"][1] > 0.01  # which turns nothing


@pytest.mark.slow
def test_one_that_shifts_in_flight_is_named_where_it_is_then(arpl_250g: Vehicle) -> None:
    then = {"centre_of_mass.x": 0.0, "centre_of_mass.y": 0.005}
    named = named_in_flight(arpl_250g, HERE, (ParameterStep(6.0, then),))
    for name, true in then.items():
        assert abs(named[name][0] - true) < 2 * named[name][1]


def test_it_keeps_its_prior_where_no_rotor_speeds_are_known(arpl_250g: Vehicle) -> None:
    solver = RtiSolver(flown_model(with_followed(arpl_250g, FOLLOW)), Problem())
    fit = MomentFit(solver, with_moments(solver, followed_parameters(solver.model, FOLLOW)))
    assert [p.name for p in fit.parameters] == ["centre_of_mass.x", "centre_of_mass.y"]
    np.testing.assert_array_equal(fit.values, 0.0)
    np.testing.assert_array_equal(fit.deviations, [p.std for p in fit.parameters])


def test_what_moves_the_vehicle_is_left_to_the_other_fit(arpl_250g: Vehicle) -> None:
    follow = ("wind", "rotor_drag", "mass")
    solver = RtiSolver(flown_model(with_followed(arpl_250g, follow)), Problem())
    assert not MomentFit(solver, with_moments(solver, followed_parameters(solver.model, follow))).parameters
