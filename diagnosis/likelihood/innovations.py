"""Innovations of a filter and what every input changes in them, in one pass (innovations.c)."""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from diagnosis.likelihood.gain import Gain
from dynamics.arrays import Floats
from dynamics.codegen import build_library
from dynamics.trust import load_own_library

LANES = 32  # columns that go through the rows together
SOURCE = Path(__file__).with_name("innovations.c")


@dataclass(frozen=True, eq=False)
class Linearised:
    """A flight's model about a reference, N rows.

    A: (N, 9, 9) transition of the rigid body's error state. C: (N, m, 9) readings of it.
    conditions: (N, 6) specific force and body rate in which other entries of the transition are linear.
    """

    A: Floats
    C: Floats
    conditions: Floats


@dataclass(eq=False)
class Pass:
    """A pass over a flight that goes on where it stopped.

    state: (n, k) of each column.
    """

    gain: Gain
    state: Floats

    def advance(self, model: Linearised, B: Floats, D: Floats, *, path: bool = False) -> tuple[Floats, Floats]:
        """(N, m, k) whitened innovations of inputs B (N, i, k) and D (N, m, k), and (N, n) the first column's states.

        x(t+1) = A x + B + K nu, nu = D - C x; the states are empty unless `path` is set.
        """
        rows, readings, columns = D.shape
        n, gain = len(self.state), self.gain
        out, states = np.empty_like(D), np.empty((rows, n) if path else (0, n))
        space = np.empty((2 * n + readings) * (columns + LANES) + LANES)
        arrays = [
            *(model.A, model.C),
            *(*gain.transition_entries, *gain.reading_entries, *gain.turning),
            *(model.conditions, gain.K, gain.whitening, B, D, self.state, space, out, states if path else None),
        ]
        _library()(rows, n, readings, columns, B.shape[1], *[_argument(value) for value in arrays])
        return out, states


def start(gain: Gain, columns: int) -> Pass:
    """A pass that begins with states of zero."""
    return Pass(gain, np.zeros((len(gain.transition), columns)))


def _argument(value: object) -> Any:
    if not isinstance(value, np.ndarray):
        return value
    if not value.flags.c_contiguous:
        raise ValueError(f"an array of shape {value.shape} is not contiguous")
    return value.ctypes.data_as(ctypes.c_void_p)


@cache
def _library() -> Callable[..., None]:
    path = build_library({SOURCE.name: SOURCE.read_text()}, entry=SOURCE.name)
    function: Callable[..., None] = load_own_library(path).innovations
    return function
