"""Advice is about what a diagnosis leaves open: look-alikes, leftovers, hints; else about what was not excited."""

import pytest

from diagnosis.estimation.refusal import Refused
from diagnosis.next_flight import MAX_ADVICE, NOTHING, next_flight, next_reference
from diagnosis.regimes import Failure
from diagnosis.report import REMAINS, Leftover, MissingEffect, Seconds, evidence_sentence, leftover_sentence
from dynamics.effects import CATALOGUE

FAST = Failure("speed m/s", 3.0, 5.0, "imu", 2.5)


def left(test="predictable_from_state", channel="imu x", frequency=None, regimes=(FAST,)):
    seconds = (Seconds("logs/one.csv", 10.0, 12.0, 3.2),)
    return Leftover(test, channel, 0.05, 0.01, 0.2, 1.4, "m/s^2", frequency, seconds, regimes)


def advice(effects=(), leftover=(), refused=(), not_excited=()):
    return next_flight(effects, leftover, refused, not_excited, CATALOGUE)


def test_nothing_is_open_only_where_nothing_is():
    assert advice() == NOTHING
    assert "axial_inflow" in advice(not_excited=["axial_inflow", "wind"])
    assert NOTHING not in advice(leftover=[left()])


@pytest.mark.parametrize("test", REMAINS)
def test_every_leftover_has_advice_and_words_of_its_own(test):
    text = advice(leftover=[left(test, frequency=4.0 if test == "spectral_line" else None)], not_excited=["wind"])
    assert text.startswith("about ")
    assert "wind" not in text
    assert REMAINS[test] in leftover_sentence(left(test))


def test_a_line_is_named_by_its_frequency_and_what_changes_with_time_is_warmed_up():
    assert "line at 4 Hz" in advice(leftover=[left("spectral_line", frequency=4.0)])
    assert "warm motors" in advice(leftover=[left("predictable_from_time")])


def test_look_alikes_come_first_and_hints_last():
    alike = MissingEffect("mass", None, {}, 1.0, ("thrust_constant",))
    hint = Refused("axial_inflow", None, "unsure", {"odds": 4.0, "required": 20.0})
    small = Refused("wind", None, "too_small")
    text = advice([alike], [left()], [hint, small])
    assert text.index("to tell mass from thrust_constant") < text.index("about what the state predicts")
    assert text.index("about what the state predicts") < text.index("to confirm axial_inflow")
    assert "wind" not in text


def test_the_reference_is_for_what_is_open_and_a_manoeuvre_shows():
    alike = MissingEffect("mass", None, {}, 1.0, ("thrust_constant",))
    sure = MissingEffect("rotor_drag", None, {}, 1.0, ())
    hint = Refused("axial_inflow", None, "unsure", {"odds": 4.0, "required": 20.0})
    reference = next_reference([sure, alike], [hint], ["inertia"], CATALOGUE)
    assert reference == "identify:for=mass+thrust_constant+axial_inflow"
    assert next_reference([], [], ["gust", "wall_effect", "inertia"], CATALOGUE) == "identify:for=inertia"
    assert next_reference([sure], [], [], CATALOGUE) == ""


def test_there_are_never_more_than_a_few():
    effects = [
        MissingEffect(name, None, {}, 1.0, ("mass",)) for name in ("thrust_constant", "slung_load", "inertia", "wind")
    ]
    assert advice(effects).count("to tell") == MAX_ADVICE


def test_evidence_says_when_and_where():
    text = evidence_sentence(left())
    assert "log of the odds 0.05, required 0.01" in text
    assert "one.csv 10.0 to 12.0 s" in text
    assert "speed m/s 3 to 5" in text
