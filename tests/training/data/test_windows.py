"""Windows lie within one segment and hold finite rows only."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dynamics.errors import RequestError
from training.data.windows import window_ends


@given(lengths=st.lists(st.integers(1, 30), min_size=1, max_size=5), length=st.integers(1, 8))
def test_every_window_lies_in_one_segment(lengths: list[int], length: int) -> None:
    segments = [np.stack([np.full(n, k), np.arange(n)], axis=1).astype(float) for k, n in enumerate(lengths)]
    ends = window_ends(segments, length)
    assert len(ends) == sum(max(0, n - length + 1) for n in lengths)
    windows = np.concatenate(segments)[ends[:, None] + np.arange(1 - length, 1)]
    assert (np.ptp(windows[:, :, 0], axis=1) == 0).all()
    assert (np.diff(windows[:, :, 1], axis=1) == 1).all()


def test_rows_that_are_not_finite_are_in_no_window() -> None:
    segment = np.arange(20.0)[:, None]
    segment[7] = np.nan
    assert set(window_ends([segment], 3).tolist()) == {2, 3, 4, 5, 6, *range(10, 20)}


def test_windows_without_rows_are_refused() -> None:
    with pytest.raises(RequestError, match="required is at least 1"):
        window_ends([np.zeros((3, 1))], 0)


def test_no_segments_at_all_are_refused() -> None:
    with pytest.raises(RequestError, match="no segment"):
        window_ends([], 3)
