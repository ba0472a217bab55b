"""Noise: whitening gives unit white noise, and slow missing effects are not taken for it."""

import numpy as np
import pytest
from scipy.signal import lfilter

from diagnosis.data.filters import difference, simpson
from diagnosis.selection.noise import estimate_noise, noise_floor, sensor_floor
from diagnosis.thresholds import DEFAULT, NoiseThresholds
from flights.filters import zero_phase

RATE = 25.0
FULL_RATE = 100.0  # of the log


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


def test_a_slow_swing_is_not_whitened_away():
    rows = coloured()
    quiet = estimate_noise(rows, RATE, range(12))
    swung = estimate_noise([swinging(r) for r in rows], RATE, range(12))
    np.testing.assert_allclose(swung.floor, quiet.floor, rtol=0.1)
    assert np.std(swung.whiten(swinging(rows[0]))) > 1.5


def test_of_a_torque_the_larger_of_both_spectra_is_noise_and_a_force_has_its_own():
    random = np.random.default_rng(2)
    noise = [random.standard_normal((4000, 12)) for _ in range(3)]
    explained = [n - zero_phase(n, RATE, 3.0) for n in noise]  # as by a controller's answer
    forces, torques = range(6), range(6, 9)
    alone = estimate_noise(explained, RATE, range(12)).whiten(noise[0]).std(axis=0)
    both = estimate_noise(explained, RATE, range(12), beyond_feedback=noise).whiten(noise[0]).std(axis=0)
    assert (alone > 1.5).all()
    np.testing.assert_allclose(both[torques], 1.0, rtol=0.15)
    assert (both[forces] > 1.5).all()
    louder = estimate_noise(noise, RATE, range(12), beyond_feedback=explained).whiten(noise[0]).std(axis=0)
    np.testing.assert_allclose(louder, 1.0, rtol=0.05)


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


def turbulence(random: np.random.Generator, rows: int) -> np.ndarray:
    """A force with a correlation time of 50 ms and unit size, as rotors make it."""
    share = np.exp(-1 / (FULL_RATE * 0.05))
    return lfilter([np.sqrt(1 - share**2)], [1.0, -share], random.standard_normal((rows, 12)), axis=0)


def test_the_sensors_noise_is_heard_beyond_what_the_rotors_turbulence_reaches():
    random = np.random.default_rng(3)
    noise = [simpson(0.2 * random.standard_normal((4000, 12))) for _ in range(3)]
    turbulent = [n + turbulence(random, len(n)) for n in noise]
    below = np.std(np.vstack([zero_phase(n, FULL_RATE, DEFAULT.filters.cutoff) for n in noise]), axis=0)
    for rows, tolerance in ((noise, 0.15), (turbulent, 0.5)):
        heard = sensor_floor(rows, FULL_RATE, DEFAULT.filters)
        assert np.median(heard / below) == pytest.approx(1.0, abs=tolerance)
    assert np.std(zero_phase(turbulent[0], FULL_RATE, DEFAULT.filters.cutoff)) > 3 * below.mean()


def test_the_derivative_of_a_gyros_noise_is_heard_as_that_gyros():
    random = np.random.default_rng(4)
    rows = [difference(0.01 * random.standard_normal((4000, 12)), FULL_RATE) for _ in range(3)]
    below = np.std(np.vstack([zero_phase(r, FULL_RATE, DEFAULT.filters.cutoff) for r in rows]), axis=0)
    assert np.median(sensor_floor(rows, FULL_RATE, DEFAULT.filters) / below) == pytest.approx(1.0, abs=0.15)


def test_a_channel_that_is_absent_has_no_noise():
    rows = [np.zeros((1000, 12))]
    assert sensor_floor(rows, FULL_RATE, DEFAULT.filters).max() == 0.0
    assert sensor_floor([rows[0][:100]], FULL_RATE, DEFAULT.filters).max() == 0.0
