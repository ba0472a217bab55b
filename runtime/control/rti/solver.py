"""The RTI solver's Python interface: arrays that the C code reads and writes, and one call a phase."""

from __future__ import annotations

import ctypes
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from dynamics.errors import RequestError
from dynamics.model import ENVIRONMENT_DEFAULT
from dynamics.state import RIGID_BODY_STATES
from dynamics.trust import with_lock
from dynamics.vehicle import GRAVITY
from runtime.control.kernel_model import FlownModel, trim_of
from runtime.control.rti.last_setpoint import LastSetpointCheck, LastSetpointModel
from runtime.control.rti.loading import load_kernel
from runtime.control.rti.prebuilt import solver_library
from runtime.control.rti.problem import Problem, fill_options

KERNEL_DIMENSIONS = (
    "states",
    "inputs",
    "nodes",
    "parameters",
    "environment",
    "history",
    "steps",
    "vector_bytes",
    "options_bytes",
    "filter_bytes",
    "soft_rows",
    "last_setpoint_bytes",
)
SOLVED, CUT = 0, 1  # status; a cut quadratic program has an answer whose inputs keep their bounds
AXES = 6  # linear, world axes, then angular, body axes
DISTURBANCE = 2 * AXES + 2
STAYING, FADING, FOLLOWED = AXES, 2 * AXES, 3 * AXES  # where parts of the filter's state begin
MAX_FOLLOWED = 16
FILTER_SETTINGS = (
    "gate", "walk", "calm", "rising", "falling", "persistence", "variation", "drag_deviations", "offset",
)  # fmt: skip
MAX_SEGMENTS = 64  # of inputs between two states


class RtiReport(ctypes.Structure):
    """Times in seconds and outcome of the last preparation and feedback; status is SOLVED, CUT or a failure."""

    _fields_ = (
        ("prepare_seconds", ctypes.c_double),
        ("rollout_seconds", ctypes.c_double),
        ("tangent_seconds", ctypes.c_double),
        ("condense_seconds", ctypes.c_double),
        ("feedback_seconds", ctypes.c_double),
        ("status", ctypes.c_int),
        ("iterations", ctypes.c_int),
        ("rows", ctypes.c_int),
        ("preparation_iterations", ctypes.c_int),
    )


class FilterOptions(ctypes.Structure):
    """The C struct filter_options (flight_filter.h)."""

    _fields_ = (
        *(
            (name, ctypes.c_double * AXES)
            for name in ("measurement", "drift", "fading", "fading_time", "limit", "start")
        ),
        *((name, ctypes.c_double) for name in FILTER_SETTINGS),
        *((name, ctypes.c_double) for name in ("forecast", "averaging", "tolerance")),
        ("resolution", ctypes.c_double * 2),
        ("known_drag", ctypes.c_double),
        *((name, ctypes.c_double * MAX_FOLLOWED) for name in ("prior", "scale", "lower", "upper")),
        ("count", ctypes.c_int),
        *((name, ctypes.c_int * MAX_FOLLOWED) for name in ("index", "group")),
    )


class SolverAddresses(NamedTuple):
    """A solver's handle, three of its functions, and the memory of its predicted states and inputs."""

    handle: int
    propagate: int
    feedback: int
    check: int
    states: int
    inputs: int


