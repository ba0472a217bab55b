"""Proof that every backend of a bundle computes the same: torch, ONNX Runtime, CasADi, CasADi's C and the kernel."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import casadi as ca
import msgspec
import numpy as np
import onnxruntime

from dynamics.arrays import Floats
from dynamics.codegen import CompiledFunction
from dynamics.errors import DataError
from dynamics.integrators import step_function
from dynamics.model import ENVIRONMENT_DEFAULT
from dynamics.state import ATTITUDE, RATE, RIGID_BODY_STATES, VELOCITY
from export.kinematics import roll_out
from export.trained import ExportedModel, torch_forward
from runtime.control.rti.problem import fill_options
from runtime.control.rti.solver import RtiSolver
from training.data.features import accelerations_from, columns, world_accelerations
from training.data.features import body_accelerations as to_body

SINGLE, DOUBLE = 1e-5, 1e-12
DERIVATIVE, SINGLE_DERIVATIVE = 1e-5, 1e-3
ROLL_OUTS = 20
INPUT_SPREAD = 0.02  # of hover speed
DIFFERENCE_STEP = 1e-7  # of the scaled inputs: central differences must not step over a ReLU's kink
Backend = Callable[[Floats, Floats], Floats]


class Comparison(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The greatest error of a backend over some windows, relative to the RMS of what it is compared with."""

    backend: str
    against: str
    windows: str
    count: int
    error: float
    tolerance: float

    @property
    def holds(self) -> bool:
        """Whether the error is within the tolerance; false for NaN."""
        return self.error <= self.tolerance


