"""Named places in a flat vector, for the inputs and outputs of the compiled step."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dynamics import symbolic as ca
from dynamics.effect import Expression


@dataclass(frozen=True)
class Layout:
    """The place of each named part in a vector.

    sizes: number of entries of each part, in order.
    """

    sizes: Mapping[str, int]

    @property
    def size(self) -> int:
        """Length of the whole vector."""
        return sum(self.sizes.values())

    @property
    def places(self) -> dict[str, slice]:
        """Slice of every part."""
        places, start = {}, 0
        for name, size in self.sizes.items():
            places[name] = slice(start, start + size)
            start += size
        return places

    def symbol(self, name: str) -> tuple[Expression, dict[str, Expression]]:
        """A CasADi symbol for the vector, and its parts by name."""
        vector = ca.SX.sym(name, self.size)
        return vector, {part: vector[place] for part, place in self.places.items()}

    def join(self, parts: Mapping[str, Expression]) -> Expression:
        """The vector of all its parts, as CasADi expressions."""
        return ca.vertcat(*[ca.densify(ca.SX(parts[name])) for name in self.sizes])

    def fill(self, values: Mapping[str, Any]) -> NDArray[np.float64]:
        """The vector of numbers; matrices are flattened by column, as CasADi does. Missing parts are zero."""
        vector = np.zeros(self.size)
        for name, value in values.items():
            vector[self.places[name]] = np.asarray(value, dtype=float).ravel(order="F")
        return vector

    def views(self, vector: NDArray[np.float64]) -> dict[str, NDArray[np.float64]]:
        """Parts of a vector, or of the rows of a matrix, that share its memory. vector: (..., size)."""
        return {name: vector[..., place] for name, place in self.places.items()}
