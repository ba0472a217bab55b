"""Operations common to NumPy arrays, CasADi columns and torch tensors, so that one formula serves all three.

Components lie on the last axis of arrays and tensors, and along the column of CasADi matrices. torch and CasADi
are never imported here: their values can only come from a process that has imported them.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from typing import Any

import numpy as np

from dynamics import symbolic as ca

Expression = Any  # a NumPy array, casadi.SX or casadi.MX column, or torch.Tensor; CasADi carries no types of its own


def is_symbolic(value: Expression) -> bool:
    """Whether a value is a CasADi matrix."""
    casadi = sys.modules.get("casadi")
    return casadi is not None and isinstance(value, (casadi.SX, casadi.MX, casadi.DM))


def is_tensor(value: Expression) -> bool:
    """Whether a value is a torch tensor."""
    torch = sys.modules.get("torch")
    return torch is not None and isinstance(value, torch.Tensor)


def library_of(*values: Expression) -> Any:
    """The module whose functions (sin, cos, ...) take these values: casadi, torch or numpy."""
    if any(is_symbolic(value) for value in values):
        return ca
    return sys.modules["torch"] if any(is_tensor(value) for value in values) else np


def split(value: Expression) -> list[Expression]:
    """The components of vectors; those of a single array (n,) are Python's numbers, five times as fast in formulas."""
    if isinstance(value, np.ndarray):
        numbers = value.astype(float, copy=False)
        return numbers.tolist() if numbers.ndim == 1 else list(np.moveaxis(numbers, -1, 0))
    library = library_of(value)
    if library is ca:
        return list(ca.vertsplit(value))
    if library is np:
        return list(np.moveaxis(np.asarray(value, dtype=float), -1, 0))
    return list(value.unbind(-1))


def join(components: Sequence[Expression]) -> Expression:
    """Vectors of components, the inverse of `split`; components of arrays and tensors are broadcast."""
    if all(isinstance(component, float) for component in components):
        return np.array(components)
    library = library_of(*components)
    if library is ca:
        return ca.vertcat(*components)
    if library is np:
        return np.stack(np.broadcast_arrays(*components), axis=-1)
    return library.stack(library.broadcast_tensors(*components), dim=-1)


def entries(vector: Expression, place: slice) -> Expression:
    """Some components of vectors, as vectors."""
    return vector[place] if is_symbolic(vector) else vector[..., place]


def concatenate(vectors: Sequence[Expression]) -> Expression:
    """Vectors one behind the other as longer ones."""
    library = library_of(*vectors)
    if library is ca:
        return ca.vertcat(*vectors)
    return np.concatenate(vectors, axis=-1) if library is np else library.cat(list(vectors), dim=-1)
