"""The verdict is `unknown` where a test of the residuals rejects, else that of the effects."""

from typing import get_args

import msgspec
import numpy as np
import pytest

from diagnosis.addition import notes_of_set
from diagnosis.data.dataset import make_dataset
from diagnosis.diagnose import diagnose_dataset
from diagnosis.estimation.refusal import Reason, Refused, reason_of
from diagnosis.models.channels import ANGULAR_ACCELERATION
from diagnosis.report import Diagnosis, MissingEffect, refusal_sentence, sentence
from diagnosis.selection.gust import AirMotion, Gust
from diagnosis.selection.residual_tests import TESTS, Finding, Rejection, ResidualTests
from diagnosis.thresholds import DEFAULT
from diagnosis.tried import Tried
from diagnosis.verdict import (
    above_floor,
    channel_errors,
    considered,
    gust_refusal,
    judge,
    rejections,
)
from dynamics.effects import CATALOGUE
from dynamics.errors import DataError
from tests.diagnosis.conftest import with_columns
from tests.diagnosis.synthetic import CHANNELS, candidate, effect, planted, regression

NO_GUST = Gust(0.0, 0.0, 0.0)
LIMITS = DEFAULT.verdict
LARGE = 1.0  # over the floor
ALONE = MissingEffect("a", None, {}, 1.0, ())
AMBIGUOUS = MissingEffect("a", None, {}, 1.0, ("b",))


def results(agreement=1.0, state=0.0, line=2.0, place=0.0, *, over_floor=LARGE):
    """Residual tests with these statistics, all of which find something of one size."""
    names = (*TESTS, "typical_window")
    findings = {name: Finding(name, 0, over_floor, over_floor, (np.ones(3),)) for name in names}
    return ResidualTests(agreement, state, line, place, findings)


CLEAN = results()


def verdict(effects=(), after=CLEAN, before=CLEAN, chi_squares=(1.0, 1.0), gusty=False):
    return judge(effects, rejections(after, before, chi_squares, gusty=gusty))


@pytest.mark.parametrize(("size", "expected"), [(0.91, False), (0.99, False), (1.1, True)])
def test_what_is_at_its_floor_in_every_channel_misses_nothing(size: float, expected: bool):
    floor = np.full(CHANNELS, 0.2)
    floor[-3:] = 0.0  # a kind that the log has not
    quiet = np.tile(0.5 * floor, (40, 1))
    quiet[:, 3:6] = size * floor[3:6]  # one kind alone
    quiet[:, -3:] = 7.0
    assert above_floor([quiet[:10], quiet[10:]], floor) is expected


def test_clean_residuals_leave_the_verdict_to_the_effects():
    assert verdict() == "explained"
    assert verdict([ALONE]) == "effect"
    assert verdict([AMBIGUOUS]) == "ambiguous"


@pytest.mark.parametrize(
    "after",
    [results(6.0), results(state=0.02), results(line=11.0)],
    ids=["agreement", "state", "line"],
)
def test_a_residual_test_that_rejects_makes_it_unknown(after):
    assert verdict([ALONE], after=after) == "unknown"
    assert verdict(after=after) == "unknown"


def test_an_imperfect_form_may_leave_a_share_of_what_was_there_but_no_error_far_above_the_noise():
    assert verdict([ALONE], chi_squares=(100.0, 2.9)) == "effect"
    assert verdict([ALONE], chi_squares=(984.0, 25.0)) == "unknown"
    small, large = (results(state=0.02, over_floor=size) for size in (1.0, 3.0))
    assert verdict([ALONE], after=small, before=results(state=5.0)) == "effect"
    assert verdict([ALONE], after=large, before=results(state=5.0)) == "unknown"


def test_what_is_too_small_to_matter_does_not_make_it_unknown():
    small = LIMITS.min_over_floor / 2
    for large in ({"agreement": 6.0}, {"state": 0.02}, {"line": 11.0}):
        assert verdict([ALONE], after=results(**large, over_floor=small)) == "effect"
        assert verdict(after=results(**large, over_floor=small)) == "explained"
    assert verdict(after=results(over_floor=small), chi_squares=(4.0, 1.6)) == "explained"


