"""The RTI solver's Python interface: arrays that the C code reads and writes, and one call a phase."""

from __future__ import annotations

import ctypes
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from dynamics.errors import RequestError
from dynamics.model import ENVIRONMENT_DEFAULT
from dynamics.state import RIGID_BODY_STATES
from runtime.control.kernel_model import FlownModel, trim_of
from runtime.control.rti.hpipm import load_kernel
from runtime.control.rti.prebuilt import solver_library
from runtime.control.rti.problem import Problem, fill_options

KERNEL_DIMENSIONS = (
    "states",
    "inputs",
    "nodes",
    "parameters",
    "environment",
    "history",
    "substeps",
    "vector_bytes",
    "options_bytes",
)


class RtiReport(ctypes.Structure):
    """Times in seconds and outcome of the last preparation and feedback; status 0 is solved."""

    _fields_ = (
        ("prepare_seconds", ctypes.c_double),
        ("rollout_seconds", ctypes.c_double),
        ("tangent_seconds", ctypes.c_double),
        ("condense_seconds", ctypes.c_double),
        ("feedback_seconds", ctypes.c_double),
        ("status", ctypes.c_int),
        ("iterations", ctypes.c_int),
        ("rows", ctypes.c_int),
        ("solves", ctypes.c_int),
    )


