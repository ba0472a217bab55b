"""The rows at which a window of a table may end.

A window of T rows ends at the row that it predicts, and lies in one segment. Windows are index
arithmetic on one table; they are copied only batch by batch.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from dynamics.arrays import Floats
from dynamics.errors import RequestError


def window_ends(segments: Sequence[Floats], length: int) -> NDArray[np.intp]:
    """(m,) last rows of all windows of `length` rows without NaN, in the table of all segments after each other.

    segments: tables (n_i, k). Raises RequestError for a length below 1, or no segment at all.
    """
    if length < 1:
        raise RequestError(f"windows of {length} rows: required is at least 1.")
    if not segments:
        raise RequestError("no segment to take windows from: required is at least one.")
    table = np.concatenate(segments)
    bad = np.concatenate([[0], np.cumsum(~np.isfinite(table).all(axis=1))])
    ends, before = [], 0
    for segment in segments:
        last = np.arange(before + length - 1, before + len(segment), dtype=np.intp)
        ends.append(last[bad[last + 1] == bad[last - length + 1]])
        before += len(segment)
    return np.concatenate(ends)
