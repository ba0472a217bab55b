"""An effect is accepted where held-out flights agree, and refused where they do not."""

import dataclasses

import msgspec
import numpy as np
import pytest

from diagnosis.data.dataset import Dataset, make_dataset
from diagnosis.estimation import acceptance
from diagnosis.estimation.acceptance import (
    Accepted,
    at_its_bounds,
    deviations_from_neutral,
    fit_that_keeps,
    judged_fit,
)
from diagnosis.estimation.accepted_set import accepted_fit
from diagnosis.estimation.evaluation import reduced_chi_square, residuals_in, typical_chi_square
from diagnosis.estimation.fitted import Fit, ParameterEstimate
from diagnosis.estimation.held_out import HeldOut
from diagnosis.estimation.paired_errors import ErrorChange, ModelErrors, channel_changes, total_change
from diagnosis.estimation.refusal import Refused
from diagnosis.estimation.revision import overshadowed_effects, with_small
from diagnosis.selection.regression_of_flights import make_regression
from diagnosis.selection.rivals import rivals_of
from diagnosis.selection.search import Search
from diagnosis.selection.selected import select
from diagnosis.thresholds import DEFAULT
from dynamics.effects import CATALOGUE
from dynamics.vehicle import EffectUse
from fixtures.planted import planted_flights
from tests.diagnosis.conftest import MANOEUVRES
from tests.diagnosis.synthetic import CHANNELS, candidate, effect, hovering, planted, white

SOME = {name: CATALOGUE[name] for name in ("mass", "imu_bias", "gyro_bias")}


@pytest.fixture(scope="module")
def of_noise(arpl_250g):
    return planted(arpl_250g, [0.0], seed=0)


def noise_rows(seed, count=2):
    random = np.random.default_rng(seed)
    return [random.standard_normal((400, CHANNELS)) for _ in range(count)]


def compared_changes(before, after, of, floor=None):
    level = np.ones(CHANNELS) if floor is None else floor
    return channel_changes(ModelErrors(before), ModelErrors(after), level, 25.0, of.thresholds.relevance)


def worse(before, after, of):
    by_kind = compared_changes(before, after, of)
    return {kind for kind, change in by_kind.items() if change.is_worse()}


def test_an_error_that_rises_in_one_kind_of_channel_is_no_gain_in_another(of_noise):
    before = noise_rows(0)
    after = [y * np.repeat([0.5, 1.0, 1.0, 1.0], 3) for y in before]
    after = [y + np.repeat([0.0, 0.5, 0.0, 0.0], 3) for y in after]
    assert worse(before, after, of_noise) == {"mocap"}
    assert worse(after, before, of_noise) == {"imu"}


def test_a_change_by_chance_is_none(of_noise):
    random = np.random.default_rng(1)
    before = noise_rows(0)
    after = [y + 0.01 * random.standard_normal(y.shape) for y in before]
    assert worse(before, after, of_noise) == set()


def test_one_second_of_chaos_is_chance(of_noise):
    before, after = noise_rows(0), noise_rows(0)
    after[0][:25] *= 12.0
    assert worse(before, after, of_noise) == set()


def test_a_force_that_the_accelerometer_does_not_show_is_contradicted(of_noise):
    force = [0.5 * np.sin(np.arange(400) / 20)[:, None] * np.repeat([1.0, 1.0, 0.0, 0.0], 3) for _ in range(2)]
    limits = of_noise.thresholds.relevance

    def contradicted(shown: float) -> set[str]:
        before = [y + shown * f for y, f in zip(noise_rows(0), force, strict=True)]
        after = [y - f for y, f in zip(before, force, strict=True)]
        compared = compared_changes(before, after, of_noise)
        return {kind for kind, change in compared.items() if change.is_contradicted(limits)}

    assert contradicted(1.0) == set()
    assert contradicted(0.4) == {"imu", "mocap"}


