"""Effects with states of their own, as a load that swings: their columns, starts and values."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from diagnosis.likelihood.columns import candidates
from diagnosis.likelihood.flight_rows import make_rows
from diagnosis.likelihood.identify import deviations, identify
from diagnosis.likelihood.named import named_effects
from diagnosis.likelihood.problem import Problem
from diagnosis.likelihood.rigid_body import FlightModel
from dynamics.effect import Parameter, Prior
from dynamics.effects import CATALOGUE
from dynamics.vehicle import GRAVITY, EffectUse
from tests.diagnosis.likelihood.flights import flown, problem_of
from tests.support.own_effects import given_catalogue

EXAMPLE = Path(__file__).parents[3] / "examples" / "my_effects.py"
TIME = Parameter("time", "s", "", 1e-9, 1.0, lambda _: Prior(0.1, 0.1), neutral=1e-6)
LOAD = {"mass": 0.03, "length": 0.5}
STARTS = {"slung_load.line_x[0]": 0.2, "slung_load.swing_y[0]": 0.7}


def loaded(values: dict[str, float], starts: dict[str, float]) -> tuple[Problem, int]:
    """A flight's problem about a model with a load, and the load's number among the candidates."""
    problem = problem_of("nothing", "speeds", 90002, 1)
    number = next(i for i, c in enumerate(problem.what.all) if c.effect.name == "slung_load")
    problem = dataclasses.replace(problem)
    problem.move_to({number: values}, {})  # begins where its own fit says, then where it is put
    problem.move_to({number: values}, {0: starts})
    return problem, number


@pytest.mark.parametrize(
    ("name", "step"),
    [("mass", 1e-4), ("length", 1e-4), ("slung_load.line_x[0]", 1e-3), ("slung_load.swing_y[0]", 1e-3)],
)
def test_columns_of_a_load_and_of_its_start_are_slopes_of_the_model(name, step):
    problem, number = loaded(LOAD, STARTS)
    what, rows, lift = problem.what, problem.flights[0], np.array([0.0, 0.0, GRAVITY])
    if name in LOAD:
        column = what.places(number)[what.all[number].free.index(name)]
    else:
        column = len(what.columns) + [n.of for n in what.nuisances].index(name)
    along = problem.along(0)
    own = problem.inputs(0, along, [number])
    (column,) = own.places([column])
    ends = []
    for sign in (1, -1):
        values = {**LOAD, name: LOAD[name] + sign * step} if name in LOAD else LOAD
        starts = STARTS if name in LOAD else {**STARTS, name: STARTS.get(name, 0.0) + sign * step}
        moved, _ = loaded(values, starts)
        model = FlightModel(moved.vehicle, moved.uses, moved.catalogue)
        ends.append(model.along(rows, along.reference, lift, starts))
    defect = (ends[0].defect - ends[1].defect)[:, :9] / (2 * step)
    read = -(ends[0].difference - ends[1].difference) / (2 * step)
    np.testing.assert_allclose(-own.B[:, :9, column], defect, atol=0.02 * np.abs(defect).max() + 1e-9)
    np.testing.assert_allclose(own.D[:, :, column], read, atol=0.02 * np.abs(read).max() + 1e-9)


def test_a_load_that_the_file_holds_has_free_starts_and_others_have_none():
    problem, number = loaded(LOAD, {})
    assert {n.of.split(".")[0] for n in problem.what.nuisances if n.kind == "start"} == {"slung_load"}
    assert problem.what.all[number].free == ("mass", "length")
    problem.move_to({}, {})
    assert not [n for n in problem.what.nuisances if n.kind == "start"]
    assert problem.what.all[number].free == ("mass",)


def test_logs_too_slow_for_hidden_states_leave_the_effect_out():
    """A swing whose time constant is a tenth of a millisecond."""
    fast = dataclasses.replace(
        CATALOGUE["slung_load"],
        name="fast",
        parameters=(*CATALOGUE["slung_load"].parameters, TIME),
        time_constants=("time",),
        derivative=lambda c, p, h, n: {name: -h[name] * h[name] / p["time"] for name in h},
        grid=lambda vehicle, span: [{"length": 0.5, "time": 1e-6}],
        refine=("length", "time"),
    )
    vehicle, dataset = flown("nothing", "speeds", 90002)
    what = candidates(vehicle, {"fast": fast, "mass": CATALOGUE["mass"]}, dataset.fitted)
    assert {c.effect.name for c in what.all} == {"mass"}


def test_a_users_wake_begins_between_the_points_of_its_grid():
    """The example's late drag: without a free start, with a grid of its time constant."""
    vehicle, dataset = flown("nothing", "speeds", 90002)
    catalogue = given_catalogue([EXAMPLE], vehicle)
    rows = [make_rows(dataset.fitted[0], 0)]
    what = candidates(vehicle, catalogue, dataset.fitted)
    problem = Problem(vehicle, catalogue, rows, what)
    number = next(i for i, c in enumerate(what.all) if c.effect.name == "late_drag" and c.at["tau"] == 0.2)
    own = problem.inputs(0, problem.along(0), [number])
    assert np.abs(own.B[:, :3, own.places(what.places(number))]).max() > 0
    truth = EffectUse("late_drag", {"coefficient": 0.5, "tau": 0.15})
    lift = np.array([0.0, 0.0, GRAVITY])
    wake = FlightModel(vehicle, [*vehicle.effects, truth], catalogue).along(rows[0], problem.reference(0), lift)
    rows[0] = dataclasses.replace(rows[0], force=wake.force)
    problem = Problem(vehicle, catalogue, rows, what)
    problem.move_to({number: {"coefficient": 0.4}}, {})
    assert problem.what.all[number].free == ("coefficient", "tau")
    assert abs(problem.what.all[number].at["tau"] - 0.15) < 0.02


def test_a_load_is_named_with_its_mass_and_length():
    problem = problem_of("single", "slung_load", 99000)
    mass, length = 0.0084031, 0.52363  # what the outside simulator hung below
    result = identify([problem])
    (load,), _ = named_effects(result)
    assert load.candidate.effect.name == "slung_load"
    values = result.search.named_values(result.best)[load.number]
    off = np.array([values["mass"] - mass, values["length"] - length])
    assert np.all(np.abs(off) < 4 * deviations(result.search, result.best))
    assert abs(values["length"] - length) < 0.02 * length


@pytest.mark.parametrize("effect", ["slung_load", "mass"])
def test_an_effect_whose_states_cannot_be_followed_along_a_flight_has_no_slope_there(effect, monkeypatch):
    problem = problem_of("nothing", "speeds", 90002, 1)
    number = next(i for i, c in enumerate(problem.what.all) if c.effect.name == effect)
    along = problem.along(0)
    problem.inputs(0, along, [number])  # where it begins is sought once
    monkeypatch.setattr(
        FlightModel, "hidden_path", lambda self, rows, *_: np.full((len(rows), self.hidden.count), np.nan)
    )
    own = problem.inputs(0, along, [number])
    shown = own.B[:, :, own.places(problem.what.places(number))]
    assert np.isfinite(shown).all()
    assert np.any(shown) == (effect == "mass")
