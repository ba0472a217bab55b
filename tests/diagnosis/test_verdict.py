"""The verdict is `unknown` where something is left that no effect is, else that of the effects."""

from typing import get_args

import msgspec
import numpy as np
import pytest

from diagnosis.addition import notes_of_set
from diagnosis.data.dataset import make_dataset
from diagnosis.diagnose import diagnose_dataset
from diagnosis.estimation.refusal import Reason, Refused
from diagnosis.likelihood.features import Discrepancy, Line, Smooth
from diagnosis.likelihood.left_over import Left
from diagnosis.report import Diagnosis, MissingEffect, refusal_sentence, sentence
from diagnosis.tried import Tried
from diagnosis.verdict import (
    channel_errors,
    considered,
    judge,
)
from dynamics.effects import CATALOGUE
from dynamics.errors import DataError
from tests.diagnosis.conftest import with_columns
from tests.diagnosis.synthetic import CHANNELS, candidate, effect

ALONE = MissingEffect("a", None, {}, 1.0, ())
AMBIGUOUS = MissingEffect("a", None, {}, 1.0, ("b",))


def left(kind, rms, channel=0, frequency=0.5):
    """A force that is a function of something, or a line, of this RMS."""
    of = Line(frequency, (0,)) if kind == "line" else Smooth(kind, {}, *[np.zeros(0)] * 5, 1.0)
    return Left(Discrepancy(of, channel, 1.0), 12.0, channel, (), (np.full(4, rms),))


@pytest.mark.parametrize(
    ("effects", "expected"), [((), "explained"), ((ALONE,), "effect"), ((AMBIGUOUS,), "ambiguous")]
)
def test_what_is_left_makes_it_unknown_and_nothing_leaves_it_to_the_effects(effects, expected):
    assert judge(effects, ()) == expected
    assert judge(effects, [left("state", 0.1)]) == "unknown"


def test_channel_errors_are_norms_over_the_three_axes():
    floor = np.ones(CHANNELS)
    errors = channel_errors([np.full((50, CHANNELS), 2.0)], [np.ones((50, CHANNELS))], floor, 0.6 * floor)
    assert errors["imu"].before == pytest.approx(2 * np.sqrt(3))
    assert errors["mocap"].after == pytest.approx(np.sqrt(3))
    assert errors["angular"].floor == pytest.approx(np.sqrt(3))
    assert errors["angular"].sensors == pytest.approx(0.6 * np.sqrt(3))
    assert errors["angular"].fast_remainder == pytest.approx(0.8 * np.sqrt(3))
    assert not errors["angular"].at_sensors


SCORES = {"a": 9.0, "b": 4.0, "c": -5.0, "d": None}


def test_what_was_tried_says_what_became_of_it():
    tried = [Tried(candidate(effect(n)), score, (i,), i) for i, (n, score) in enumerate(SCORES.items())]
    listed = considered(tried, [ALONE], [Refused("b", None, "too_small")])
    assert {one.name: one.score for one in listed} == SCORES
    assert [one.outcome for one in listed] == ["named", "refused", "not_selected", "impossible"]


def test_effects_that_look_alike_are_in_the_text_of_unknown():
    both = MissingEffect("mass", None, {}, 1.0, ("thrust_constant", "slung_load"))
    text = sentence(Diagnosis("unknown", (both,), {}, (), (), "land"))
    assert "or else thrust_constant or slung_load" in text


@pytest.mark.parametrize(("factor", "behind"), [(1.0, ()), (1.12, ("thrust_constant", "mass"))])
def test_a_gain_of_commands_that_is_surely_not_one_has_what_may_be_behind_it(plain_flights, arpl_250g, factor, behind):
    """A file whose thrust constant is too large, which flights that log motor signals show as a gain alone."""
    rotors = msgspec.structs.replace(arpl_250g.rotors, thrust_constant=factor * arpl_250g.rotors.thrust_constant)
    vehicle = msgspec.structs.replace(arpl_250g, rotors=rotors)
    flights = [with_columns(flight, signals(flight, vehicle)) for flight in plain_flights]
    diagnosis = diagnose_dataset(make_dataset(flights, vehicle), vehicle, CATALOGUE).diagnosis
    gain = diagnosis.command_gain
    assert gain.value == pytest.approx(1 / factor, abs=max(0.01, 2 * gain.std))
    assert gain.look_alikes == behind
    assert ("Possible causes: thrust_constant or mass" in sentence(diagnosis)) is bool(behind)
    assert diagnosis.verdict == ("ambiguous" if behind else "explained")
    if not behind:
        assert diagnosis.effects == ()
        return
    (effect,) = diagnosis.effects  # a gain, and a torque constant that undoes it: one cause
    assert (effect.name, effect.ambiguous_with[0]) == ("thrust_constant", "torque_constant")
    assert effect.confidence > 0.5
    assert effect.parameters["ratio"].value == gain.value
    with pytest.raises(DataError, match=r"nothing was added: the rotors give 0\.8[89]\d* times .*weigh the vehicle"):
        notes_of_set(diagnosis)


def test_measured_speeds_have_no_gain(plain_flights, arpl_250g):
    dataset = make_dataset(plain_flights[:4], arpl_250g)
    assert diagnose_dataset(dataset, arpl_250g, CATALOGUE).diagnosis.command_gain is None


def signals(flight, vehicle):
    """Motor signals in place of rotor speeds."""
    speeds = {column: None for column in flight.columns if column.startswith("rotor_")}
    return speeds | {f"rotor_command_{i}": flight[f"rotor_speed_{i}"] / vehicle.rotors.speed_max for i in range(4)}


@pytest.mark.parametrize("reason", get_args(Reason))
def test_every_reason_of_a_refusal_has_its_words(reason):
    numbers = dict.fromkeys(("before", "after", "deviations", "required", "share", "odds", "size"), 0.5)
    text = refusal_sentence(Refused("inertia", None, reason, numbers, "angular", {"ratio_x": 0.993}))
    assert text.startswith("inertia (ratio_x = 0.993): ")
    assert len(text) > 50
