"""Filters: what passes, what is delayed, what gaps do; nothing of the future reaches a causal one."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dynamics.errors import RequestError
from flights import filters

RATE = 100.0
TIME = np.arange(1000) / RATE


def tone(frequency: float) -> np.ndarray:
    return np.sin(2 * np.pi * frequency * TIME)[:, None]


def gain(signal: np.ndarray, filtered: np.ndarray) -> float:
    middle = slice(300, 700)
    return float(np.sqrt(np.mean(filtered[middle] ** 2) / np.mean(signal[middle] ** 2)))


def test_the_papers_low_pass_keeps_1_hz_halves_5_hz_and_stops_20_hz() -> None:
    passed, cut, stopped = (gain(tone(f), filters.lowpass(tone(f), RATE, 5.0)) for f in (1.0, 5.0, 20.0))
    assert passed == pytest.approx(1.0, abs=0.01)
    assert cut == pytest.approx(0.5, abs=0.01)  # 3 dB, forward and backward
    assert stopped < 1e-3


def test_zero_phase_delays_nothing_and_the_causal_filter_does() -> None:
    signal = tone(1.0)
    middle = slice(200, 800)
    assert np.abs(filters.lowpass(signal, RATE, 10.0) - signal)[middle].max() < 0.01
    assert np.abs(filters.causal_lowpass(signal, RATE, 10.0) - signal)[middle].max() > 0.1


@given(row=st.integers(1, 999), size=st.floats(-1e3, 1e3))
@settings(max_examples=30, deadline=None)
def test_nothing_of_the_future_reaches_a_causal_filter(row: int, size: float) -> None:
    signal = tone(1.0)
    later = signal.copy()
    later[row:] += size
    before, after = (filters.causal_lowpass(values, RATE, 10.0) for values in (signal, later))
    assert np.array_equal(before[:row], after[:row])


@given(start=st.integers(0, 960), length=st.integers(1, 40))
@settings(max_examples=30, deadline=None)
def test_a_gap_stays_a_gap_and_both_sides_are_filtered_by_themselves(start: int, length: int) -> None:
    signal = np.hstack([tone(1.0), tone(2.0)])
    signal[start : start + length, 1] = np.nan
    filtered = filters.lowpass(signal, RATE, 5.0)
    assert np.isnan(filtered[start : start + length]).all()
    if start > 60:
        assert np.array_equal(filtered[:start], filters.lowpass(signal[:start], RATE, 5.0))


def test_thinning_folds_nothing_back_and_leaves_slow_motion_alone() -> None:
    fast, slow = tone(45.0), tone(1.0)
    assert gain(fast, filters.anti_aliased(fast, RATE, 20.0)) < 1e-3
    assert gain(slow, filters.anti_aliased(slow, RATE, 20.0)) == pytest.approx(1.0, abs=0.01)
    assert filters.anti_aliased(fast, RATE, 100.0) is fast


def test_the_derivative_of_a_line_is_its_slope_on_each_side_of_a_gap() -> None:
    line = 3.0 * TIME[:, None] + 1.0
    line[500] = np.nan
    slope = filters.derivative(line, 1 / RATE)
    assert np.isnan(slope[500]).all()
    assert np.allclose(np.delete(slope, 500), 3.0)


@pytest.mark.parametrize("cutoff", [0.0, -1.0, 50.0, 80.0])
def test_a_cutoff_beyond_the_rate_is_refused(cutoff: float) -> None:
    with pytest.raises(RequestError, match="wanted more than 0 and less than 50 Hz"):
        filters.lowpass(tone(1.0), RATE, cutoff)


@given(st.lists(st.booleans(), max_size=40))
def test_runs_are_where_flags_are_true(flags: list[bool]) -> None:
    rows = [row for start, stop in filters.runs(np.array(flags, dtype=bool)) for row in range(start, stop)]
    assert rows == [row for row, flag in enumerate(flags) if flag]
