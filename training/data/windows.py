"""Sequence windows as indices into one table: a data set of histories that is stored once.

A window of T rows ends at the row it is meant for. Windows never cross from one segment into the next.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dynamics.arrays import Floats
from dynamics.errors import RequestError


@dataclass(frozen=True, eq=False)
class Windows:
    """Windows over a table (n, k) of all segments after each other.

    ends: (m,) row at which each window ends. length: T rows. spacing: rows between two of a window.
    """

    table: Floats
    ends: NDArray[np.intp]
    length: int
    spacing: int = 1

    def __len__(self) -> int:
        return len(self.ends)

    @property
    def offsets(self) -> NDArray[np.intp]:
        """(T,) rows of a window relative to its end, oldest first: index a tensor by ends[:, None] + offsets."""
        return np.arange(-(self.length - 1) * self.spacing, 1, self.spacing, dtype=np.intp)

    def index(self, chosen: ArrayLike | None = None) -> NDArray[np.intp]:
        """(m, T) rows of the table that make up windows. chosen: which of them, all by default."""
        ends = self.ends if chosen is None else self.ends[np.asarray(chosen)]
        return ends[:, None] + self.offsets

    def gather(self, chosen: ArrayLike) -> Floats:
        """The chosen windows themselves, (m, T, k): the only copy there is, one batch."""
        return self.table[self.index(chosen)]


def windows(segments: Sequence[Floats], length: int, *, spacing: int = 1) -> Windows:
    """Every window of `length` rows, `spacing` rows apart, that lies within one segment and has no NaN.

    segments: tables (n_i, k). Raises RequestError for a length or spacing below 1, or no segment at all.
    """
    if length < 1 or spacing < 1:
        raise RequestError(f"windows of {length} rows, {spacing} apart: wanted both to be at least 1.")
    if not segments:
        raise RequestError("no segment to take windows from: wanted at least one.")
    table = np.concatenate(segments)
    bad = np.concatenate([[0], np.cumsum(~np.isfinite(table).all(axis=1))])
    reach = (length - 1) * spacing
    ends, before = [], 0
    for segment in segments:
        last = np.arange(before + reach, before + len(segment), dtype=np.intp)
        ends.append(last[bad[last + 1] == bad[last - reach]])
        before += len(segment)
    return Windows(table, np.concatenate(ends), length, spacing)
