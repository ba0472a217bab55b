"""Values of a set that is given: those of the truth, and refused where they are none."""

from __future__ import annotations

import pytest

from diagnosis.likelihood.given_set import fit_set, nearest_members
from dynamics.errors import DataError
from dynamics.vehicle import EffectUse
from tests.diagnosis.likelihood.flights import problem_of

TRUTH = 6.869e-05  # of the draw


def test_a_given_set_has_the_truth_in_its_interval_and_nothing_where_nothing_is() -> None:
    problem = problem_of("single", "rotor_drag", 90000)
    uses = [EffectUse("rotor_drag", {"coefficient": TRUTH}), EffectUse("mass", {"ratio": 1.0})]
    fit = fit_set([problem], nearest_members(problem, uses))
    (drag, mass), (of_drag, of_mass) = fit.values.items(), fit.deviations
    assert {drag[0], mass[0]} == {("rotor_drag", "coefficient"), ("mass", "ratio")}
    by_key = {drag[0][0]: (drag[1], of_drag), mass[0][0]: (mass[1], of_mass)}
    assert by_key["rotor_drag"][0] == pytest.approx(TRUTH, abs=2 * by_key["rotor_drag"][1])
    assert by_key["rotor_drag"][0] > 5 * by_key["rotor_drag"][1]
    assert by_key["mass"][0] == pytest.approx(1.0, abs=2 * by_key["mass"][1])


def test_an_effect_that_the_flights_cannot_show_is_refused_by_name() -> None:
    problem = problem_of("nothing", "speeds", 90002, 1)
    with pytest.raises(DataError, match="cannot show motor_lag"):
        nearest_members(problem, [EffectUse("motor_lag", {"time_constant": 0.03})])