def test_an_effect_on_one_axis_counts_as_much_as_one_on_all(of_noise):
    limits, floor = of_noise.thresholds.relevance, np.ones(CHANNELS)
    floor[6:9] = [10.0, 10.0, 1.0]
    after = [y * floor for y in noise_rows(0)]
    wave = 2.0 * np.sin(np.arange(400) / 20)[:, None] * floor
    about_z = wave * (np.arange(CHANNELS) == 8)
    one, every = (
        compared_changes([y + more for y in after], after, of_noise, floor)["angular"] for more in (about_z, wave)
    )
    assert one.fall == pytest.approx(every.fall, rel=0.2)
    assert one.fall > limits.min_rise
    assert one.before == pytest.approx(np.sqrt(np.mean(np.sum((after[0] + about_z)[:, 6:9] ** 2, axis=1))), rel=0.05)
    assert every.rise == pytest.approx(-every.fall, rel=0.3)


def test_what_one_axis_gains_and_the_others_lose_is_a_loss_in_sum(of_noise):
    before = noise_rows(0)
    gains, loses = np.zeros(CHANNELS), np.zeros(CHANNELS)
    gains[2], loses[:2] = 0.7, 1.4
    after = [y * (1 - gains) + loses * np.sin(np.arange(400) / 20)[:, None] for y in before]
    limits = of_noise.thresholds.relevance
    by_kind = compared_changes(before, after, of_noise)
    assert by_kind["imu"].fall > limits.min_rise
    assert total_change(by_kind) > 0 > total_change(compared_changes(after, before, of_noise))


def test_what_errors_of_measured_states_make_of_a_model_is_no_error_of_the_model(of_noise):
    """A model with the drag that is there is right, and feels an error of velocity that one without it does not."""
    random, drag = np.random.default_rng(3), 0.5
    velocity, error, drawn = (smooth(random, size) for size in (1.0, 1.5, 1.5))
    without = [y - drag * velocity for y in noise_rows(0)]
    right = [y + drag * error for y in noise_rows(0)]  # measured velocities are the true ones and the error
    assert "imu" in worse(without, right, of_noise)
    of_inputs = [[drag * drawn] * 2]
    before, after = ModelErrors(without, [[0 * drawn] * 2]), ModelErrors(right, of_inputs)
    compared = channel_changes(before, after, np.ones(CHANNELS), 25.0, of_noise.thresholds.relevance)
    assert not any(change.is_worse() for change in compared.values())
    fallen = -np.mean(compared["imu"].by_axis)  # the mean square of what the drag pushes, of unit velocity
    assert fallen == pytest.approx(drag**2, abs=0.15)
    assert compared["imu"].size == pytest.approx(drag * np.sqrt(3), rel=0.3)


def smooth(random, size):
    """(400, 12) slow motion that the accelerometer feels, m/s^2 in each axis."""
    angle = np.arange(400)[:, None] / random.uniform(8, 20, CHANNELS) + random.uniform(0, 6, CHANNELS)
    return size * np.sqrt(2) * np.sin(angle) * np.repeat([1.0, 0.0, 0.0, 0.0], 3)


def test_what_else_is_missing_does_not_hide_a_change(of_noise):
    gust = [3 * np.sin(np.arange(400) / 30)[:, None] for _ in range(2)]
    before = [y + 0.5 * np.cos(np.arange(400))[:, None] for y in noise_rows(0)]
    clear, hidden = (
        compared_changes(
            [b + g for b, g in zip(before, more, strict=True)],
            [y + g for y, g in zip(noise_rows(0), more, strict=True)],
            of_noise,
        )["imu"]
        for more in ([0.0, 0.0], gust)
    )
    assert hidden.rise == pytest.approx(clear.rise, rel=0.15)


def test_noise_alone_has_a_reduced_chi_square_of_one(of_noise):
    rows = noise_rows(3, count=10)
    assert reduced_chi_square(rows, white()) == pytest.approx(1.0, abs=0.03)
    assert typical_chi_square(rows, of_noise) == pytest.approx(1.0, abs=0.03)


