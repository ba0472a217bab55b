"""The plant's step as machine code, run many steps at a time."""

from __future__ import annotations

import ctypes
from pathlib import Path

import numpy as np

from dynamics.arrays import Floats
from dynamics.codegen import build_library, generate_c
from dynamics.trust import load_own_library
from sitl_mock.vehicle.plant import Plant


class StepLoop:
    """State, inputs and a ring of the last records of one plant, advanced by compiled code.

    state, command, constants: vectors in the plant's layouts, which may be written between calls.
    records: (rows, record size); the record of step k is in row k % rows.
    """

    def __init__(self, plant: Plant, *, rows: int = 1024) -> None:
        source = (Path(__file__).parent / "step_loop.c").read_text(encoding="utf-8")
        library = build_library({"functions.c": generate_c([plant.step]), "step_loop.c": source}, entry="step_loop.c")
        self._advance = load_own_library(library).advance
        self.state = np.zeros(plant.state.size)
        self.command = np.zeros(plant.command.size)
        self.constants = np.zeros(plant.constants.size)
        self.records = np.zeros((rows, plant.record.size))
        self._next = np.zeros(plant.state.size)
        self._noise_row = plant.noise.size * 8  # bytes
        work, integers = np.zeros(max(1, plant.step.sz_w())), np.zeros(max(1, plant.step.sz_iw()), dtype=np.int64)
        arguments = np.zeros(max(4, plant.step.sz_arg()), dtype=np.int64)
        results = np.zeros(max(2, plant.step.sz_res()), dtype=np.int64)
        scratch = (self._next, arguments, results, integers, work)
        self._scratch = scratch  # keeps the memory alive that the addresses below point to
        wide, pointer = ctypes.c_longlong, ctypes.c_void_p
        self._advance.argtypes = [wide, pointer, wide, *[pointer] * 3, wide, pointer, *[wide] * 3, *[pointer] * 5]
        self._inputs = (self.state.ctypes.data, self.state.size, self.command.ctypes.data, self.constants.ctypes.data)
        self._scratch_addresses = tuple(array.ctypes.data for array in scratch)
        self._records_address = self.records.ctypes.data

    def run(self, steps: int, first: int, noise: Floats, noise_row: int) -> None:
        """Advance by a number of steps.

        first: number of the first step.
        noise: (rows, noise size) unit normal numbers, C-contiguous.
        noise_row: row of the first step.
        """
        rows, width = self.records.shape
        address = noise.ctypes.data + noise_row * self._noise_row
        ring = (self._records_address, width, first, rows)
        self._advance(steps, *self._inputs, address, noise.shape[1], *ring, *self._scratch_addresses)
