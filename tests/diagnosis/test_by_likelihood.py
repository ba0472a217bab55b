"""The likelihood's answer as diagnosis gives it: its filters, its values, and what is taken back."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import msgspec
import numpy as np
import pytest

from diagnosis import by_likelihood
from diagnosis.by_likelihood import (
    LikelihoodAnswer,
    answer_beside,
    answer_by_likelihood,
    fit_of,
    problems_of,
)
from diagnosis.data.dataset import Dataset, read_dataset
from diagnosis.diagnose import diagnose_dataset
from diagnosis.estimation.fitted import left_out
from diagnosis.estimation.refusal import Refused
from diagnosis.likelihood.evidence import Sums
from diagnosis.likelihood.left_over import LeftOver
from diagnosis.thresholds import DEFAULT
from diagnosis.tried import tried_by_likelihood
from dynamics.effects import CATALOGUE
from dynamics.errors import DataError
from dynamics.vehicle import Vehicle
from fixtures.real_flights import DATA, px4_sih


@cache
def twice_the_drag() -> tuple[Dataset, Vehicle, LikelihoodAnswer]:
    """Flights of PX4's firmware with twice the drag of the file."""
    vehicle = px4_sih()
    logs = [DATA / "px4_sih_flights" / f"{name}.ulg.gz" for name in ("drag2_1_circle", "drag2_4_lemniscate")]
    dataset = read_dataset(logs, vehicle)
    return dataset, vehicle, answer_by_likelihood(dataset, vehicle, CATALOGUE)


def test_logs_of_two_kinds_have_a_filter_each():
    dataset, vehicle, _ = twice_the_drag()
    first, *others = dataset.fitted
    for other in (replace(first, rate=2 * first.rate), replace(first, specific_force=None)):
        mixed = replace(dataset, fitted=(other, *others))
        problems = problems_of(mixed, vehicle, CATALOGUE)
        assert [len({rows.readings for rows in one.flights}) for one in problems] == [1, 1]
        assert sum(len(one.flights) for one in problems) == len(mixed.fitted)
        assert all(one.what.all == problems[0].what.all for one in problems)


def test_a_long_flight_is_filtered_in_pieces_without_a_gap():
    dataset, vehicle, answer = twice_the_drag()
    short = answer.search.problem.thresholds.seconds / 4
    limits = DEFAULT.likelihood
    thresholds = msgspec.structs.replace(DEFAULT, likelihood=msgspec.structs.replace(limits, seconds=short))
    parts = (problem := problems_of(dataset, vehicle, CATALOGUE, thresholds)[0]).flights
    assert problem.thresholds is thresholds.likelihood
    assert max(len(rows) * rows.period for rows in parts) <= short + parts[0].period
    assert {rows.group for rows in parts} == set(dataset.flight_of)
    lasting = sum(segment.duration for segment in dataset.fitted)
    assert sum(rows.segment.duration for rows in parts) == pytest.approx(lasting)


def test_where_no_filter_fits_the_readings_the_answer_is_a_refusal(monkeypatch):
    dataset, vehicle, _ = twice_the_drag()

    def none(*_, **__):
        raise np.linalg.LinAlgError("no stationary solution")

    monkeypatch.setattr(by_likelihood, "identify", none)
    with pytest.raises(DataError, match=r"no filter can follow the readings.*Wanted gyro and rotors"):
        diagnose_dataset(dataset, vehicle, CATALOGUE)


def test_the_report_has_the_likelihoods_values_and_deviations():
    _, vehicle, answer = twice_the_drag()
    (effect,) = answer.missing()
    (estimate,) = answer.accepted.fit.estimates.values()
    assert effect.name == "linear_drag"
    assert effect.parameters["coefficient"].value == estimate.value
    assert effect.parameters["coefficient"].std == estimate.std > 0
    assert effect.confidence > 0.95
    fitted = {use.name: use.parameters for use in answer.accepted.fit.vehicle.effects}
    assert fitted["linear_drag"]["coefficient"] == estimate.value
    own = next(use.parameters["coefficient"] for use in vehicle.effects if use.name == "linear_drag")
    assert abs(estimate.value - own) > 5 * estimate.std


