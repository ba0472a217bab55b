"""Random slow air is distinguished from white noise, with about its strength."""

import dataclasses

import numpy as np
import pytest

from diagnosis.models.pose_errors import PoseErrors
from diagnosis.selection.air_motion import cosines, spectral_weights
from diagnosis.selection.candidates import Candidate
from diagnosis.selection.gust import Gust, _is_gust, air_beside, gust_beside, gust_variance
from dynamics.effects import CATALOGUE
from tests.diagnosis.synthetic import CHANNELS, candidate, effect, planted, regression

ROWS, RATE, FLIGHTS = 250, 25.0, 3


def blown(vehicle, *, intensity: float, seed: int, catalogue=CATALOGUE, drag: float = 0.0, count: int = ROWS):
    """Flights whose x and y forces are those of air with a corner at 0.15 Hz; 1 m/s gives 1 unit of force.

    drag: coefficient of another slow force along x.
    """
    random = np.random.default_rng(seed)
    column = np.zeros((count, CHANNELS, 3))
    for axis in range(3):
        column[:, axis, axis] = column[:, 3 + axis, axis] = 1.0
    rows = []
    columns = []
    for _ in range(FLIGHTS):
        spectrum = np.fft.rfft(random.standard_normal((count, 2)), axis=0)
        frequency = np.fft.rfftfreq(count, 1 / RATE)
        air = np.fft.irfft(spectrum / np.sqrt(1 + (frequency / 0.15) ** 2)[:, None], count, axis=0)
        y = random.standard_normal((count, CHANNELS))
        y[:, 0:2] += intensity * air / air.std()
        y[:, 3:5] += intensity * air / air.std()
        slow = np.cumsum(random.standard_normal((count, 1)), axis=0) / 5
        force = np.zeros((count, CHANNELS, 1))
        force[:, [0, 3], 0] = slow
        columns.append(np.concatenate([column, force], axis=2))
        rows.append(y + drag * force[:, :, 0])
    wind = Candidate(CATALOGUE["wind"], None, {"x": 0.0, "y": 0.0, "z": 0.0}, ("x", "y", "z"), (0, 1, 2))
    candidates = [wind, candidate(effect("drag"), 3)]
    return regression(vehicle, candidates, columns, rows, catalogue={**catalogue, "drag": candidates[1].effect})


def test_a_planted_gust_besides_and_shows_its_strength(arpl_250g):
    gust = gust_beside(blown(arpl_250g, intensity=1.0, seed=0), [])
    assert gust.score > 40
    assert gust.intensity == pytest.approx(1.0, rel=0.2)
    assert gust.share == 1.0
    assert 0.02 < gust.std < 0.3
    assert gust.effect is CATALOGUE["gust"]
    assert gust_beside(blown(arpl_250g, intensity=2.0, seed=0), []).gain > gust.gain


@pytest.mark.parametrize("seed", range(3))
def test_white_noise_is_no_gust(arpl_250g, seed):
    assert gust_beside(blown(arpl_250g, intensity=0.0, seed=seed), []).score < 0


def test_without_wind_or_without_a_stochastic_effect_there_is_no_gust(arpl_250g):
    only_wind = blown(arpl_250g, intensity=1.0, seed=0, catalogue={"wind": CATALOGUE["wind"]})
    assert gust_beside(only_wind, []).effect is None
    random = np.random.default_rng(0)
    columns = [random.standard_normal((50, CHANNELS, 1))]
    other = regression(arpl_250g, [candidate(effect("a"), 0)], columns, [columns[0][:, :, 0]], catalogue=CATALOGUE)
    assert gust_beside(other, []).score == -np.inf


def air(of, *keys):
    """The air beside some of the candidates."""
    return air_beside(of, gust_beside(of, []), [c for c in of.candidates if c.key in keys])


def test_a_gust_beside_an_effect_and_the_effect_have_their_size(arpl_250g):
    both = blown(arpl_250g, intensity=1.0, seed=1, drag=0.5)
    motion = air(both, "drag")
    assert motion.detected
    assert motion.gust.intensity == pytest.approx(1.0, rel=0.2)
    drag = [c for c in both.candidates if c.key == "drag"]
    theta, _ = both.in_gust(gust_variance(both, drag)).solve(drag[0].columns)
    assert theta[0] == pytest.approx(0.5, abs=0.1)


def test_normal_equations_beside_a_gust_are_those_of_its_covariance(arpl_250g):
    calm = blown(arpl_250g, intensity=1.0, seed=2, count=60)
    gusty = calm.in_gust(0.7)
    basis = cosines(60, RATE, calm.thresholds.gust)
    weight = spectral_weights(60, RATE, calm.thresholds.gust.corners[0], calm.thresholds.gust)
    x = calm.columns[0].reshape(-1, 4)
    air = calm.columns[0][:, :, :3] * [1.0, 1.0, 0.5]
    waves = np.stack([air[:, :, i, None] * basis[:, None, :] for i in range(3)], axis=2)
    z = (waves * np.sqrt(weight)).reshape(len(x), -1)
    covariance = np.eye(len(x)) + 0.7 * z @ z.T
    np.testing.assert_allclose(gusty.gram[0], x.T @ np.linalg.solve(covariance, x), rtol=1e-6, atol=1e-6)


def test_a_gust_as_strong_as_the_strongest_that_was_tried_is_none(arpl_250g):
    assert not air(blown(arpl_250g, intensity=60.0, seed=0)).detected
    assert air(blown(arpl_250g, intensity=6.0, seed=0)).detected


def test_a_steady_wind_is_no_gust(arpl_250g):
    """Its first cosine makes a gust of it that gains nearly as much."""
    windy = blown(arpl_250g, intensity=0.0, seed=3)
    rows = [y + x[:, :, :2] @ np.array([8.0, -13.0]) for x, y in zip(windy.columns, windy.rows, strict=True)]
    steady = regression(arpl_250g, windy.candidates, windy.columns, rows, catalogue=windy.catalogue)
    assert not air(steady, "wind").detected


def test_air_motion_within_the_estimators_own_error_is_no_gust(arpl_250g):
    of_all = planted(arpl_250g, [0.0], seed=0)
    estimated = dataclasses.replace(of_all, pose=PoseErrors(np.ones(CHANNELS), 0.2))
    weak, strong = (Gust(100.0, 90.0, intensity, 0.02, 1.0) for intensity in (0.15, 0.8))
    assert _is_gust(weak, of_all, 40.0)
    assert not _is_gust(weak, estimated, 40.0)
    assert _is_gust(strong, estimated, 40.0)
    assert not _is_gust(strong, estimated, 95.0)
    fast = dataclasses.replace(strong, corner=0.3)  # spreads its strength over more frequencies than the error
    assert _is_gust(fast, of_all, 40.0)
    assert not _is_gust(fast, estimated, 40.0)


def test_a_gust_that_few_resamples_show_or_whose_interval_holds_nothing_is_none(arpl_250g):
    of_all = planted(arpl_250g, [0.0], seed=0)
    assert _is_gust(Gust(100.0, 90.0, 0.4, 0.1, 0.6), of_all, 40.0)
    assert not _is_gust(Gust(100.0, 90.0, 0.4, 0.25, 0.6), of_all, 40.0)
    assert not _is_gust(Gust(100.0, 90.0, 0.4, 0.1, 0.4), of_all, 40.0)
