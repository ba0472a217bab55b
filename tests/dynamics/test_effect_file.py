"""A user's own effect as one Python file: taken like any other, or refused in plain words."""

import dataclasses
import importlib
import re
from pathlib import Path

import numpy as np
import pytest

from dynamics.effect import Effect
from dynamics.effects import CATALOGUE
from dynamics.errors import RequestError
from dynamics.model import ENVIRONMENT_DEFAULT, build_model
from dynamics.vehicle import EffectUse
from tests.support.own_effects import given_catalogue, given_effects

EXAMPLE = Path(__file__).parents[2] / "examples" / "my_effects.py"


def test_the_documented_example_has_the_force_of_its_formula(arpl_250g):
    catalogue = given_catalogue([EXAMPLE], arpl_250g)
    model = build_model(arpl_250g, effects=[EffectUse("tether", {"stiffness": 0.5})], catalogue=catalogue)
    state = np.array([2.0, -1.0, 1, 0, 0, 0, 1.0, 0, 0, 0, 0, 0, 0])
    force = model.observe(state, np.zeros(4), model.parameter_values, ENVIRONMENT_DEFAULT)[0]
    np.testing.assert_allclose(arpl_250g.body.mass * np.array(force).ravel(), [-1.0, 0.5, 0.0])


def written(folder, text):
    path = folder / "mine.py"
    path.write_text(text)
    return path


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("x = 1", "defines no EFFECT"),
        ("EFFECT = 3", "defines no EFFECT"),
        ("EFFECTS = []", "defines no EFFECT"),
        ("import nothing_of_this_name", "line 1: ModuleNotFoundError"),
        ("def broken(:", "SyntaxError"),
    ],
)
def test_a_file_without_an_effect_is_refused(tmp_path, text, message):
    with pytest.raises(RequestError, match=message):
        given_effects(written(tmp_path, text))


def test_a_file_that_is_not_there_is_refused(tmp_path):
    with pytest.raises(RequestError, match="is no file"):
        given_effects(tmp_path / "absent.py")


def test_a_name_that_is_taken_is_refused(tmp_path, arpl_250g):
    with pytest.raises(RequestError, match="'mass' already"):
        given_catalogue([written(tmp_path, EXAMPLE.read_text().replace('"tether"', '"mass"'))], arpl_250g)


@pytest.mark.parametrize(
    ("change", "message"),
    [(('p["stiffness"]', 'p["stifness"]'), "KeyError"), (('p["stiffness"]', '(p["stiffness"] / 0)'), "no number")],
)
def test_an_effect_that_cannot_be_evaluated_is_refused(tmp_path, arpl_250g, change, message):
    with pytest.raises(RequestError, match=message):
        given_catalogue([written(tmp_path, EXAMPLE.read_text().replace(*change))], arpl_250g)