def test_the_ranking_has_the_odds_of_each_effect_beside_the_named_ones():
    _, _, answer = twice_the_drag()
    (named,) = answer.named
    first, *others = tried_by_likelihood(answer.search, [named.number])
    assert (first.number, first.score) == (named.number, pytest.approx(named.log_odds))
    required = answer.search.problem.thresholds.named
    assert all(one.score is None or one.score < required for one in others)
    assert len({one.candidate.effect.name for one in (first, *others)}) == 1 + len(others)


def test_an_effect_that_is_not_named_is_fitted_beside_those_that_are():
    _, _, answer = twice_the_drag()
    (named,) = answer.named
    mass = next(one for one in tried_by_likelihood(answer.search, [named.number]) if one.candidate.key == "mass")
    both, alone = (fit_of(answer.search, some) for some in ([named.number, mass.number], [named.number]))
    assert {key for key, _ in both.estimates} == {"linear_drag", "mass"}
    drag, mass_ratio = both.estimates["linear_drag", "coefficient"], both.estimates["mass", "ratio"]
    assert abs(mass_ratio.value - 1.0) < 3 * mass_ratio.std
    assert drag.std >= alone.estimates["linear_drag", "coefficient"].std


def test_without_the_effect_held_out_errors_rise():
    _, vehicle, answer = twice_the_drag()
    fit = answer.accepted.fit
    _, fewer = left_out(fit, fit.candidates[0], vehicle)
    assert {use.name: use.parameters for use in fewer.effects}["linear_drag"]["coefficient"] == pytest.approx(1.0)


def test_an_effect_that_is_taken_back_leaves_nothing_of_its_values():
    _, vehicle, answer = twice_the_drag()
    refused = Refused("linear_drag", None, "another_form", {"share": 1.0, "required": 0.2})
    rest = answer.without([refused])
    assert rest.missing() == ()
    assert rest.accepted.refused == (refused,)
    own = next(use.parameters for use in vehicle.effects if use.name == "linear_drag")
    assert next(u.parameters for u in rest.accepted.fit.vehicle.effects if u.name == "linear_drag") == own
    assert set(rest.accepted.fit.commands) == set(answer.accepted.fit.commands)


@pytest.mark.parametrize(
    ("odds", "share", "reason"), [(1.0, 0.0, "unsure"), (50.0, 0.4, "another_form"), (50.0, 0.1, None)]
)
def test_an_effect_must_be_likely_and_of_its_own_form_beside_what_is_left(odds, share, reason):
    _, _, answer = twice_the_drag()
    (named,) = answer.named
    left = LeftOver((), (), {named.number: odds}, {named.number: share})
    rest = answer_beside(answer, left)
    assert [one.candidate.identity for one in rest.named] == ([] if reason else [named.candidate.identity])
    assert [one.reason for one in rest.accepted.refused] == ([reason] if reason else [])
    if reason == "unsure":
        assert rest.accepted.refused[0].detail["odds"] == pytest.approx(np.exp(odds))


def test_information_beside_commands_is_what_is_left_when_all_else_is_marginalised():
    random = np.random.default_rng(3)
    root = random.standard_normal((12, 7))
    full = root.T @ root  # four effects, then two values of commands, then one of the noise
    rest, own, places, count = [0, 1, 2, 3], [4, 5, 6], [3, 1], 2
    inverse, across = np.linalg.inv(full[np.ix_(own, own)]), full[np.ix_(own, rest)]
    M = full[np.ix_(rest, rest)] - across.T @ inverse @ across
    none = np.zeros(4)
    total = Sums(M, none, M[None], none[None], none, (inverse, across, np.zeros(3)), 0.0)
    joint = np.linalg.inv(full[np.ix_([*places, *own], [*places, *own])])[:4, :4]
    np.testing.assert_allclose(total.information(places, count), np.linalg.inv(joint), rtol=1e-9)
