"""The two sides of the regression see the same filter."""

import numpy as np
import pytest

from diagnosis.data.decimating_filter import filtered_rows
from diagnosis.data.filters import advanced, decimated_rows, delayed, difference, rate_of_change, simpson
from diagnosis.thresholds import DEFAULT, FilterThresholds
from flights.filters import zero_phase

RATE = 100.0
TIME = np.arange(600) / RATE


@pytest.mark.parametrize("frequency", [0.5, 2.0, 5.0])
def test_simpsons_weights_match_the_central_difference(frequency):
    w = 2 * np.pi * frequency
    position, velocity = np.sin(w * TIME)[:, None], w * np.cos(w * TIME)[:, None]
    inner = slice(2, -2)
    wrong = np.abs(difference(position, RATE)[inner] - simpson(velocity)[inner]).max() / w
    without = np.abs(difference(position, RATE)[inner] - velocity[inner]).max() / w
    assert wrong < 0.001
    assert frequency < 5.0 or without > 10 * wrong


def test_a_derivative_that_enters_products_is_not_averaged_twice():
    w = 2 * np.pi * 5.0
    position, velocity = np.sin(w * TIME)[:, None], w * np.cos(w * TIME)[:, None]
    inner = slice(20, -20)
    np.testing.assert_allclose(rate_of_change(position, RATE)[inner], velocity[inner], atol=2e-4 * w)
    noise = np.random.default_rng(0).standard_normal((600, 3))
    assert simpson(rate_of_change(noise, RATE))[1:-1] == pytest.approx(difference(noise, RATE)[1:-1])


def test_the_filter_keeps_motion_where_it_is_and_takes_vibration_out():
    motion, vibration = np.sin(2 * np.pi * 2 * TIME), np.sin(2 * np.pi * 30 * TIME)
    filtered = zero_phase((motion + vibration)[:, None], RATE, DEFAULT.filters.cutoff)[:, 0]
    np.testing.assert_allclose(filtered[30:-30], motion[30:-30], atol=0.01)


def test_a_delay_shows_what_was_then():
    values = np.column_stack([TIME, TIME**2])
    late = delayed(values, RATE, 0.05)
    np.testing.assert_allclose(late[10:], values[5:-5], atol=1e-9)
    np.testing.assert_allclose(late[:5], np.tile(values[0], (5, 1)), atol=1e-9)


def test_decimation_leaves_about_25_rows_a_second():
    rows = np.arange(1000)[decimated_rows(1000, 100.0, DEFAULT.filters)]
    assert rows[0] == 30
    assert np.all(np.diff(rows) == 4)
    assert rows[-1] < 970


@pytest.mark.parametrize(("rate", "count"), [(20.0, 700), (100.0, 130), (100.0, 1150), (250.0, 1800)])
@pytest.mark.parametrize("products", [False, True])
def test_the_rows_of_the_regression_are_those_of_the_filter_over_all_rows(rate, count, products):
    values = np.cumsum(np.random.default_rng(3).standard_normal((count, 2, 3)), axis=0)
    filters = FilterThresholds(cutoff=4.0, rate=10.0) if rate < 30 else FilterThresholds()
    everywhere = zero_phase(simpson(values) if products else values, rate, filters.cutoff)
    expected = everywhere[decimated_rows(count, rate, filters)]
    filtered = filtered_rows(values, rate, filters, products=products)
    np.testing.assert_allclose(filtered, expected, atol=1e-10 * np.abs(values).max())


@pytest.mark.parametrize("by", [0.0, 0.005, 0.012, -0.005, -0.04])
def test_what_is_advanced_is_what_comes_later(by):
    w = 2 * np.pi * 5.0
    later = advanced(np.sin(w * TIME)[:, None], RATE, by)
    np.testing.assert_allclose(later[8:-8, 0], np.sin(w * (TIME + by))[8:-8], atol=3e-3)
    assert later.shape == (len(TIME), 1)
