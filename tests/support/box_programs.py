"""Quadratic programs in a box, solved by box_qp.h and by HPIPM."""

from __future__ import annotations

import ctypes
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from dynamics.codegen import build_library
from runtime.rti.hpipm import find_hpipm
from runtime.rti.processor import Processor

Array = NDArray[np.float64]
ENTRY = "box_programs.c"


@dataclass(frozen=True)
class BoxProgram:
    """hessian: (n, n). gradient, lower, upper: (n,)."""

    hessian: Array
    gradient: Array
    lower: Array
    upper: Array

    def optimality(self, v: Array) -> float:
        """Largest component of the gradient that could still be followed, over the largest of all at zero."""
        slope = self.hessian @ v + self.gradient
        slope = np.where(v <= self.lower, np.minimum(slope, 0), np.where(v >= self.upper, np.maximum(slope, 0), slope))
        return float(np.abs(slope).max() / np.abs(self.gradient).max())

    def cost(self, v: Array) -> float:
        return float(v @ self.hessian @ v / 2 + self.gradient @ v)


@dataclass(frozen=True)
class Solution:
    """status: 0 when solved. v: (n,). seconds: of the solve, preparations left out."""

    status: int
    v: Array
    iterations: int
    seconds: float


class BoxSolvers:
    """Both solvers, compiled for programs of one size."""

    def __init__(self, size: int, processor: Processor) -> None:
        folder, hpipm = resources.files("runtime.rti"), find_hpipm()
        sources = {name: folder.joinpath(name).read_text() for name in ("box_qp.h", "dense_qp.h")}
        sources[ENTRY] = (Path(__file__).parent / ENTRY).read_text()
        flags = (*processor.compiler_flags, *hpipm.compiler_flags, f"-DV={size}", f"-DVECTOR_BYTES={processor.vector}")
        self._code = ctypes.CDLL(str(build_library(sources, flags=flags, libraries=hpipm.linker_flags, entry=ENTRY)))

    def solve(
        self, program: BoxProgram, *, tolerance: float, most: int = 50, by: Literal["box_qp", "hpipm"] = "box_qp"
    ) -> Solution:
        """The optimum to a tolerance in at most so many iterations."""
        v, iterations, seconds = np.zeros(len(program.gradient)), ctypes.c_int(), ctypes.c_double()
        status = getattr(self._code, f"by_{by}")(
            *_pointers(program), ctypes.c_double(tolerance), most, v.ctypes.data_as(ctypes.c_void_p),
            ctypes.byref(iterations), ctypes.byref(seconds),
        )  # fmt: skip
        return Solution(status, v, iterations.value, seconds.value)

    def free_optimum(self, program: BoxProgram) -> tuple[Array, bool]:
        """The optimum without bounds (n,), and whether it lies inside of them."""
        v = np.zeros(len(program.gradient))
        inside = self._code.free_optimum(*_pointers(program), v.ctypes.data_as(ctypes.c_void_p))
        return v, bool(inside)


def _pointers(program: BoxProgram) -> list[ctypes.c_void_p]:
    parts = (program.hessian, program.gradient, program.lower, program.upper)
    assert all(part.flags.c_contiguous and part.dtype == np.float64 for part in parts)
    return [part.ctypes.data_as(ctypes.c_void_p) for part in parts]