@pytest.mark.parametrize(
    ("change", "line_with", "reason"),
    [
        (('    source="Hooke\'s law",\n', ""), "TETHER = Effect(", "missing 1 required positional argument: 'source'"),
        (('time_constants=("tau",)', 'time_constants=("tua",)'), "LATE_DRAG = Effect(", "time_constants names 'tua'"),
        (('refine=("tau",)', 'refine=("tua",)'), "LATE_DRAG = Effect(", "refine names 'tua'"),
        (("tau:.2g}", "tua:.2g}"), "LATE_DRAG = Effect(", "caveat names {tua}"),
        (("    derivative=wake,\n", ""), "LATE_DRAG = Effect(", "hidden states need a derivative"),
        (("    wrench=tether,\n", ""), "TETHER = Effect(", "it does nothing"),
        (('distance", 0.0, 10.0', 'distance", 10.0, 0.0'), "TETHER = Effect(", "lower 10.0 is not below upper 0.0"),
        (("0.02, 2.0, lambda", "0.0, 2.0, lambda"), "LATE_DRAG = Effect(", "it must be above 0"),
        (("    wrench=tether,", "    wrench=tether,\n    sensor_prior=0.1,"), "TETHER = Effect(", "sensor_prior"),
        (("    wrench=tether,", "    wrench=tether,\n    min_detectable=1,"), "TETHER = Effect(", "belong to a grid"),
        (("    wrench=tether,", "    wrench=tether,\n    stochastic=True,"), "TETHER = Effect(", "hidden states that"),
        (("    wrench=tether,", "    wrench=tether,\n    acts_on='air',"), "TETHER = Effect(", "acts_on is 'air'"),
        (("    wrench=tether,", "    wrench=tether,\n    colour='red',"), "TETHER = Effect(", "argument 'colour'"),
        (('"lateral_speed"', '"lateral"'), "excitation=Excitation(", "unknown measure 'lateral'"),
        (("enough=1.0", "enough=0.1"), "excitation=Excitation(", "weak <= enough"),
        (('{"tau": seconds}', '{"tua": seconds}'), "def wake_times", "the grid names 'tua'"),
        (("(0.1, 0.2, 0.4)", "(0.1, 0.2, 4.0)"), "def wake_times", "the grid holds tau = 4.0"),
        (("lambda _: 0.0)", 'lambda _: float("nan"))'), "hidden=tuple", "initial value of wake_x is nan"),
        (("Prior(0.05, 0.1)", "Prior(0.05, 0.0)"), "pull per metre", "prior of stiffness"),
        (('/ p["tau"]', '/ p["tua"]'), '/ p["tua"]', "KeyError: 'tua'"),
    ],
    ids=lambda value: value if isinstance(value, str) and " " not in value else "",
)
def test_an_effect_that_contradicts_itself_is_refused_with_its_line(tmp_path, arpl_250g, change, line_with, reason):
    text = EXAMPLE.read_text()
    assert change[0] in text
    text = text.replace(*change)
    line = next(number for number, part in enumerate(text.splitlines(), 1) if line_with in part)
    with pytest.raises(RequestError, match=f"mine.py, line {line}: .*{re.escape(reason)}"):
        given_catalogue([written(tmp_path, text)], arpl_250g)


def test_confusion_with_an_effect_that_there_is_not_is_refused(tmp_path, arpl_250g):
    text = EXAMPLE.read_text().replace('("linear_drag",)', '("linear_drg",)')
    with pytest.raises(RequestError, match="confounded_with names 'linear_drg'"):
        given_catalogue([written(tmp_path, text)], arpl_250g)


@pytest.mark.parametrize("name", CATALOGUE)
def test_a_users_file_can_hold_all_that_a_shipped_effect_has(tmp_path, arpl_250g, name):
    source = Path(importlib.import_module(f"dynamics.effects.{name}").__file__).read_text()
    catalogue = given_catalogue([written(tmp_path, source.replace(f'name="{name}"', 'name="copy"'))], arpl_250g)
    ours, theirs = CATALOGUE[name], catalogue["copy"]
    for field in dataclasses.fields(Effect):
        one, other = getattr(ours, field.name), getattr(theirs, field.name)
        if callable(one):
            assert callable(other), field.name
        elif field.name == "hidden":
            assert [(h.name, h.unit, h.per_rotor) for h in one] == [(h.name, h.unit, h.per_rotor) for h in other]
        elif field.name == "parameters":
            assert [astuple(p, arpl_250g) for p in one] == [astuple(p, arpl_250g) for p in other]
        elif field.name != "name":
            assert one == other, field.name
    models = [
        build_model(
            arpl_250g, effects=[EffectUse(effect.name, {}, 2 if effect.per_rotor else None)], catalogue=catalogue
        )
        for effect in (ours, theirs)
    ]
    x = np.concatenate([np.linspace(0.1, 1.3, 13), models[0].hidden_initial])
    speed, noise = np.linspace(900, 1200, 4), np.full(models[0].hidden_count, 0.3)
    results = [model.derivative(x, speed, model.parameter_values, [0.0, 0.9], noise) for model in models]
    np.testing.assert_array_equal(*[np.array(result) for result in results])
    assert models[0].time_constants == models[1].time_constants


def astuple(parameter, vehicle):
    fields = (parameter.name, parameter.unit, parameter.meaning, parameter.lower, parameter.upper, parameter.neutral)
    return (*fields, parameter.prior(vehicle))