class Parity(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """All comparisons of a bundle."""

    comparisons: tuple[Comparison, ...]

    def require(self) -> None:
        """Raises DataError naming what does not hold."""
        if broken := [
            f"{c.backend} differs from {c.against} on {c.count} {c.windows} windows by {c.error:.2g} "
            f"(allowed: {c.tolerance:g})"
            for c in self.comparisons
            if not c.holds
        ]:
            raise DataError(f"the exported model is not the trained one: {'; '.join(broken)}. Nothing was written.")


@dataclass(frozen=True, eq=False)
class Backends:
    """The implementations of an exported model.

    onnx: serialised model.onnx.
    forward, jacobian: interpreted by CasADi.
    weighted: the same with a given share of the network's output.
    compiled: model.c as machine code, by function.
    single: the kernel.
    double: the kernel in doubles, for comparison alone; the same one where RK4 integrates, which computes in doubles.
    """

    model: ExportedModel
    onnx: bytes
    forward: ca.Function
    jacobian: ca.Function
    weighted: ca.Function
    compiled: Mapping[str, CompiledFunction]
    single: RtiSolver
    double: RtiSolver

    @property
    def kernels(self) -> dict[str, RtiSolver]:
        """By precision."""
        if self.model.integrator == "rk4":
            return {"double": self.double}
        return {"double": self.double, "float": self.single}


def prove(backends: Backends, windows: Mapping[str, Floats], seed: int = 0) -> Parity:
    """Compare all backends on windows (n, 13 + rotors, `model.window`) by name.

    Derivatives are compared with central differences, roll-outs of the kernels with plain NumPy on the first windows;
    from random ones a vehicle spins faster than the kernels' series for a step's rotation converge.
    """
    model = backends.model
    rng = np.random.default_rng(seed)
    comparisons: list[Comparison] = []
    for name, batch in windows.items():
        hidden = _some_hidden(model, len(batch), rng)
        exact = _interpreted(backends)(batch, hidden)
        for backend, tolerance in _tolerances(model).items():
            outputs = _named(backends)[backend](batch, hidden)
            comparisons.append(_compare(backend, "CasADi interpreted, double", name, outputs, exact, tolerance))
        comparisons.append(_jacobian(backends, name, batch[:5], hidden[:5]))
    name, batch = next(iter(windows.items()))
    comparisons += _roll_outs(backends, name, batch[:ROLL_OUTS], rng)
    for precision, solver in backends.kernels.items():
        comparisons.append(_kernel_gradient(backends, solver, batch[0], precision))
    return Parity(tuple(comparisons))


def _some_hidden(model: ExportedModel, count: int, rng: np.random.Generator) -> Floats:
    """(count, hidden) hidden states about those of hover."""
    return np.asarray(model.flight_model.hidden_initial * (1 + 0.05 * rng.normal(size=(count, model.hidden_count))))


def _tolerances(model: ExportedModel) -> dict[str, float]:
    tolerances = {"ONNX Runtime, float": SINGLE, "CasADi C, double": DOUBLE}
    if model.network is not None and model.trained is not None:
        tolerances |= {"torch, double": DOUBLE, "torch, float": SINGLE}
    if model.integrator == "rk4":
        return tolerances  # its kernel computes roll-outs only, no accelerations
    return tolerances | {"kernel, double": DOUBLE, "kernel, float": SINGLE}


def _named(backends: Backends) -> dict[str, Backend]:
    return {
        "ONNX Runtime, float": _onnx(backends),
        "CasADi C, double": _compiled(backends),
        "torch, double": _torch(backends, double=True),
        "torch, float": _torch(backends, double=False),
        "kernel, double": _kernel(backends.double),
        "kernel, float": _kernel(backends.single),
    }


def _compare(backend: str, against: str, windows: str, outputs: Floats, exact: Floats, tolerance: float) -> Comparison:
    scale = np.sqrt(np.mean(np.sum(exact**2, axis=-1)))
    error = float(np.max(np.linalg.norm(outputs - exact, axis=-1)) / scale)
    return Comparison(backend, against, windows, len(exact), error, tolerance)


def _interpreted(backends: Backends) -> Backend:
    def run(windows: Floats, hidden: Floats) -> Floats:
        rows = zip(_newest(backends, windows), hidden, strict=True)
        return np.array([np.array(backends.forward(*row)[0]).ravel() for row in rows])

    return run


def _newest(backends: Backends, windows: Floats) -> Floats:
    """The columns of the model's own window."""
    return windows[..., -backends.model.history :]


def _compiled(backends: Backends) -> Backend:
    code = backends.compiled[backends.forward.name()]

    def run(windows: Floats, hidden: Floats) -> Floats:
        rows = zip(_newest(backends, windows), hidden, strict=True)
        return np.array([code(history=w.ravel(order="F"), hidden=h)["acceleration"].copy() for w, h in rows])

    return run


def _onnx(backends: Backends) -> Backend:
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    session = onnxruntime.InferenceSession(backends.onnx, options, providers=["CPUExecutionProvider"])

    def run(windows: Floats, hidden: Floats) -> Floats:
        feed = {"history": _newest(backends, windows).astype(np.float32)}
        if hidden.shape[1]:
            feed["hidden"] = hidden.astype(np.float32)
        alone = session.run(["acceleration"], {name: values[:1] for name, values in feed.items()})[0]
        together = np.asarray(session.run(["acceleration"], feed)[0], dtype=float)
        return np.concatenate([alone, together[1:]])  # the first as a batch of one, the others as one batch

    return run


def _kernel(solver: RtiSolver) -> Backend:
    def run(windows: Floats, hidden: Floats) -> Floats:
        rows = []
        for window, carried in zip(windows, hidden, strict=True):
            look_back(solver, window)
            state = np.concatenate([window[:RIGID_BODY_STATES, -1], carried])
            solver.assess(state, window[RIGID_BODY_STATES:, -1])
            rows.append(solver.accelerations(state, window[RIGID_BODY_STATES:, -1]))
        return np.array(rows)

    return run


def look_back(solver: RtiSolver, window: Floats) -> None:
    """Give a solver what lies before a window's newest column."""
    if columns := len(solver.history):
        solver.history[:] = window[:, -1 - columns : -1].T


def _torch(backends: Backends, *, double: bool) -> Backend:
    """The checkpoint's own path: training's columns, torch's network, training's accelerations."""
    model = backends.model
    config, vehicle = model.config, model.vehicle

    def run(windows: Floats, hidden: Floats) -> Floats:
        rows = _newest(backends, windows).transpose(0, 2, 1)
        inputs = columns(config, rows[..., :RIGID_BODY_STATES], rows[..., RIGID_BODY_STATES:])
        outputs = torch_forward(model, inputs, double=double)
        attitude = windows[:, ATTITUDE, -1]
        base = None if model.physics is None else to_body(_physics(model, windows, hidden), attitude)
        return world_accelerations(accelerations_from(config, vehicle, outputs, base, attitude), attitude)

    return run


def _physics(model: ExportedModel, windows: Floats, hidden: Floats) -> Floats:
    """(n, 6) accelerations of the physics alone, world and body axes, by `dynamics`."""
    physics, dt = model.physics, model.config.dt
    assert physics is not None
    states = np.hstack([windows[:, :RIGID_BODY_STATES, -1], hidden])
    speeds, still = windows[:, RIGID_BODY_STATES:, -1], np.zeros(physics.hidden_count)
    step, rows = step_function(physics), []
    for x, u in zip(states, speeds, strict=True):
        if model.mean:
            after = np.array(step(x, u, physics.parameter_values, ENVIRONMENT_DEFAULT, still, dt)).ravel()
            slope = (after - x) / dt
        else:
            slope = np.array(physics.derivative(x, u, physics.parameter_values, ENVIRONMENT_DEFAULT, still)).ravel()
        rows.append(np.concatenate([slope[VELOCITY], slope[RATE]]))
    return np.array(rows)


def _jacobian(backends: Backends, name: str, windows: Floats, hidden: Floats) -> Comparison:
    """CasADi C's Jacobian against central differences of its forward function."""
    code, forward = backends.compiled[backends.jacobian.name()], _compiled(backends)
    windows = _newest(backends, windows)
    steps = 1e-8 * np.maximum(np.abs(windows).max(axis=(0, 2)), 1)
    exact, outputs = [], []
    for window, carried in zip(windows, hidden, strict=True):
        differences = []
        for t in range(window.shape[1]):
            for i in range(window.shape[0]):
                change = np.zeros_like(window)
                change[i, t] = steps[i]
                pair = np.array([window + change, window - change])
                ends = forward(pair, np.array([carried, carried]))
                differences.append((ends[0] - ends[1]) / 2)
        exact.append(np.array(differences).ravel())
        by_history = code(history=window.ravel(order="F"), hidden=carried)["by_history"].reshape(-1, 6)
        outputs.append((by_history * np.tile(steps, window.shape[1])[:, None]).ravel())
    return _compare(
        "CasADi C, double: Jacobian", "central differences", name, np.array(outputs), np.array(exact), DERIVATIVE
    )


def _roll_outs(backends: Backends, name: str, windows: Floats, rng: np.random.Generator) -> list[Comparison]:
    """The kernels' predictions along random inputs against plain NumPy's, each number in units of its RMS."""
    model, problem = backends.model, backends.double.problem
    hover = model.vehicle.hover_speed
    inputs = hover * (1 + INPUT_SPREAD * rng.normal(size=(len(windows), *backends.double.inputs.shape)))
    hidden = _some_hidden(model, len(windows), rng)
    rows = list(zip(windows, hidden, inputs, strict=True))
    shares = [_share(backends.double, *row) for row in rows]
    exact = np.array(
        [
            roll_out(model, backends.weighted, problem, *row, share=share)[1:]
            for row, share in zip(rows, shares, strict=True)
        ]
    )
    scale = np.sqrt(np.mean(exact**2, axis=(0, 1)))
    comparisons = []
    for precision, solver in backends.kernels.items():
        outputs = np.array([_predicted(solver, *row)[1:] for row in rows])
        tolerance = DOUBLE if precision == "double" else SINGLE
        label = f"kernel, {precision}: roll-out"
        comparisons.append(_compare(label, "plain NumPy, double", name, outputs / scale, exact / scale, tolerance))
    return comparisons


def _share(solver: RtiSolver, window: Floats, hidden: Floats, inputs: Floats) -> float:
    """Share of the network's output that a kernel predicts with."""
    look_back(solver, window)
    solver.assess(np.concatenate([window[:RIGID_BODY_STATES, -1], hidden]), inputs[0])
    return float(solver.certainty[1])


def _predicted(solver: RtiSolver, window: Floats, hidden: Floats, inputs: Floats) -> Floats:
    """(N + 1, nx) states that a kernel predicts."""
    _share(solver, window, hidden, inputs)
    state = np.concatenate([window[:RIGID_BODY_STATES, -1], hidden])
    solver.state_reference[:], solver.input_reference[:], solver.inputs[:] = state, inputs, inputs
    solver.prepare(state)
    return solver.states.copy()


def _kernel_gradient(backends: Backends, solver: RtiSolver, window: Floats, precision: str) -> Comparison:
    """A kernel's condensed gradient along random directions against central differences of the double's roll-out."""
    rng = np.random.default_rng(1)
    exact, model = backends.double, backends.model.flight_model
    state = model.initial_state(window[:RIGID_BODY_STATES, -1])
    hover = np.full_like(exact.inputs, model.vehicle.hover_speed)
    inputs = hover * (1 + INPUT_SPREAD * rng.normal(size=hover.shape))
    for each in (exact, solver):
        look_back(each, window)
        each.assess(state, hover[0])
        each.state_reference[:], each.input_reference[:], each.inputs[:] = state, hover, inputs
        each.prepare(state)
    exact_slopes, slopes, scale = [], [], fill_options(exact.problem, model).scale
    gradient = solver.gradient.copy()
    for _ in range(5):
        direction = rng.normal(size=hover.shape)
        costs = []
        for step in (DIFFERENCE_STEP, -DIFFERENCE_STEP):
            exact.inputs[:] = inputs + step * scale * direction
            exact.prepare(state)
            costs.append(_cost(exact))
        exact_slopes.append((costs[0] - costs[1]) / (2 * DIFFERENCE_STEP))
        slopes.append(float(gradient @ direction.ravel()))
    pair = np.array(slopes)[:, None], np.array(exact_slopes)[:, None]
    tolerance = DERIVATIVE if precision == "double" else SINGLE_DERIVATIVE
    return _compare(
        f"kernel, {precision}: gradient", "central differences of the roll-out", "roll-out", *pair, tolerance
    )


def _cost(solver: RtiSolver) -> float:
    """PI-TCN eq. 7 of a solver's current prediction."""
    options = fill_options(solver.problem, solver.model)
    error, push = solver.states - solver.state_reference, solver.inputs - solver.input_reference
    stages = np.sum(np.array(options.Q) * error[1:-1] ** 2) + np.sum(np.array(options.P) * error[-1] ** 2)
    return float(0.5 * stages + 0.5 * np.sum(np.array(options.R) * push**2))
