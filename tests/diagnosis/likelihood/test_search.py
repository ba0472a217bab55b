"""Columns, their sums, a set's evidence, and which effects flights of another simulator name."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy import stats

from diagnosis.likelihood.columns import Candidates, Column, Nuisance
from diagnosis.likelihood.evidence import IMPOSSIBLE, Kind, Search
from diagnosis.likelihood.gain import NoiseSlopes
from diagnosis.likelihood.identify import deviations, identify
from diagnosis.likelihood.problem import Information, Problem
from diagnosis.likelihood.rigid_body import FlightModel
from diagnosis.thresholds.likelihood import LikelihoodThresholds
from diagnosis.tried import not_excited
from dynamics.vehicle import GRAVITY, EffectUse
from tests.diagnosis.likelihood.flights import problem_of

NO_NOISE = NoiseSlopes(
    np.zeros((1, 0)), np.zeros((1, 0)), np.zeros((1, 0)), np.zeros((0, 1, 1)), np.zeros(0), np.zeros(0)
)


@pytest.mark.parametrize(("name", "parameter", "step"), [
    ("linear_drag", "coefficient", 1e-4), ("inertia", "ratio_x", 1e-4), ("mass", "ratio", 1e-4),
    ("time_delay", "delay", 1e-5), ("imu_lever_arm", "z", 1e-4), ("gyro_bias", "y", 1e-5),
    ("rotor_speed_fault", "gain", 1e-5), ("rotor_delay", "delay", 1e-6), ("wind", "x", 1e-3),
])  # fmt: skip
def test_a_column_is_the_slope_of_the_model(name, parameter, step):
    problem = problem_of("nothing", "speeds", 90002, 1)
    what, rows, lift = problem.what, problem.flights[0], np.array([0.0, 0.0, GRAVITY])
    number = next(i for i, c in enumerate(what.all) if c.effect.name == name)
    candidate = what.all[number]
    along = problem.along(0)
    own = problem.inputs(0, along, [number])
    (column,) = own.places([what.places(number)[candidate.free.index(parameter)]])
    ends = []
    for sign in (1, -1):
        values = {**candidate.at, parameter: candidate.at[parameter] + sign * step}
        uses = [*problem.uses, EffectUse(name, values, candidate.rotor)]
        ends.append(FlightModel(problem.vehicle, uses, problem.catalogue).along(rows, along.reference, lift))
    defect = (ends[0].defect - ends[1].defect)[:, :9] / (2 * step)
    read = -(ends[0].difference - ends[1].difference) / (2 * step)
    np.testing.assert_allclose(-own.B[:, :9, column], defect, atol=0.02 * np.abs(defect).max() + 1e-9)
    np.testing.assert_allclose(own.D[:, :, column], read, atol=0.02 * np.abs(read).max() + 1e-9)


def made_up(
    random: np.random.Generator, trusted: float = 1e12
) -> tuple[Problem, list[Information], list[np.ndarray], list[np.ndarray]]:
    """Two flights of three blocks with three effects, a bias of each flight and a discrepancy of each block."""
    problem = problem_of("nothing", "speeds", 90002, 1)
    chosen = [c for c in problem.what.all if c.effect.name in ("mass", "linear_drag", "thrust_constant")]
    columns = tuple(Column(i, c.free[0]) for i, c in enumerate(chosen))
    nuisances = (Nuisance("gyro", 0, 0.4, "flight"), Nuisance("force", 0, 0.2, "block"))
    what = Candidates(tuple(chosen), columns, nuisances)
    thresholds = LikelihoodThresholds(trusted=trusted)
    small = Problem(problem.vehicle, problem.catalogue, problem.flights, what, thresholds=thresholds)
    parts, designs, readings = [], [], []
    for group in range(2):
        X = random.standard_normal((3, 8, 5))
        y = X[:, :, 0] * 0.3 + random.standard_normal((3, 8))
        M, g = np.einsum("bri,brj->bij", X, X), np.einsum("bri,br->bi", X, y)
        parts.append(Information(group, M, g, (y**2).sum(1), 24, 24, -(y**2).sum() / 2))
        designs.append(X)
        readings.append(y)
    return small, parts, designs, readings


def search_of(problem: Problem, parts: list[Information]) -> Search:
    """A search among flights of one kind of logs, whose noise is certain."""
    return Search([Kind(problem, parts, NO_NOISE)], settled=False)


def test_evidence_is_the_ratio_of_the_gaussian_densities():
    """Nuisances and effects as covariances of one long vector: the textbook's answer."""
    problem, parts, designs, readings = made_up(np.random.default_rng(6))
    search = search_of(problem, parts)
    y = np.concatenate([one.ravel() for one in readings])

    def covariance(members: tuple[int, ...]) -> np.ndarray:
        total, first = np.eye(len(y)), 0
        effects = np.concatenate([X[:, :, :3].reshape(-1, 3) for X in designs])
        for i in members:
            total += np.outer(effects[:, i], effects[:, i]) * search.std[i] ** 2
        for X in designs:
            rows = slice(first, first + 24)
            bias = X[:, :, 3].ravel()
            total[rows, rows] += 0.4**2 * np.outer(bias, bias)
            for b in range(3):
                block = slice(first + 8 * b, first + 8 * b + 8)
                total[block, block] += 0.2**2 * np.outer(X[b, :, 4], X[b, :, 4])
            first += 24
        return total

    def log_density(members: tuple[int, ...]) -> float:
        return float(stats.multivariate_normal.logpdf(y, cov=covariance(members)))

    for members in ((0,), (1,), (0, 2), (0, 1, 2)):
        scored = search.score(members)
        if scored.evidence == IMPOSSIBLE:
            continue
        prior = sum(search.log_prior[i] for i in members)
        assert scored.evidence - prior == pytest.approx(log_density(members) - log_density(()), rel=1e-9)
    assert any(search.score(m).evidence != IMPOSSIBLE for m in ((0,), (1,), (2,)))
    assert search.total.base - len(y) / 2 * np.log(2 * np.pi) == pytest.approx(log_density(()), rel=1e-9)


