"""An effect is accepted where held-out flights agree, and refused where they do not."""

import numpy as np
import pytest

from diagnosis.data.dataset import Dataset
from diagnosis.estimation.acceptance import accepted_fit, at_its_bounds, confirmed
from diagnosis.estimation.equation_error import Fit, ParameterEstimate
from diagnosis.estimation.evaluation import reduced_chi_square, residuals_in, typical_chi_square
from diagnosis.selection.regression import make_regression
from diagnosis.selection.search import select
from dynamics.effects import CATALOGUE
from tests.diagnosis.synthetic import CHANNELS, candidate, effect, hovering, planted, white

SOME = {name: CATALOGUE[name] for name in ("mass", "imu_bias", "gyro_bias")}


@pytest.fixture(scope="module")
def of_noise(arpl_250g):
    return planted(arpl_250g, [0.0], seed=0)


def noise_rows(seed, count=2):
    random = np.random.default_rng(seed)
    return [random.standard_normal((400, CHANNELS)) for _ in range(count)]


def test_what_raises_the_held_out_error_is_refused_and_what_lowers_it_is_not(of_noise):
    good = noise_rows(0)
    bad = [y + np.sin(np.arange(400) / 10)[:, None] for y in good]
    assert not confirmed(good, bad, of_noise)
    assert confirmed(bad, good, of_noise)


def test_flights_on_which_nothing_changes_cannot_refuse(of_noise):
    rows = noise_rows(0)
    slightly = [y * 1.0001 for y in rows]
    assert confirmed(rows, slightly, of_noise)


def test_seconds_of_chaos_do_not_outweigh_a_better_typical_window(of_noise):
    before = [y + 0.7 for y in noise_rows(0)]
    after = noise_rows(0)
    after[0][:50] *= 12.0  # worse in the mean
    assert reduced_chi_square(after, of_noise.noise) > reduced_chi_square(before, of_noise.noise)
    assert typical_chi_square(after, of_noise) < typical_chi_square(before, of_noise)
    assert confirmed(before, after, of_noise)


def test_noise_alone_has_a_reduced_chi_square_of_one(of_noise):
    rows = noise_rows(3, count=10)
    assert reduced_chi_square(rows, white()) == pytest.approx(1.0, abs=0.03)
    assert typical_chi_square(rows, of_noise) == pytest.approx(1.0, abs=0.03)


def test_a_parameter_at_a_bound_stands_in_for_something_else(arpl_250g):
    free = candidate(effect("a", bound=1.0), 0)

    def fitted(value):
        return Fit(arpl_250g, {("a", "size"): ParameterEstimate(value, 0.1, "1")}, (free,))

    assert at_its_bounds(fitted(1.0), free)
    assert not at_its_bounds(fitted(0.5), free)
    assert not at_its_bounds(fitted(0.0), free)


@pytest.mark.parametrize(("held_out_ratio", "accepted"), [(1.05, ["mass"]), (1.0, [])])
def test_a_mass_that_the_held_out_flights_contradict_is_refused(arpl_250g, held_out_ratio, accepted):
    fitted = hovering(arpl_250g, mass_ratio=1.05, seed=4, count=4)
    held_out = hovering(arpl_250g, mass_ratio=held_out_ratio, seed=5, count=2)
    dataset = Dataset(fitted, (0, 1, 2, 3), held_out, {}, ())
    regression = make_regression(arpl_250g, SOME, fitted, dataset.flight_of)
    selection = select(regression)
    assert selection.chosen.names == {"mass"}
    result = accepted_fit(regression, selection, dataset)
    assert [c.key for c in result.candidates] == accepted
    before, after = (
        reduced_chi_square(residuals_in(regression, vehicle, held_out), regression.noise)
        for vehicle in (arpl_250g, result.vehicle)
    )
    assert after <= before