def test_a_parameter_at_a_bound_stands_in_for_something_else(arpl_250g):
    free = candidate(effect("a", bound=1.0), 0)

    def fitted(value):
        return Fit(arpl_250g, {("a", "size"): ParameterEstimate(value, 0.1, "1")}, (free,))

    assert at_its_bounds(fitted(1.0), free, arpl_250g) == "size"
    assert at_its_bounds(fitted(0.5), free, arpl_250g) is None
    positive = candidate(effect("a", lowest=0.0), 0)
    assert at_its_bounds(fitted(0.0), positive, arpl_250g) == "size"
    own = arpl_250g.with_effects(EffectUse("a", {"size": 0.5}))
    assert at_its_bounds(fitted(0.0), positive, own) is None  # the file names an effect that does not exist


def test_a_rotor_that_lost_torque_alone_is_no_rotor_that_lost_thrust(arpl_250g):
    """One stood in for a torque constant, beside effects that the flights show well."""
    weak = dataclasses.replace(candidate(CATALOGUE["weak_rotor"], 0, 1), rotor=2)
    estimates = {
        (weak.key, "loss"): ParameterEstimate(0.0005, 0.001, "1"),
        (weak.key, "torque_loss"): ParameterEstimate(0.32, 0.01, "1"),
    }
    of_torque = Fit(arpl_250g, estimates, (weak,), np.diag([0.001**2, 0.01**2]))
    assert deviations_from_neutral(of_torque, weak, arpl_250g) == pytest.approx(0.5)
    assert deviations_from_neutral(Fit(arpl_250g, {}, (weak,)), weak, arpl_250g) == 0.0  # nothing of it was fitted


@pytest.mark.parametrize(("held_out_ratio", "accepted"), [(1.05, ["mass"]), (1.0, [])])
def test_a_mass_that_the_held_out_flights_contradict_is_refused(arpl_250g, held_out_ratio, accepted):
    fitted = hovering(arpl_250g, mass_ratio=1.05, seed=4, count=4)
    held_out = hovering(arpl_250g, mass_ratio=held_out_ratio, seed=5, count=2)
    dataset = Dataset(fitted, (0, 1, 2, 3), held_out, {}, ())
    regression = make_regression(arpl_250g, SOME, fitted, dataset.flight_of)
    selection = select(regression)
    assert selection.chosen.names == {"mass"}
    result = accepted_fit(regression, selection, dataset)
    assert [c.key for c in result.fit.candidates] == accepted
    assert [r.name for r in result.refused] == [n for n in ("mass",) if n not in accepted]
    before, after = (
        reduced_chi_square(residuals_in(regression, vehicle, held_out), regression.noise)
        for vehicle in (arpl_250g, result.fit.vehicle)
    )
    assert after <= before


def test_an_effect_without_which_nothing_can_be_predicted_stays(arpl_250g, monkeypatch):
    """The others' values without it, by the linearised equations, may be impossible, and no error a number."""
    fitted = hovering(arpl_250g, mass_ratio=1.05, seed=4, count=4)
    dataset = Dataset(fitted, (0, 1, 2, 3), hovering(arpl_250g, mass_ratio=1.05, seed=5, count=2), {}, ())
    regression = make_regression(arpl_250g, SOME, fitted, dataset.flight_of)
    impossible = arpl_250g.with_effects(EffectUse("mass", {"ratio": float("nan")}))
    monkeypatch.setattr(acceptance, "left_out", lambda *_: ({}, impossible))
    result = accepted_fit(regression, select(regression), dataset)
    assert [c.key for c in result.fit.candidates] == ["mass"]