class RtiSolver:
    """One controller's solver: `prepare` linearises before a tick, `feedback` solves for the measured state.

    states: (N + 1, nx) predicted, a view of the C memory.
    inputs: (N, nu) predicted rotor speeds, rad/s, a view of the C memory.
    input_upper: (nu,) highest rotor speeds, rad/s, a view of the C memory.
    disturbance: (14,) accelerations beyond the model that its predictions have: six that stay, six that fade, both
        linear m/s^2, world axes, and angular rad/s^2, body axes; and the rates at which these fade, 1/s. A view.
    follows: whether the kernel has what parameters that follow in flight need; a network's alone has not.
    rotor_speed_places: where a state holds the rotors' real speeds, a place for each lag of the model; empty without.
    certainty: (2,) of a learned model since the last `assess`: the members' disagreement over what one validation row
        in 100 exceeds, NaN for one member alone, and the share of the network's output that predictions have.
    assesses: whether the kernel is a network's.
    last_input: (n,) inputs of a network's last layer at the beginning of the last `propagate`, a view.
    output_change: (6, n + 1) what is added to a network's last layer, weights then bias, from the next `assess` on: of
        linear, m/s^2, body or world axes, and angular accelerations, rad/s^2. A view.
    measured_gradient: (N nu,) the quadratic program's gradient at the last `feedback`, a view.
    rows: (m, n) its soft rows, padded, node by node, of every bounded state and of thrust, a view.
    row_bounds: (2, m) their upper and lower bounds, a view.
    history: (columns, 13 + nu) past rigid-body states and commanded rotor speeds of a learned model, oldest first, the
        last one a column before the state; to be written before `propagate` and `prepare`.

    An instance belongs to one thread.
    """

    def __init__(self, model: FlownModel, problem: Problem, library: Path | None = None) -> None:
        """library: a compiled kernel, instead of the model's own code, which is compiled unless cached."""
        self.model, self.problem = model, problem
        kernel = load_kernel(library or solver_library(model, problem), own=library is None)
        # only what takes long gives the interpreter's lock away
        self._code, self._long = with_lock(kernel), kernel
        self.trim = trim_of(model)
        options = fill_options(problem, model, self.trim)
        columns = 0 if library is None else self._require_dimensions(library, ctypes.sizeof(options))
        self._declare()
        self._handle = ctypes.c_void_p(self._code.rti_create(ctypes.byref(options)))
        if not self._handle:
            raise RequestError(f"the kernel {library} was built for other intervals. Export the model again.")
        nodes, states, inputs = problem.nodes, model.state_count, model.input_count
        self.states = self._view("rti_states", (nodes + 1, states))
        self.inputs = self._view("rti_inputs", (nodes, inputs))
        self.parameters = self._view("rti_parameters", (model.parameter_values.size,))
        self.environment = self._view("rti_environment", (ENVIRONMENT_DEFAULT.size,))
        self.input_upper = self._view("rti_input_upper", (inputs,))
        self.disturbance = self._view("rti_disturbance", (DISTURBANCE,))
        self.filter_options: FilterOptions = self._code.rti_filter_options(self._handle).contents
        self.filter_state = self._view("rti_filter_state", (FOLLOWED + MAX_FOLLOWED,))
        self.filter_covariance = self._view("rti_filter_covariance", (FOLLOWED, FOLLOWED))
        self.filter_deviations = self._view("rti_filter_deviations", (MAX_FOLLOWED,))
        self.filter_trust = self._view("rti_filter_trust", (2,))
        self.filter_squares = self._view("rti_filter_squares", (2, 2))
        self.filter_level = self._view("rti_filter_level", (1,))
        self.filter_followed = self._view("rti_filter_followed", (MAX_FOLLOWED,), ctypes.c_int)
        self.hessian = self._view("rti_hessian", (nodes * inputs, nodes * inputs))
        self.gradient = self._view("rti_gradient", (nodes * inputs,))
        self.measured_gradient = self._view("rti_measured_gradient", (nodes * inputs,))
        capacity, width = self._code.rti_row_capacity(), self._code.rti_row_width()
        self.rows = self._view("rti_rows", (capacity, width))
        self.row_bounds = self._view("rti_row_bounds", (2, capacity))
        self.assesses = hasattr(self._code, "rti_assess")
        self.certainty = self._view("rti_certainty", (2,)) if self.assesses else np.array([np.nan, 1.0])
        width = self._code.rti_last_width() if self.assesses else 0
        self.last_input = self._view("rti_last_input", (width,)) if width else np.zeros(0)
        self.output_change = self._view("rti_output_change", (AXES, width + 1)) if width else np.zeros((AXES, 1))
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
        self._by_file = np.zeros(AXES)
        self._by_file_at = address(self._by_file.ctypes.data)
        self._shares = np.zeros((inputs, AXES))
        self._shares_at = address(self._shares.ctypes.data)
        self._segments, self._segment_seconds = np.zeros((MAX_SEGMENTS, inputs)), np.zeros(MAX_SEGMENTS)
        self._segments_at = address(self._segments.ctypes.data), address(self._segment_seconds.ctypes.data)
        self.rotor_speed_places = model.rotor_speed_places
        self._lagged = self.rotor_speed_places[-1].start if self.rotor_speed_places else -1
        self.follows = hasattr(self._code, "rti_fly")
        self._references_at = (
            address(self.state_reference.ctypes.data),
            address(self.input_reference.ctypes.data),
        )

    @property
    def addresses(self) -> SolverAddresses:
        """Of what a caller in C needs; valid as long as this is."""

        def function(name: str) -> int:
            return ctypes.cast(getattr(self._code, name), ctypes.c_void_p).value or 0

        return SolverAddresses(
            handle=self._handle.value or 0,
            propagate=function("rti_propagate"),
            feedback=function("rti_feedback"),
            check=function("last_setpoint_check"),
            states=self.states.ctypes.data,
            inputs=self.inputs.ctypes.data,
        )

    def __del__(self) -> None:
        if handle := getattr(self, "_handle", None):
            self._code.rti_free(handle)

    def reset(self, state: NDArray[np.float64]) -> None:
        """Forget the trajectory: every node holds the state (nx,), every rotor its hover speed."""
        self.states[:] = state
        self.inputs[:] = self.trim.rotor_speed
        if self.assesses:
            self._code.rti_trust(self._handle)

    def propagate(self, state: NDArray[np.float64], speed: NDArray[np.float64], dt: float) -> NDArray[np.float64]:
        """The state (nx,) after dt seconds of the rotor speeds (nu,) rad/s. The next call overwrites the array."""
        self._state[:], self._input[:] = state, speed
        self._code.rti_propagate(self._handle, self._state_at, self._input_at, dt, self._next_at)
        return self._next

    def clear_filter(self) -> None:
        """Let the flight filter forget everything."""
        self._code.rti_filter_clear(self._handle)

    def restart_filter(self, state: NDArray[np.float64]) -> None:
        """Let the flight filter go on from a state (nx,)."""
        self._state[:] = state
        self._code.rti_filter_restart(self._handle, self._state_at)

    def compare_in_filter(
        self,
        before: NDArray[np.float64],
        change: NDArray[np.float64],
        change_by_file: NDArray[np.float64],
        state: NDArray[np.float64],
        dt: float,
    ) -> bool:
        """Take a state (nx,) into the flight filter, dt seconds after the one before.

        change: (6,) of velocity and rate, predicted by the model alone. change_by_file: by the model as it was trained.
        Returns whether it was used.
        """
        self._state[:], self._accelerations[:], self._next[:] = before, change, state
        self._by_file[:] = change_by_file
        arguments = self._state_at, self._accelerations_at, self._by_file_at, self._next_at
        return bool(self._code.rti_filter_compare(self._handle, *arguments, dt))

    def follow(
        self,
        before: NDArray[np.float64],
        speeds: Sequence[Sequence[float]] | NDArray[np.float64],
        seconds: Sequence[float] | NDArray[np.float64],
        state: NDArray[np.float64],
    ) -> bool:
        """Take a state (nx,) into the flight filter, after speeds (k, nu), rad/s, for seconds (k,) from the one before.

        Not for a learned model. k: at most MAX_SEGMENTS. Returns whether it was used.
        """
        count = len(seconds)
        self._state[:], self._next[:] = before, state
        self._segments[:count], self._segment_seconds[:count] = speeds, seconds
        return bool(self._code.rti_follow(self._handle, self._state_at, *self._segments_at, count, self._next_at))

    def begin_thrust(self, hover: NDArray[np.float64], *, lag: float, period: float) -> None:
        """Begin a history of commands, not for a learned model. hover: (nu,) rad/s.

        lag: s, of first order, of thrust behind them that the model does not predict. period: between commands, s.
        """
        left = math.exp(-period / lag) if lag > 0 else 0.0  # of the response after a period
        self._input[:] = hover
        self._code.rti_begin_thrust(self._handle, self._input_at, left, (1 - left) * lag / period)

    def clear_thrust(self) -> None:
        """Forget the commands; thrust is that of hover."""
        self._code.rti_clear_thrust(self._handle)

    def add_thrust(self, time: float, speed: NDArray[np.float64], thrust: float) -> None:
        """Let thrust follow a command, rotor speeds (nu,) rad/s that act from a time on, s.

        thrust: of all rotors as it left, N, by which the speeds are scaled; NaN where it left as it was.
        """
        self._input[:] = speed
        self._code.rti_add_thrust(self._handle, time, self._input_at, thrust)

    def follow_commands(
        self, before: NDArray[np.float64], start: float, state: NDArray[np.float64], stop: float
    ) -> bool:
        """Take a state (nx,) into the flight filter, after the commands that acted since the one before; times in s.

        Not for a learned model. Returns whether it was used.
        """
        self._state[:], self._next[:] = before, state
        return bool(self._code.rti_follow_between(self._handle, self._state_at, start, stop, self._next_at))

    def rotor_shares(
        self,
        before: NDArray[np.float64],
        speeds: Sequence[float] | NDArray[np.float64],
        state: NDArray[np.float64],
        dt: float,
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Evidence of a state (nx,) about the rotors, dt seconds after the one before. speeds: (nu,) real ones, rad/s.

        Returns accelerations (6,) beyond the model without the disturbance, and those (nu, 6) that each rotor's whole
        thrust and torque give, linear m/s^2, world axes, and angular rad/s^2, body axes. The next call overwrites both.
        Not for a learned model.
        """
        self._state[:], self._input[:], self._next[:] = before, speeds, state
        inputs = self._state_at, self._input_at, self._lagged, dt, self._next_at
        self._code.rti_rotor_shares(self._handle, *inputs, self._accelerations_at, self._shares_at)
        return self._accelerations, self._shares

    def add_rotor_shares(
        self,
        before: NDArray[np.float64],
        speeds: Sequence[float] | NDArray[np.float64],
        state: NDArray[np.float64],
        dt: float,
        force: float,
        sums_at: int,
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Evidence as `rotor_shares`, accumulated into the sums of a `RotorLossTest`.

        sums_at: address of (1 + nu, 3) float64.
        force: specific force along body z in place of the estimate's, m/s^2; NaN without one.
        """
        self._state[:], self._input[:], self._next[:] = before, speeds, state
        inputs = self._state_at, self._input_at, self._lagged, dt, self._next_at
        outputs = self._accelerations_at, self._shares_at, sums_at
        self._code.rti_add_rotor_shares(self._handle, *inputs, force, GRAVITY, *outputs)
        return self._accelerations, self._shares

    def specific_drag(self, state: NDArray[np.float64], speed: NDArray[np.float64]) -> float:
        """Specific force along body z that the model has in a state (nx,) beside the thrust of a level vehicle, m/s^2.

        speed: (nu,) rad/s, in hover. Not for a learned model.
        """
        self._state[:], self._input[:] = state, speed
        return float(self._code.rti_specific_drag(self._handle, self._state_at, self._input_at, GRAVITY))

    def fly(self, moments: float) -> None:
        """Let predictions have what the flight filter estimated, as far as it is trusted; not of a learned model.

        moments: share of the angular disturbance.
        """
        self._code.rti_fly(self._handle, moments)

    def fly_disturbance(self, moments: float) -> None:
        """Let predictions have the estimated disturbance alone, of any model. moments: share of its angular part."""
        self._code.rti_fly_disturbance(self._handle, moments)

    def shift(self, seconds: float) -> None:
        """Move the predicted inputs by the time that passes between two ticks."""
        self._code.rti_shift(self._handle, seconds)

    def prepare(self, expected: NDArray[np.float64]) -> int:
        """Linearise and condense at the state (nx,) expected at the next tick, with the references as they are set.

        Returns 0, or a negative number when one is not finite; `feedback` then refuses.
        """
        self._state[:] = expected
        return int(self._long.rti_prepare(self._handle, self._state_at, *self._references_at))

    def assess(self, state: NDArray[np.float64], speed: NDArray[np.float64]) -> None:
        """Assess how certain the network is of the window that ends with a state (nx,) and rotor speeds (nu,), rad/s.

        Predictions have as much of a residual as that leaves, until the next call.
        """
        if self.assesses:
            self._state[:], self._input[:] = state, speed
            self._code.rti_assess(self._handle, self._state_at, self._input_at)

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
        self._long.rti_stream(self._handle, address(rows.ctypes.data), len(rows), address(accelerations.ctypes.data))
        return accelerations

    def feedback(self, state: NDArray[np.float64]) -> int:
        """Solve for the measured state (nx,). Returns the status, 0 when solved.

        With 1, out of iterations, the trajectory takes the last iterate; with any other it stays the previous solution.
        """
        self._state[:] = state
        return int(self._long.rti_feedback(self._handle, self._state_at))

    def last_setpoint_check(self, model: LastSetpointModel) -> LastSetpointCheck:
        """The check of setpoints that may be the last ones, which the kernel has. model: of vehicle and autopilot."""
        return LastSetpointCheck(self._code, model)

    def _declare(self) -> None:
        code, pointer = self._code, ctypes.c_void_p
        code.rti_create.restype = pointer
        code.rti_last_report.restype = ctypes.POINTER(RtiReport)
        code.rti_propagate.argtypes = (pointer, pointer, pointer, ctypes.c_double, pointer)
        if hasattr(code, "rti_accelerations"):
            code.rti_accelerations.argtypes = (pointer, pointer, pointer, pointer)
            self._long.rti_stream.argtypes = (pointer, pointer, ctypes.c_int, pointer)
            code.rti_assess.argtypes, code.rti_trust.argtypes = (pointer, pointer, pointer), (pointer,)
        code.rti_filter_options.restype = ctypes.POINTER(FilterOptions)
        code.rti_filter_options.argtypes = code.rti_filter_clear.argtypes = (pointer,)
        code.rti_filter_restart.argtypes = (pointer, pointer)
        code.rti_filter_compare.argtypes = (*[pointer] * 5, ctypes.c_double)
        code.rti_fly_disturbance.argtypes = (pointer, ctypes.c_double)
        if hasattr(code, "rti_follow"):
            code.rti_follow.argtypes = (pointer, pointer, pointer, pointer, ctypes.c_int, pointer)
        if hasattr(code, "rti_fly"):
            numbers = ctypes.c_int, ctypes.c_double
            code.rti_rotor_shares.argtypes = (*[pointer] * 3, *numbers, *[pointer] * 3)
            code.rti_add_rotor_shares.argtypes = (
                *[pointer] * 3, *numbers, pointer, ctypes.c_double, ctypes.c_double, *[pointer] * 3
            )  # fmt: skip
            code.rti_specific_drag.argtypes = (*[pointer] * 3, ctypes.c_double)
            code.rti_specific_drag.restype = ctypes.c_double
            code.rti_fly.argtypes = (pointer, ctypes.c_double)
            code.rti_begin_thrust.argtypes = (pointer, pointer, ctypes.c_double, ctypes.c_double)
            code.rti_clear_thrust.argtypes = (pointer,)
            code.rti_add_thrust.argtypes = (pointer, ctypes.c_double, pointer, ctypes.c_double)
            code.rti_follow_between.argtypes = (pointer, pointer, ctypes.c_double, ctypes.c_double, pointer)
        code.rti_shift.argtypes = (pointer, ctypes.c_double)
        self._long.rti_prepare.argtypes = (pointer, pointer, pointer, pointer)
        self._long.rti_feedback.argtypes = (pointer, pointer)
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
            "filter_bytes": ctypes.sizeof(FilterOptions),
            "soft_rows": self.problem.nodes * (self.model.state_count + 1),
            "last_setpoint_bytes": ctypes.sizeof(LastSetpointModel),
        }
        if wrong := [
            f"{name} {built[name]} instead of {size}" for name, size in required.items() if built[name] != size
        ]:
            raise RequestError(f"the kernel {library} was built for {', '.join(wrong)}. Export the model again.")
        return int(built["history"])

    def _view(self, function: str, shape: tuple[int, ...], kind: Any = ctypes.c_double) -> NDArray[Any]:
        pointer = getattr(self._code, function)
        pointer.restype, pointer.argtypes = ctypes.POINTER(kind), (ctypes.c_void_p,)
        return np.ctypeslib.as_array(pointer(self._handle), shape=shape)