class RtiSolver:
    """One controller's solver: `prepare` linearises before a tick, `feedback` solves for the measured state.

    states: (N + 1, nx) predicted, a view of the C memory.
    inputs: (N, nu) predicted rotor speeds, rad/s, a view of the C memory.
    history: (columns, 13 + nu) past rigid-body states and commanded rotor speeds of a learned model, oldest first, the
        last one a column before the state; to be written before `propagate` and `prepare`.

    An instance belongs to one thread.
    """

    def __init__(self, model: FlownModel, problem: Problem, library: Path | None = None) -> None:
        """library: a compiled kernel, instead of the model's own code, which is compiled unless cached."""
        self.model, self.problem = model, problem
        self._code = load_kernel(library or solver_library(model, problem))
        self._declare()
        self.trim = trim_of(model)
        options = fill_options(problem, model, self.trim)
        columns = 0 if library is None else self._require_dimensions(library, ctypes.sizeof(options))
        self._handle = ctypes.c_void_p(self._code.rti_create(ctypes.byref(options)))
        nodes, states, inputs = problem.nodes, model.state_count, model.input_count
        self.states = self._view("rti_states", (nodes + 1, states))
        self.inputs = self._view("rti_inputs", (nodes, inputs))
        self.parameters = self._view("rti_parameters", (model.parameter_values.size,))
        self.environment = self._view("rti_environment", (ENVIRONMENT_DEFAULT.size,))
        self.hessian = self._view("rti_hessian", (nodes * inputs, nodes * inputs))
        self.gradient = self._view("rti_gradient", (nodes * inputs,))
        shape = (columns, RIGID_BODY_STATES + inputs)
        self.history = self._view("rti_history", shape) if columns else np.zeros(shape)
        self.report: RtiReport = self._code.rti_last_report(self._handle).contents
        self.parameters[:], self.environment[:] = model.parameter_values, ENVIRONMENT_DEFAULT
        self._state, self._input, self._next = np.zeros(states), np.zeros(inputs), np.zeros(states)
        self.state_reference = np.zeros((nodes + 1, states))
        self.input_reference = np.zeros((nodes, inputs))
        address = ctypes.c_void_p
        self._state_at, self._input_at = address(self._state.ctypes.data), address(self._input.ctypes.data)
        self._next_at = address(self._next.ctypes.data)
        self._accelerations = np.zeros(6)
        self._accelerations_at = address(self._accelerations.ctypes.data)
        self._references_at = (
            address(self.state_reference.ctypes.data),
            address(self.input_reference.ctypes.data),
        )

    def __del__(self) -> None:
        if handle := getattr(self, "_handle", None):
            self._code.rti_free(handle)

    def reset(self, state: NDArray[np.float64]) -> None:
        """Forget the trajectory: every node holds the state (nx,), every rotor its hover speed."""
        self.states[:] = state
        self.inputs[:] = self.trim.rotor_speed

    def propagate(self, state: NDArray[np.float64], speed: NDArray[np.float64], dt: float) -> NDArray[np.float64]:
        """The state (nx,) after dt seconds of the rotor speeds (nu,) rad/s. The next call overwrites the array."""
        self._state[:], self._input[:] = state, speed
        self._code.rti_propagate(self._handle, self._state_at, self._input_at, dt, self._next_at)
        return self._next

    def shift(self, seconds: float) -> None:
        """Move the predicted inputs by the time that passes between two ticks."""
        self._code.rti_shift(self._handle, min(seconds / self.problem.node, 1.0))

    def prepare(self, expected: NDArray[np.float64]) -> int:
        """Linearise and condense at the state (nx,) expected at the next tick, with the references as they are set.

        Returns 0, or a negative number when one is not finite; `feedback` then refuses.
        """
        self._state[:] = expected
        return int(self._code.rti_prepare(self._handle, self._state_at, *self._references_at))

    def accelerations(self, state: NDArray[np.float64], speed: NDArray[np.float64]) -> NDArray[np.float64]:
        """A learned model's mean accelerations (6,) after a state (nx,), world and body axes; needs a kernel."""
        self._state[:], self._input[:] = state, speed
        self._code.rti_accelerations(self._handle, self._state_at, self._input_at, self._accelerations_at)
        return self._accelerations.copy()

    def stream(self, columns: NDArray[np.float64]) -> NDArray[np.float64]:
        """Accelerations (n, 6) at columns (n, 13 + nu) that follow the history one by one; needs a kernel.

        Of the network alone, or with a model whose hidden states are held constant.
        """
        rows, accelerations = np.ascontiguousarray(columns, dtype=float), np.empty((len(columns), 6))
        address = ctypes.c_void_p
        self._code.rti_stream(self._handle, address(rows.ctypes.data), len(rows), address(accelerations.ctypes.data))
        return accelerations

    def feedback(self, state: NDArray[np.float64]) -> int:
        """Solve for the measured state (nx,). Returns the status, 0 when solved.

        With 1, out of iterations, the trajectory takes the last iterate; with any other it stays the previous solution.
        """
        self._state[:] = state
        return int(self._code.rti_feedback(self._handle, self._state_at))

    def _declare(self) -> None:
        code, pointer = self._code, ctypes.c_void_p
        code.rti_create.restype = pointer
        code.rti_last_report.restype = ctypes.POINTER(RtiReport)
        code.rti_propagate.argtypes = (pointer, pointer, pointer, ctypes.c_double, pointer)
        if hasattr(code, "rti_accelerations"):
            code.rti_accelerations.argtypes = (pointer, pointer, pointer, pointer)
            code.rti_stream.argtypes = (pointer, pointer, ctypes.c_int, pointer)
        code.rti_shift.argtypes = (pointer, ctypes.c_double)
        code.rti_prepare.argtypes = (pointer, pointer, pointer, pointer)
        code.rti_feedback.argtypes = (pointer, pointer)
        code.rti_free.argtypes = code.rti_last_report.argtypes = (pointer,)

    def _require_dimensions(self, library: Path, options_bytes: int) -> int:
        """Columns of a kernel's history. Raises RequestError when it was built for other dimensions."""
        dimensions = (ctypes.c_int * len(KERNEL_DIMENSIONS))()
        self._code.rti_dimensions(dimensions)
        built = dict(zip(KERNEL_DIMENSIONS, dimensions, strict=True))
        required = {
            "states": self.model.state_count,
            "inputs": self.model.input_count,
            "nodes": self.problem.nodes,
            "parameters": self.model.parameter_values.size,
            "environment": ENVIRONMENT_DEFAULT.size,
            "options_bytes": options_bytes,
        }
        if wrong := [
            f"{name} {built[name]} instead of {size}" for name, size in required.items() if built[name] != size
        ]:
            raise RequestError(f"the kernel {library} was built for {', '.join(wrong)}. Export the model again.")
        return int(built["history"])

    def _view(self, function: str, shape: tuple[int, ...]) -> NDArray[np.float64]:
        pointer = getattr(self._code, function)
        pointer.restype, pointer.argtypes = ctypes.POINTER(ctypes.c_double), (ctypes.c_void_p,)
        return np.ctypeslib.as_array(pointer(self._handle), shape=shape)
