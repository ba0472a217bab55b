"""A CasADi function over the rows of arrays, without copies: 10 times as fast as a call with matrices."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np

from dynamics.arrays import Floats

BLOCK = 256  # rows that are evaluated at once, whatever the segment's length: one compiled function is enough


class RowFunction:
    """One function evaluated at every row.

    shared: places of the arguments that are the same for all rows.
    chained: whether the first output is the next row's first argument, a state.
    """

    def __init__(self, function: ca.Function, *, shared: tuple[int, ...] = (), chained: bool = False) -> None:
        self._function = function
        self._shared = shared
        self._chained = chained
        self._by_count: dict[int, Any] = {}

    def __call__(self, *arguments: Floats) -> Floats:
        """(n, k) of the first output. arguments: (n, width) each, (width,) for shared ones and a chained state."""
        count = next(len(a) for i, a in enumerate(arguments) if not self._single(i))
        ready = [np.ascontiguousarray(a, dtype=float) for a in arguments]
        result = np.empty((count, self._function.size1_out(0)))
        for start in range(0, count, BLOCK):
            part = [a if self._single(i) else a[start : start + BLOCK] for i, a in enumerate(ready)]
            rows = min(BLOCK, count - start)
            if rows == BLOCK:
                self._run(BLOCK, part, result[start : start + BLOCK])
            else:  # the last block is filled up with copies of its last row
                spare = np.empty((BLOCK, result.shape[1]))
                filled = [a if self._single(i) else _filled_up(a, BLOCK) for i, a in enumerate(part)]
                self._run(BLOCK, filled, spare)
                result[start:] = spare[:rows]
            if self._chained:
                ready[0] = result[min(start + BLOCK, count) - 1].copy()
        return result

    def _run(self, count: int, arguments: list[Floats], result: Floats) -> None:
        """Evaluate `count` rows; all arrays are contiguous, and result is written in place."""
        if count not in self._by_count:
            self._by_count[count] = self._over_rows(count).buffer()
        buffer, evaluate = self._by_count[count]
        for place, values in enumerate(arguments):
            buffer.set_arg(place, values.reshape(-1).data)
        buffer.set_res(0, result.reshape(-1).data)
        evaluate()

    def _single(self, place: int) -> bool:
        return place in self._shared or (self._chained and place == 0)

    def _over_rows(self, count: int) -> ca.Function:
        if self._chained:
            return self._function.mapaccum("rows", count)
        return self._function.map("rows", "serial", count, list(self._shared), [])


def _filled_up(values: Floats, count: int) -> Floats:
    return np.concatenate([values, np.repeat(values[-1:], count - len(values), axis=0)])