def test_more_of_the_same_flights_makes_a_small_error_of_the_model_no_surer():
    """The evidence is that of trusted seconds: flights ten times as long count no more than these, and say the same."""
    once, often = (made_up(np.random.default_rng(8), trusted) for trusted in (1.0, 1e12))
    seconds = sum(len(rows) * rows.period for rows in once[0].flights)

    def scored(made, times: int, member: int = 1):
        problem, parts, _, _ = made
        longer = dataclasses.replace(problem, flights=[*problem.flights] * times)
        return search_of(longer, list(parts) * times).score((member,))

    gains = [scored(once, times).evidence for times in (1, 10, 100)]
    assert gains[2] - gains[1] < 0.1 * abs(gains[0]) + 0.1
    assert scored(often, 10).evidence > 5 * scored(often, 1).evidence
    assert seconds > 1.0
    np.testing.assert_allclose(scored(once, 100).values, scored(often, 100).values)


def test_an_error_far_beyond_what_sensors_have_is_named_in_flights_of_any_length():
    """Of the evidence only the likelihood is of trusted seconds: a bias of fifteen deviations of healthy sensors stays
    as unlikely, and is the effect's, not the flights' own."""
    problem, parts, _, _ = made_up(np.random.default_rng(9), 1.0)
    column, bias, large = 1, 3, 100.0
    for part in parts:  # the effect is each flight's bias, a hundred a unit, and the readings have nothing else
        part.M[:] *= 1e6
        part.M[:, column], part.M[:, :, column] = large * part.M[:, bias], large * part.M[:, :, bias]
        part.M[:, column, column] = large**2 * part.M[:, bias, bias]
        part.g[:] = 15 * problem.what.nuisances[0].std * part.M[:, :, bias]
    for times in (1, 10, 100):
        longer = dataclasses.replace(problem, flights=[*problem.flights] * times)
        scored = search_of(longer, parts * times).score((column,))
        assert scored.evidence > 0.8 * len(parts) * 15**2 / 2


def test_flights_of_two_kinds_of_logs_count_as_of_one():
    """Where nothing is each kind's own, how flights are told apart changes no score."""
    problem, parts, _, _ = made_up(np.random.default_rng(5), 1.0)
    two = [Kind(dataclasses.replace(problem, flights=problem.flights), [part], NO_NOISE) for part in parts]
    together = search_of(dataclasses.replace(problem, flights=[*problem.flights] * 2), parts)
    apart = Search(two, settled=False)
    for members in ((1,), (0, 2)):
        assert apart.score(members).evidence == pytest.approx(together.score(members).evidence, rel=1e-9)
        np.testing.assert_allclose(apart.score(members).values, together.score(members).values)


