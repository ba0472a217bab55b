"""Windows are indices into one table: equally spaced, within one segment, and never a copy of the whole."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dynamics.errors import RequestError
from training.data.windows import windows


@given(
    lengths=st.lists(st.integers(1, 30), min_size=1, max_size=5), length=st.integers(1, 8), spacing=st.integers(1, 4)
)
def test_every_window_lies_in_one_segment_with_equal_spacing(lengths: list[int], length: int, spacing: int) -> None:
    segments = [np.stack([np.full(n, k), np.arange(n)], axis=1).astype(float) for k, n in enumerate(lengths)]
    found = windows(segments, length, spacing=spacing)
    assert len(found) == sum(max(0, n - (length - 1) * spacing) for n in lengths)
    batch = found.gather(np.arange(len(found)))
    assert batch.shape == (len(found), length, 2)
    assert (np.ptp(batch[:, :, 0], axis=1) == 0).all()
    assert (np.diff(batch[:, :, 1], axis=1) == spacing).all()
    assert np.array_equal(batch[:, -1], found.table[found.ends])


def test_rows_that_are_not_known_are_in_no_window() -> None:
    segment = np.arange(20.0)[:, None]
    segment[7] = np.nan
    found = windows([segment], 3)
    assert set(found.ends.tolist()) == {2, 3, 4, 5, 6, *range(10, 20)}


def test_the_table_is_stored_once() -> None:
    segment = np.zeros((1000, 4))
    found = windows([segment], 20)
    assert found.table.nbytes == segment.nbytes
    assert found.ends.nbytes < segment.nbytes


@pytest.mark.parametrize(("length", "spacing"), [(0, 1), (1, 0)])
def test_windows_of_nothing_are_refused(length: int, spacing: int) -> None:
    with pytest.raises(RequestError, match="wanted both to be at least 1"):
        windows([np.zeros((3, 1))], length, spacing=spacing)


def test_no_segments_at_all_are_refused() -> None:
    with pytest.raises(RequestError, match="no segment"):
        windows([], 3)
