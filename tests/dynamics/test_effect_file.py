"""A user's own effect as one Python file: taken like any other, or refused in plain words."""

from pathlib import Path

import numpy as np
import pytest

from dynamics.effect_file import read_effects, with_effects_of
from dynamics.errors import RequestError
from dynamics.model import ENVIRONMENT_DEFAULT, build_model
from dynamics.vehicle import EffectUse

EXAMPLE = Path(__file__).parents[2] / "examples" / "my_effects.py"


def test_the_documented_example_pulls_as_it_says(arpl_250g):
    catalogue = with_effects_of([EXAMPLE], arpl_250g)
    model = build_model(arpl_250g, effects=[EffectUse("tether", {"stiffness": 0.5})], catalogue=catalogue)
    state = np.array([2.0, -1.0, 1, 0, 0, 0, 1.0, 0, 0, 0, 0, 0, 0])
    force = model.observe(state, np.zeros(4), model.parameter_values, ENVIRONMENT_DEFAULT)[0]
    np.testing.assert_allclose(arpl_250g.body.mass * np.array(force).ravel(), [-1.0, 0.5, 0.0])


def written(folder, text):
    path = folder / "mine.py"
    path.write_text(text)
    return path


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("x = 1", "defines no EFFECT"),
        ("EFFECT = 3", "defines no EFFECT"),
        ("EFFECTS = []", "defines no EFFECT"),
        ("import nothing_of_this_name", "line 1: ModuleNotFoundError"),
        ("def broken(:", "SyntaxError"),
    ],
)
def test_a_file_without_an_effect_is_refused(tmp_path, text, says):
    with pytest.raises(RequestError, match=says):
        read_effects(written(tmp_path, text))


def test_a_file_that_is_not_there_is_refused(tmp_path):
    with pytest.raises(RequestError, match="is no file"):
        read_effects(tmp_path / "absent.py")


def test_a_name_that_is_taken_is_refused(tmp_path, arpl_250g):
    with pytest.raises(RequestError, match="'mass' already"):
        with_effects_of([written(tmp_path, EXAMPLE.read_text().replace('"tether"', '"mass"'))], arpl_250g)


@pytest.mark.parametrize(
    ("change", "says"),
    [(('p["stiffness"]', 'p["stifness"]'), "KeyError"), (('p["stiffness"]', '(p["stiffness"] / 0)'), "no number")],
)
def test_an_effect_that_cannot_be_evaluated_is_refused(tmp_path, arpl_250g, change, says):
    with pytest.raises(RequestError, match=says):
        with_effects_of([written(tmp_path, EXAMPLE.read_text().replace(*change))], arpl_250g)
