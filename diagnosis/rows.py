"""A CasADi function over the rows of arrays, without copies: 10 times as fast as a call with matrices."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np

from diagnosis.filters import Floats


class RowFunction:
    """One function evaluated at every row. shared: places of the arguments that are the same for all rows.

    chained: the first argument is the state that the first output makes for the next row.
    """

    def __init__(self, function: ca.Function, *, shared: tuple[int, ...] = (), chained: bool = False) -> None:
        self._function = function
        self._shared = shared
        self._chained = chained
        self._by_count: dict[int, ca.Function] = {}

    def __call__(self, *arguments: Floats) -> Floats:
        """(n, k) of the first output. arguments: (n, width) each, (width,) for shared ones and a chained state."""
        count = next(len(a) for i, a in enumerate(arguments) if not self._single(i))
        if count not in self._by_count:
            self._by_count[count] = self._over_rows(count)
        function = self._by_count[count]
        buffer: Any
        buffer, evaluate = function.buffer()
        flat = [np.ascontiguousarray(a, dtype=float).reshape(-1) for a in arguments]
        for place, values in enumerate(flat):
            buffer.set_arg(place, values.data)
        result = np.empty((count, self._function.size1_out(0)))
        buffer.set_res(0, result.reshape(-1).data)
        evaluate()
        return result

    def _single(self, place: int) -> bool:
        return place in self._shared or (self._chained and place == 0)

    def _over_rows(self, count: int) -> ca.Function:
        if self._chained:
            return self._function.mapaccum("rows", count)
        return self._function.map("rows", "serial", count, list(self._shared), [])