def test_what_makes_a_channel_worse_gives_way_to_a_rival_that_does_not(plain_flights, arpl_250g):
    """Wrong thrust and wrong mass push alike; in the moments the thrust's error would show."""
    body = msgspec.structs.replace(arpl_250g.body, mass=arpl_250g.body.mass / 1.06)
    light = msgspec.structs.replace(arpl_250g, body=body)
    undecided = msgspec.structs.replace(DEFAULT.acceptance, max_redundant_ratio=100.0)  # fits alone do not choose
    thresholds = msgspec.structs.replace(DEFAULT, acceptance=undecided)
    data = make_dataset(plain_flights, light)
    catalogue = {name: CATALOGUE[name] for name in ("mass", "thrust_constant", "imu_bias", "gyro_bias")}
    regression = make_regression(light, catalogue, data.fitted, data.flight_of, thresholds)
    (thrust,) = (c for c in regression.candidates if c.effect.name == "thrust_constant")
    selection = dataclasses.replace(select(regression), chosen=Search(regression).score([thrust]))
    result = accepted_fit(regression, selection, data)
    assert [(one.name, one.reason) for one in result.refused] == [("thrust_constant", "channel_worse")]
    assert result.fit.estimates["mass", "ratio"].value == pytest.approx(1.06, abs=0.005)


@pytest.mark.parametrize(
    ("falls", "left", "named"),
    [
        ((2.0, 0.0, 0.0), (10.0, 10.0, 40.0), False),  # a fifth of what is left of an axis, a thirtieth of the kind
        ((2.0, 0.0, 0.0), (0.1, 10.0, 40.0), True),  # nothing is left of its own axis
        ((2.0, 2.0, 2.0), (10.0, 10.0, 10.0), True),
        ((2.9, 0.0, 0.0), (6.0, 300.0, 300.0), False),  # half of what is left of its axis, beside 200 times as much
    ],
)
def test_a_form_that_explains_next_to_nothing_of_what_is_left_is_not_named(arpl_250g, falls, left, named):
    one = candidate(effect("a"), 0)
    fitted = Fit(arpl_250g, {("a", "size"): ParameterEstimate(1.0, 0.1, "1")}, (one,))
    before, after = (np.sqrt(np.sum(np.array(left) + 1 + sign * np.array(falls))) for sign in (1, 0))
    change = ErrorChange(before, after, np.sqrt(3.0), tuple(-np.array(falls)), left, -5.0)
    accepted = Accepted(fitted, (), {"a": {"mocap": change}}, {"a": 1.0}, np.ones(CHANNELS))
    refused = overshadowed_effects(accepted, DEFAULT.consistency)
    assert [(r.name, r.reason, r.where) for r in refused] == ([] if named else [("a", "overshadowed", "mocap")])


def test_a_rival_that_stands_in_the_set_already_is_no_rival(arpl_250g):
    """The third effect is the nearest rival of the first: one effect twice is no model."""
    regression = planted(arpl_250g, [3.0, 0.0, 2.0], seed=4)
    a, b, c = regression.candidates
    chosen = [a, b, c]
    for place, candidate_of in enumerate(chosen):
        others = [other for i, other in enumerate(chosen) if i != place]
        rivals = rivals_of(Search(regression), others, candidate_of)
        assert [len({r.key for r in s.candidates}) for s in rivals] == [3] * len(rivals)
    assert len(rivals_of(Search(regression), [b], a)) == 2  # c stands for a where it is not there yet


@pytest.mark.slow
def test_effects_that_together_make_a_channel_worse_are_not_both_named(arpl_250g, monkeypatch):
    """Each is judged beside the other: two that oppose each other help one by one."""
    hidden = [EffectUse("linear_drag", {"coefficient": 0.08}), EffectUse("rotational_damping", {"coefficient": 4e-3})]
    names = ("linear_drag", "rotational_damping", "imu_bias", "gyro_bias", "time_delay")
    data = make_dataset(planted_flights(arpl_250g, hidden, seed=8, manoeuvres=MANOEUVRES), arpl_250g)
    regression = make_regression(arpl_250g, {n: CATALOGUE[n] for n in names}, data.fitted, data.flight_of)
    selection = select(regression)
    assert set(accepted_fit(regression, selection, data).fit.keys) == {"linear_drag", "rotational_damping"}
    compare = HeldOut.channel_changes

    def opposed(judge, before, after, floor):
        by_kind, added = compare(judge, before, after, floor), len(after.effects) - len(before.effects)
        if added < 2:
            return by_kind
        return {**by_kind, "angular": dataclasses.replace(by_kind["angular"], by_axis=(0.5,) * 3, deviations=5.0)}

    monkeypatch.setattr(HeldOut, "channel_changes", opposed)
    result = accepted_fit(regression, selection, data)
    assert len(result.fit.keys) < 2
    first = result.refused[0]
    assert (first.name, first.reason, first.where) == ("linear_drag", "channel_worse", "angular")


