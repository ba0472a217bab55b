"""Noise: whitening gives unit white noise, and slow missing effects are not taken for it."""

import numpy as np
import pytest
from scipy.signal import lfilter

from diagnosis.selection.noise import estimate_noise, noise_floor
from diagnosis.thresholds import NoiseThresholds

RATE = 25.0


def coloured(seed: int = 0, count: int = 2) -> list[np.ndarray]:
    random = np.random.default_rng(seed)
    return [lfilter([1.0], [1.0, -0.7, 0.2], random.standard_normal((4000, 12)), axis=0) for _ in range(count)]


def swinging(rows: np.ndarray) -> np.ndarray:
    time = np.arange(len(rows)) / RATE
    return rows + 3 * np.sin(2 * np.pi * 0.3 * time)[:, None]


def test_whitening_makes_coloured_noise_white_and_of_unit_size():
    rows = coloured()
    noise = estimate_noise(rows, RATE, range(12))
    white = noise.whiten(rows[0])
    assert white.shape == (4000 - noise.order, 12)
    assert np.std(white) == pytest.approx(1.0, rel=0.05)
    assert abs(np.mean(white[1:] * white[:-1])) < 0.1
    np.testing.assert_allclose(noise.floor, [r.std() for r in rows[0].T], rtol=0.15)


def test_noise_that_channels_share_is_decorrelated():
    random = np.random.default_rng(1)
    common = random.standard_normal((4000, 1))
    rows = [common + random.standard_normal((4000, 12))]
    white = estimate_noise(rows, RATE, range(12)).whiten(rows[0])
    np.testing.assert_allclose(np.cov(white.T), np.eye(12), atol=0.15)
    unmixed = estimate_noise(rows, RATE, range(12), mixed=False).whiten(rows[0])
    assert np.cov(unmixed.T)[0, 1] > 0.3


def test_columns_are_whitened_as_rows_are():
    rows = coloured()
    noise = estimate_noise(rows, RATE, [0, 1, 7])
    both = noise.whiten(np.stack([rows[0], 2 * rows[0]], axis=2))
    np.testing.assert_allclose(both[:, :, 0], noise.whiten(rows[0]), atol=1e-12)
    np.testing.assert_allclose(both[:, :, 1], 2 * both[:, :, 0], atol=1e-12)
    gram, product = noise.normal_equations(rows[0][:, :, None], rows[0])
    assert gram[0, 0] == pytest.approx(product[0])
    assert gram[0, 0] == pytest.approx(np.sum(noise.whiten(rows[0]) ** 2))


def test_a_slow_swing_is_not_whitened_away():
    rows = coloured()
    quiet = estimate_noise(rows, RATE, range(12))
    swung = estimate_noise([swinging(r) for r in rows], RATE, range(12))
    np.testing.assert_allclose(swung.floor, quiet.floor, rtol=0.1)
    assert np.std(swung.whiten(swinging(rows[0]))) > 1.5


def test_the_floor_counts_noise_and_not_slow_missing_effects():
    random = np.random.default_rng(0)
    noise = [random.standard_normal((600, 12)) for _ in range(3)]
    plain, hidden = (noise_floor(rows, RATE, range(12)) for rows in (noise, [swinging(n) for n in noise]))
    np.testing.assert_allclose(plain, 1.0, rtol=0.05)
    np.testing.assert_allclose(hidden, 1.0, rtol=0.12)
    assert noise_floor(noise, RATE, range(6))[6:].max() == 0.0


def test_torques_may_be_redder_than_forces():
    rows = [swinging(r) for r in coloured()]
    stricter = noise_floor(rows, RATE, range(12), NoiseThresholds(torque_redness=1.0))
    floor = noise_floor(rows, RATE, range(12))
    assert np.all(floor[6:9] > stricter[6:9])
    np.testing.assert_array_equal(floor[:6], stricter[:6])