def test_a_rejection_says_by_how_much():
    (rejection,) = rejections(results(state=0.02), CLEAN, (1.0, 1.0), gusty=False)
    assert rejection == Rejection("predictable_from_state", 0.02, LIMITS.max_predictable)


def test_a_typical_window_that_stays_far_above_the_noise_makes_it_unknown():
    assert verdict([ALONE], chi_squares=(4.0, 1.6)) == "unknown"
    assert verdict([ALONE], chi_squares=(4.0, 1.4)) == "effect"
    assert verdict([ALONE], chi_squares=(100.0, 2.0)) == "effect"  # a small share of what there was


def test_a_small_share_of_what_there_was_is_the_effects_own_form():
    strong = results(300.0, 1.0)
    assert verdict([ALONE], after=results(8.0, 0.02), before=strong) == "effect"


def test_beside_a_swinging_load_only_a_strong_line_counts():
    assert verdict([ALONE], after=results(line=20.0), chi_squares=None) == "effect"
    assert verdict([ALONE], after=results(line=40.0), chi_squares=None) == "unknown"


def test_a_gust_may_leave_slow_residuals():
    assert verdict([ALONE], after=results(20.0), gusty=True) == "effect"
    assert verdict([ALONE], after=results(20.0, line=11.0), gusty=True) == "unknown"


def test_a_weak_gust_excuses_nothing_that_is_larger_than_itself():
    """Air of 0.01 m/s was named beside torques of five times the floor, and with it every test was silent."""
    for after in (results(20.0, over_floor=2.3), results(state=1.5, over_floor=4.8)):
        assert verdict([ALONE], after=after, gusty=True) == "unknown"
    assert verdict([ALONE], after=results(over_floor=2.0), chi_squares=(9.0, 4.0), gusty=True) == "unknown"


def test_what_state_or_place_predict_is_no_gust(arpl_250g):
    of_all = planted(arpl_250g, [0.0], seed=0)
    air = Gust(float(of_all.total), 100.0, 0.5, 0.01, 1.0, effect=CATALOGUE["gust"])
    selection = AirMotion(air, air, True)
    share = LIMITS.max_gust_predictable
    assert gust_refusal(of_all, selection, results(state=0.9 * share, place=0.5 * share)) is None
    assert gust_refusal(of_all, selection, results(state=2.0, over_floor=LIMITS.min_over_floor / 2)) is None
    of_state, of_place = (
        gust_refusal(of_all, selection, some) for some in (results(state=0.6), results(state=0.1, place=0.7))
    )
    assert (of_state.where, of_place.where) == ("state", "position")
    assert of_place.detail["share"] == pytest.approx(0.7)
    assert of_state.parameters == {"intensity": 0.5}
    calm = AirMotion(air, air, False)
    assert gust_refusal(of_all, calm, results(state=2.0)) is None


def test_what_has_a_line_in_its_spectrum_is_no_gust(arpl_250g):
    """A load that swings was air of 0.27 m/s, by all resamples."""
    random = np.random.default_rng(0)
    slopes = np.zeros((80, CHANNELS, 2))
    slopes[:, 0, 0] = slopes[:, 1, 1] = 2.0
    rows = [random.standard_normal((80, CHANNELS)) for _ in range(6)]
    of_all = regression(arpl_250g, [candidate(CATALOGUE["wind"], 0, 1)], [slopes] * 6, rows)
    air = Gust(1e3, 1e3, 0.5, 1e-3, 1.0, effect=CATALOGUE["gust"])
    selection = AirMotion(air, air, True)

    def with_line(power, rms):
        line = Finding("spectral_line", 0, rms, rms, ())
        return ResidualTests(0.0, 0.0, power, findings={"spectral_line": line}, line_by_chance=12.0)

    assert gust_refusal(of_all, selection, with_line(50.0, 0.25)) is None  # air of 0.5 m/s moves that axis by 1
    assert gust_refusal(of_all, selection, with_line(11.0, 0.7)) is None  # as strong a line comes by chance
    answer = gust_refusal(of_all, selection, with_line(50.0, 0.7))
    assert answer is not None
    assert (answer.reason, answer.where) == ("predictable", "line")
    assert answer.detail["share"] == pytest.approx(0.49)
    assert "no line in its spectrum, but one has 0.49" in reason_of(answer)