def test_what_was_refused_beside_other_effects_and_is_named_is_not_both(arpl_250g):
    """It was taken for small and tried a second time beside itself: "given twice", which no user can mend."""
    fitted = hovering(arpl_250g, mass_ratio=1.05, seed=4, count=4)
    dataset = Dataset(fitted, (0, 1, 2, 3), hovering(arpl_250g, mass_ratio=1.05, seed=5, count=2), {}, ())
    regression = make_regression(arpl_250g, SOME, fitted, dataset.flight_of)
    chosen = select(regression).chosen.candidates
    before = [Refused("mass", None, "too_small"), Refused("rotor_drag", None, "too_small")]
    accepted = judged_fit(regression, chosen, dataset, arpl_250g, refused=before)
    assert accepted.fit.keys == ("mass",)
    assert [one.name for one in accepted.refused] == ["rotor_drag"]
    assert with_small(regression, accepted, chosen, dataset) is None


def test_a_trial_ends_where_what_it_needs_fails(arpl_250g, monkeypatch):
    fitted = hovering(arpl_250g, mass_ratio=1.05, seed=4, count=4)
    dataset = Dataset(fitted, (0, 1, 2, 3), hovering(arpl_250g, mass_ratio=1.05, seed=5, count=2), {}, ())
    regression = make_regression(arpl_250g, SOME, fitted, dataset.flight_of)
    both = [c for c in regression.candidates if c.key in ("mass", "imu_bias")]
    trial = fit_that_keeps(regression, both, ["mass"], dataset, arpl_250g)
    assert trial is not None
    assert trial.fit.keys == judged_fit(regression, both, dataset, arpl_250g).fit.keys == ("mass",)
    judged, judge = [], HeldOut.channel_changes

    def counted(held_out, before, after, floor):
        judged.append(after)
        return judge(held_out, before, after, floor)

    monkeypatch.setattr(HeldOut, "channel_changes", counted)
    judged_fit(regression, both, dataset, arpl_250g)
    of_all = len(judged)
    assert fit_that_keeps(regression, both, ["imu_bias"], dataset, arpl_250g) is None
    assert len(judged) - of_all < of_all


@pytest.mark.slow
def test_an_effect_that_helps_where_it_does_not_act_alone_is_not_named(arpl_250g, monkeypatch):
    """An inertia of 1.27 lowered the vertical force by the thrust of commands that fitted beside it, and no torque."""
    hidden = [EffectUse("rotational_damping", {"coefficient": 4e-3})]
    names = ("rotational_damping", "imu_bias", "gyro_bias", "time_delay")
    data = make_dataset(planted_flights(arpl_250g, hidden, seed=8, manoeuvres=MANOEUVRES), arpl_250g)
    regression = make_regression(arpl_250g, {n: CATALOGUE[n] for n in names}, data.fitted, data.flight_of)
    (damping,) = (c for c in regression.candidates if c.effect.name == "rotational_damping")
    assert judged_fit(regression, [damping], data, arpl_250g).fit.keys == ("rotational_damping",)
    compare = HeldOut.channel_changes

    def elsewhere(judge, before, after, floor):
        by_kind = compare(judge, before, after, floor)
        angular = dataclasses.replace(by_kind["angular"], by_axis=(0.01, 0.0, 0.0), deviations=0.5)
        return {**by_kind, "angular": angular, "mocap": dataclasses.replace(by_kind["mocap"], by_axis=(0.0, 0.0, -0.3))}

    monkeypatch.setattr(HeldOut, "channel_changes", elsewhere)
    (refused,) = judged_fit(regression, [damping], data, arpl_250g).refused
    assert (refused.name, refused.reason, refused.where) == ("rotational_damping", "channel_worse", "angular")
