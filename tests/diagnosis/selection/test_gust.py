"""Random slow air is distinguished from white noise, with about its strength."""

import numpy as np
import pytest

from diagnosis.selection.gust import gust_beside
from dynamics.effects import CATALOGUE
from tests.diagnosis.synthetic import CHANNELS, candidate, effect, regression

ROWS, RATE, FLIGHTS = 250, 25.0, 3


def blown(vehicle, *, intensity: float, seed: int, catalogue=CATALOGUE):
    """Flights whose x and y forces are those of air with a corner at 0.15 Hz; 1 m/s gives 1 unit of force."""
    random = np.random.default_rng(seed)
    column = np.zeros((ROWS, CHANNELS, 3))
    for axis in range(3):
        column[:, axis, axis] = column[:, 3 + axis, axis] = 1.0
    rows = []
    for _ in range(FLIGHTS):
        spectrum = np.fft.rfft(random.standard_normal((ROWS, 2)), axis=0)
        frequency = np.fft.rfftfreq(ROWS, 1 / RATE)
        air = np.fft.irfft(spectrum / np.sqrt(1 + (frequency / 0.15) ** 2)[:, None], ROWS, axis=0)
        y = random.standard_normal((ROWS, CHANNELS))
        y[:, 0:2] += intensity * air / air.std()
        y[:, 3:5] += intensity * air / air.std()
        rows.append(y)
    wind = candidate(CATALOGUE["wind"], 0, 1, 2)
    return regression(vehicle, [wind], [column] * FLIGHTS, rows, catalogue=catalogue)


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