def test_a_rival_makes_a_set_that_is_nearly_as_likely():
    problem, parts, _, _ = made_up(np.random.default_rng(6))
    search = search_of(problem, parts)
    best = search.score((1,))
    for within in (0.5, 3.0, 30.0):
        rivals = search.rivals(best, 1, within)
        others = [i for i in (0, 2) if search.score((i,)).evidence >= best.evidence - within]
        assert rivals == others


@pytest.mark.parametrize(("other", "alike"), [("thrust_constant", True), ("linear_drag", False)])
def test_what_looks_like_an_effect_and_fits_as_well_is_its_rival_however_wide_its_prior(other, alike):
    """A rotor with equal losses of thrust and torque has one parameter more than a speed sensor that reads too high."""
    problem, parts, _, _ = made_up(np.random.default_rng(6))
    names = [c.effect.name for c in problem.what.all]
    mass, second = names.index("mass"), names.index(other)
    for part in parts:
        part.M[:, second], part.g[:, second] = part.M[:, mass], part.g[:, mass]
        part.M[:, :, second] = part.M[:, :, mass]
    search = search_of(problem, parts)
    search.std[second] = 1e4 * search.std[mass]
    best = search.score((mass,))
    assert search.score((second,)).evidence < best.evidence - 6
    assert (second in search.rivals(best, mass, 3.0)) == alike


def test_no_impossible_set_is_a_rival_where_the_other_members_alone_are_none_either():
    problem, parts, _, _ = made_up(np.random.default_rng(6))
    names = [c.effect.name for c in problem.what.all]
    mass, thrust, drag = (names.index(name) for name in ("mass", "thrust_constant", "linear_drag"))
    search = search_of(problem, parts)
    best, impossible = search.score((mass, drag)), {"evidence": IMPOSSIBLE, "fit": IMPOSSIBLE}
    for members in ((drag,), (thrust, drag)):
        key = tuple(sorted(members))
        search._scored[key] = dataclasses.replace(search.score(key), **impossible)
    assert best.evidence != IMPOSSIBLE
    assert thrust not in search.rivals(best, mass, 3.0)


def test_a_set_out_of_bounds_or_of_one_effect_twice_is_impossible():
    problem, parts, _, _ = made_up(np.random.default_rng(7))
    search = search_of(problem, parts)
    search.total.g[:] = -1e6  # a mass far below what it may be
    assert search.score((0,)).evidence == IMPOSSIBLE
    assert search.score((0, 0)).evidence == IMPOSSIBLE


def named(problem: Problem) -> tuple[dict[str, dict[str, float]], float, dict[str, float]]:
    """Effects by name, the innovations' chi-square, and each one's deviation."""
    result = identify([problem], ["filtered pose"])
    values = result.search.named_values(result.best)
    std = dict(zip(values, deviations(result.search, result.best), strict=True))  # one value each
    names = {i: problem.what.all[i].key for i in values}
    return {names[i]: own for i, own in values.items()}, result.chi_square, {names[i]: std[i] for i in values}


def test_flights_of_another_simulator_with_nothing_hidden_name_nothing():
    effects, chi_square, _ = named(problem_of("nothing", "speeds", 90002))
    assert effects == {}
    assert chi_square == pytest.approx(1.0, abs=0.03)


def test_a_drag_of_another_simulator_is_named_alone_with_its_value():
    problem = problem_of("single", "rotor_drag", 90000)
    effects, chi_square, std = named(problem)
    assert set(effects) == {"rotor_drag"}
    assert chi_square == pytest.approx(1.0, abs=0.03)
    truth = 6.869e-05
    assert abs(effects["rotor_drag"]["coefficient"] - truth) < 3 * std["rotor_drag"]


def test_an_effect_that_would_not_be_named_at_its_usual_size_was_not_excited():
    problem, parts, _, _ = made_up(np.random.default_rng(4))
    names = [c.effect.name for c in problem.what.all]
    search = search_of(problem, parts)
    usual = search.std[1]
    shown = not_excited(search, ())
    for part in parts:  # the second effect as weak as a hundredth of the noise at its usual size
        part.M[:, 1] *= 0.01 / usual
        part.M[:, :, 1] *= 0.01 / usual
        part.g[:, 1] *= 0.01 / usual
    quiet = not_excited(search_of(problem, parts), ())
    assert names[1] in quiet
    assert set(shown) <= set(quiet)
    assert not_excited(search_of(problem, parts), (1,)) == tuple(n for n in quiet if n != names[1])
