"""Effects of a user's own file are candidates, are judged by their own metadata and named in the next flight."""

import dataclasses
from pathlib import Path

import casadi as ca
import numpy as np
import pytest

from diagnosis.data.segment import segments
from diagnosis.estimation.evaluation import require_followed
from diagnosis.estimation.sensor_errors import SensorErrors
from diagnosis.likelihood.columns import candidates as candidates_of
from diagnosis.next_flight import next_flight
from diagnosis.report import MissingEffect
from diagnosis.selection.candidates import make_candidates
from diagnosis.selection.visibility import needs_battery
from diagnosis.thresholds import DEFAULT
from dynamics.effect import Effect, Hidden, Parameter, Prior, Wrench
from dynamics.effects import battery_sag, gust, imu_bias, time_delay
from dynamics.errors import DataError
from dynamics.vehicle import EffectUse
from flights.quality.identifiable import answers
from tests.support.own_effects import given_catalogue

TIME = Parameter("time", "s", "", 1e-5, 1.0, lambda _: Prior(0.1, 0.1))
EXAMPLE = Path(__file__).parents[3] / "examples" / "my_effects.py"


@pytest.fixture(scope="module")
def catalogue(tmp_path_factory, arpl_250g):
    folder = tmp_path_factory.mktemp("effects")
    files = [EXAMPLE]
    for module in (battery_sag, gust, imu_bias, time_delay):  # copies of ours under other names
        name = module.EFFECT.name
        path = folder / f"{name}.py"
        path.write_text(Path(module.__file__).read_text().replace(f'name="{name}"', f'name="my_{name}"'))
        files.append(path)
    return given_catalogue(files, arpl_250g)


@pytest.fixture(scope="module")
def segment(plain_flights, arpl_250g):
    return segments(plain_flights[4], arpl_250g)[0]


@pytest.fixture(scope="module")
def candidates(catalogue, segment, arpl_250g):
    return make_candidates(arpl_250g, catalogue, [segment])


def test_they_are_candidates_on_their_own_grid(candidates):
    assert [c.free for c in candidates if c.effect.name == "tether"] == [("stiffness",)]
    late_drag = [c for c in candidates if c.effect.name == "late_drag"]
    assert [c.at["tau"] for c in late_drag] == [0.1, 0.2, 0.4]
    assert late_drag[0].free == ("coefficient",)


def test_stochastic_ones_are_no_candidates(candidates):
    assert "my_gust" not in {c.effect.name for c in candidates}


def test_a_sensors_usual_errors_have_columns_as_the_catalogues_have(catalogue, segment, arpl_250g):
    for ours, theirs in (("imu_bias", "my_imu_bias"), ("time_delay", "my_time_delay")):
        made = [SensorErrors(arpl_250g, {name: catalogue[name]}, [segment], DEFAULT) for name in (ours, theirs)]
        first, second = (one.columns(segment) for one in made)
        np.testing.assert_allclose(first, second, atol=1e-9)
        assert np.abs(first).max(axis=(0, 1)).min() > 0
        np.testing.assert_allclose(*(one.deviation for one in made))


def test_they_need_what_their_formula_needs(catalogue, arpl_250g):
    assert needs_battery(catalogue["my_battery_sag"], arpl_250g, catalogue)
    assert not needs_battery(catalogue["tether"], arpl_250g, catalogue)


def test_the_next_flight_is_theirs(catalogue):
    late = MissingEffect("late_drag", None, {}, 1.0, ("linear_drag",))
    assert "starts and stops, against steady circles" in next_flight([late], (), (), (), catalogue)
    assert next_flight((), (), (), ["tether"], catalogue) == "to see tether: more aggressive flight"


def test_inspection_answers_for_them_where_they_name_their_excitation(catalogue):
    have = {"specific_force", "velocity", "attitude", "rotor_speed"}
    named = {answer.name: answer for answer in answers(have, {"lateral_speed": 0.5}, catalogue)}
    assert named["late_drag"].answer == "weakly"
    assert "fly starts and stops along a line" in named["late_drag"].why
    assert named["late_drag"].ambiguous_with == "linear_drag"
    assert "tether" not in named


def test_an_effect_that_the_logs_are_too_slow_for_is_left_out_and_named(segment, arpl_250g):
    """A swing of a frequency that its time constant bounds, at which a row takes 100 steps."""
    fast = Effect(
        "swing",
        "",
        "",
        (Parameter("size", "N", "", -1, 1, lambda _: Prior(0.1, 0.1)), TIME),
        hidden=(Hidden("angle", "1", lambda _: 0.0), Hidden("speed", "1/s", lambda _: 0.0)),
        derivative=lambda c, p, h, _: {
            "angle": h["speed"],
            "speed": (c.rate_body[0] - h["angle"]) / p["time"] ** 2 - h["speed"] / p["time"],
        },
        wrench=lambda _, p, h: Wrench(ca.vertcat(p["size"] * h["angle"], 0, 0), ca.SX.zeros(3)),
        grid=lambda vehicle, span: [{"time": seconds} for seconds in (1e-4, 0.1)],
        time_constants=("time",),
    )
    some = {"swing": fast, "imu_bias": imu_bias.EFFECT}
    tried = candidates_of(arpl_250g, some, [segment])
    assert [c.at["time"] for c in tried.all if c.key == "swing"] == [0.1]
    assert tried.not_followed == ()
    faster = dataclasses.replace(fast, grid=lambda vehicle, span: [{"time": 1e-4}])
    tried = candidates_of(arpl_250g, {"swing": faster, "imu_bias": imu_bias.EFFECT}, [segment])
    assert tried.not_followed == ("swing",)
    assert {c.key for c in tried.all} == {"imu_bias"}
    stiff = arpl_250g.with_effects(EffectUse("swing", {"size": 0.1, "time": 1e-4}))
    with pytest.raises(DataError, match="Check the values of swing"):
        require_followed(stiff, some, [segment], DEFAULT.prediction)