def test_air_that_moves_nothing_by_what_matters_is_no_gust(arpl_250g):
    """An estimate's noise is air of a centimetre a second to a vehicle with much drag, surely and on every flight."""
    random, name = np.random.default_rng(0), CATALOGUE["gust"].parameters[0].name
    slopes = np.zeros((80, CHANNELS, 2))
    slopes[:, 0, 0], slopes[:, 1, 1] = 2.0, 1.0
    rows = [random.standard_normal((80, CHANNELS)) for _ in range(6)]
    of_all = regression(arpl_250g, [candidate(CATALOGUE["wind"], 0, 1)], [slopes] * 6, rows)
    required = np.sqrt((1 + DEFAULT.relevance.min_rise) ** 2 - 1) / 2.0  # m/s: by twice as much the first axis moves
    for intensity, refused in ((0.9 * required, True), (1.1 * required, False)):
        air = Gust(1e3, 1e3, intensity, 1e-3 * intensity, 1.0, effect=CATALOGUE["gust"])
        answer = gust_refusal(of_all, AirMotion(air, air, True), results())
        assert (answer is not None) == refused
        if answer is not None:
            assert (answer.reason, answer.where, answer.parameters) == ("too_small", "imu", {name: intensity})
            assert answer.detail == pytest.approx({"signal": 2.0 * intensity, "floor": 1.0})
            assert "moves accelerometer by" in reason_of(answer)


def test_air_that_turns_the_vehicle_and_hardly_pushes_it_is_no_gust(arpl_250g):
    """With flapping in the file turbulence of the rotors was 0.06 m/s of air, by all resamples."""
    random = np.random.default_rng(1)
    slopes = np.zeros((80, CHANNELS, 2))
    slopes[:, ANGULAR_ACCELERATION.start, 0] = slopes[:, ANGULAR_ACCELERATION.start + 1, 1] = 4.0
    slopes[:, 0, 0], slopes[:, 1, 1] = 0.4, 0.4
    rows = [random.standard_normal((80, CHANNELS)) for _ in range(6)]
    of_all = regression(arpl_250g, [candidate(CATALOGUE["wind"], 0, 1)], [slopes] * 6, rows)
    air = Gust(1e3, 1e3, 0.1, 1e-4, 1.0, effect=CATALOGUE["gust"])
    answer = gust_refusal(of_all, AirMotion(air, air, True), results())
    assert answer is not None
    assert (answer.reason, answer.where) == ("too_small", "imu")


def test_channel_errors_are_norms_over_the_three_axes(arpl_250g):
    of_all = planted(arpl_250g, [0.0], seed=0)
    floor = of_all.noise.floor
    errors = channel_errors([np.full((50, CHANNELS), 2.0)], [np.ones((50, CHANNELS))], floor, 0.6 * floor)
    assert errors["imu"].before == pytest.approx(2 * np.sqrt(3))
    assert errors["mocap"].after == pytest.approx(np.sqrt(3))
    assert errors["angular"].floor == pytest.approx(np.sqrt(3))
    assert errors["angular"].sensors == pytest.approx(0.6 * np.sqrt(3))
    assert errors["angular"].fast_remainder == pytest.approx(0.8 * np.sqrt(3))
    assert not errors["angular"].at_sensors


SCORES = {"a": 9.0, "b": 4.0, "c": -5.0, "d": None}


def test_what_was_tried_says_what_became_of_it():
    tried = [Tried(candidate(effect(n), i), score, (i,), i) for i, (n, score) in enumerate(SCORES.items())]
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
    numbers = dict.fromkeys(("deviations", "required", "share", "odds", "size"), 0.5)
    text = refusal_sentence(Refused("inertia", None, reason, numbers, "angular", {"ratio_x": 0.993}))
    assert text.startswith("inertia (ratio_x = 0.993): ")
    assert len(text) > 50
