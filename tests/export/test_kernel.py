"""The kernel against plain NumPy: same accelerations, same roll-out, same derivatives, same optimum."""

from pathlib import Path

import msgspec
import numpy as np
import pytest

import vehicles
from dynamics import quaternion
from dynamics.errors import RequestError
from dynamics.integrators import step_function
from dynamics.model import ENVIRONMENT_DEFAULT, build_model
from dynamics.vehicle import EffectUse, Limits
from dynamics.vehicle_file import read_vehicle
from export.kernel import Precision, build_kernel, kernel_recipe, kernel_solver
from export.network import Network
from export.reverse_split import split_after
from runtime.control.rti.problem import Problem, fill_options
from runtime.control.rti.processor import PROCESSORS, native_processor
from runtime.control.rti.solver import RtiSolver
from tests.support.networks import HOVER_SPEED, accelerations, random_network

VEHICLE = msgspec.structs.replace(
    read_vehicle(Path(vehicles.FOLDER) / "arpl_250g.toml"), limits=Limits(rate=(1e3, 1e3, 1e3))
)
_ANGLES = np.arange(6) * np.pi / 3
HEXAROTOR = msgspec.structs.replace(
    VEHICLE,
    rotors=msgspec.structs.replace(
        VEHICLE.rotors,
        position=tuple((0.1 * float(np.cos(a)), 0.1 * float(np.sin(a)), 0.0) for a in _ANGLES),
        spin=(1, -1) * 3,
    ),
)
VEHICLES = {vehicle.rotors.count: vehicle for vehicle in (VEHICLE, HEXAROTOR)}
SHORT = Problem(nodes=5, horizon=0.25)
GROWING = Problem(nodes=5, horizon=0.3, growth=1.5)
LAG_AND_DRAG = [EffectUse("motor_lag", {"time_constant": 0.03}), EffectUse("linear_drag", {"coefficient": 0.05})]
CASES = {
    "body": (random_network(), []),
    "world": (random_network(inputs="world", outputs="world", seed=1), []),
    "one column": (random_network(channels=(), dilations=(), seed=2), []),
    "window of four": (random_network(channels=(48,), taps=4, dilations=(1,), hidden=(32,), seed=3), []),
    "odd widths": (random_network(channels=(5, 20), taps=2, dilations=(3, 1), hidden=(7, 40), seed=4), []),
    "six rotors": (random_network(rotors=6, seed=8), []),
    "residual": (random_network(channels=(8,), dilations=(2,), hidden=(16,), residual=True, seed=5), []),
    "residual on lag and drag": (
        random_network(channels=(8,), dilations=(2,), hidden=(16,), outputs="world", residual=True, seed=6),
        LAG_AND_DRAG,
    ),
    "residual near the ground": (
        random_network(channels=(), dilations=(), hidden=(16,), residual=True, seed=7),
        [EffectUse("ground_effect")],
    ),
}
INSTANTANEOUS = {
    "instantaneous": CASES["body"],
    "instantaneous, one column": CASES["one column"],
    "instantaneous residual on lag and drag": CASES["residual on lag and drag"],
}
WITHOUT_PHYSICS = ("body", "world", "one column", "window of four", "odd widths", "six rotors")


def window(network: Network, seed: int = 0, *, more: int = 0) -> np.ndarray:
    """Random columns (receptive field and so many more, 13 + rotors)."""
    rng = np.random.default_rng(seed)
    scale = np.array([0.1] * 3 + [1.0] * 3 + [0.1] * 4 + [1.0] * 3 + [40.0] * network.rotors)
    columns = rng.normal(size=(network.receptive_field + more, 13 + network.rotors)) * scale
    columns[:, 2] += 0.5
    columns[:, 6] += 1
    columns[:, 6:10] = quaternion.normalise(columns[:, 6:10])
    columns[:, 13:] += HOVER_SPEED
    return columns


def solver_of(case: str, precision: Precision, problem: Problem = SHORT) -> tuple[RtiSolver, np.ndarray]:
    """A solver with a random history and random inputs along the horizon, and the state that it starts from."""
    network, effects = (CASES | INSTANTANEOUS)[case]
    model = build_model(VEHICLES[network.rotors], effects=effects)
    mean = case not in INSTANTANEOUS
    solver = kernel_solver(network, model, problem, native_processor(), precision, mean=mean)
    columns = window(network, more=not mean)
    solver.history[:] = columns[:-1]
    state = model.initial_state(columns[-1, :13])
    solver.reset(state)
    solver.inputs[:] *= 1 + 0.03 * np.random.default_rng(9).normal(size=solver.inputs.shape)
    solver.state_reference[:] = state
    solver.state_reference[:, 0] += 0.1
    solver.input_reference[:] = model.vehicle.hover_speed
    return solver, state


def copied(solver: RtiSolver, other: RtiSolver) -> RtiSolver:
    """The other one, given the same history, inputs and references."""
    other.history[:], other.inputs[:] = solver.history, solver.inputs
    other.state_reference[:], other.input_reference[:] = solver.state_reference, solver.input_reference
    return other


def rolled_out(solver: RtiSolver, state: np.ndarray) -> np.ndarray:
    """States (N + 1, nx) of the kernel's own roll-out from a state along the solver's inputs."""
    assert solver.prepare(state) == 0
    return solver.states.copy()


@pytest.mark.parametrize("case", ["body", "world", "one column", "window of four"])
def test_columns_that_are_streamed_give_what_their_windows_do(case: str) -> None:
    """More of them than the horizon has steps, where memory moves on."""
    network, _ = CASES[case]
    solver, _ = solver_of(case, "double")
    columns = window(network, seed=3, more=40)
    before = len(solver.history)
    solver.history[:] = columns[:before]
    expected = [accelerations(network, columns[: row + 1]) for row in range(before, len(columns))]
    np.testing.assert_allclose(solver.stream(columns[before:]), expected, rtol=0, atol=1e-10)


def by_input_and_state(solver: RtiSolver, state: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Derivatives of the nodes' states (N, nx) by all inputs and by the first state, by central differences."""
    inputs = solver.inputs.copy()
    columns = []
    for v in range(inputs.size):
        ends = []
        for sign in (1, -1):
            solver.inputs[:] = inputs
            solver.inputs.reshape(-1)[v] += sign * 1e-3
            ends.append(rolled_out(solver, state)[1:].ravel())
        columns.append((ends[0] - ends[1]) / 2e-3)
    solver.inputs[:] = inputs
    first = []
    for i in range(state.size):
        step = 1e-6 * np.eye(state.size)[i]
        first.append((rolled_out(solver, state + step)[1:] - rolled_out(solver, state - step)[1:]).ravel() / 2e-6)
    return np.array(columns).T, np.array(first).T


@pytest.mark.parametrize(
    ("case", "precision", "tolerance"),
    [(case, "double", 1e-12) for case in WITHOUT_PHYSICS] + [("body", "float", 1e-5), ("world", "float", 1e-5)],
)
def test_accelerations_are_those_of_plain_numpy(case: str, precision: Precision, tolerance: float) -> None:
    solver, _ = solver_of(case, precision)
    network, _ = CASES[case]
    for seed in range(20):
        columns = window(network, seed)
        solver.history[:] = columns[:-1]
        computed, expected = solver.accelerations(columns[-1, :13], columns[-1, 13:]), accelerations(network, columns)
        assert np.linalg.norm(computed - expected) < tolerance * np.linalg.norm(expected)


@pytest.mark.parametrize("problem", [SHORT, GROWING], ids=["equal", "growing"])
def test_a_streamed_roll_out_is_that_of_whole_windows(problem: Problem) -> None:
    solver, state = solver_of("body", "double", problem)
    network, _ = CASES["body"]
    columns, x, h = list(window(network)[:-1]), state, network.dt
    expected = [x]
    for k, interval in enumerate(problem.intervals):
        for _ in range(round(interval / h)):
            columns.append(np.concatenate([x, solver.inputs[k]]))
            rates = accelerations(network, np.array(columns[-network.receptive_field :]))
            turn = h * (x[10:13] + h / 2 * rates[3:])
            x = np.concatenate(
                [x[0:3] + h * x[3:6] + h * h / 2 * rates[:3], x[3:6] + h * rates[:3],
                 quaternion.multiply(x[6:10], quaternion.exponential(turn)), x[10:13] + h * rates[3:]]
            )  # fmt: skip
        expected.append(x)
    np.testing.assert_allclose(rolled_out(solver, state), expected, rtol=0, atol=1e-11)


@pytest.mark.parametrize("case", ["residual", "residual on lag and drag", "residual near the ground"])
def test_a_residual_is_added_to_the_mean_accelerations_of_the_model(case: str) -> None:
    solver, state = solver_of(case, "double")
    network, _ = CASES[case]
    columns = window(network)
    model = solver.model
    step = step_function(model)
    quiet = np.zeros(model.hidden_count)
    after = step(state, columns[-1, 13:], model.parameter_values, ENVIRONMENT_DEFAULT, quiet, network.dt)
    after = np.array(after).ravel()
    physics = np.concatenate([after[3:6] - state[3:6], after[10:13] - state[10:13]]) / network.dt
    expected = accelerations(network, columns, physics)
    np.testing.assert_allclose(solver.accelerations(state, columns[-1, 13:]), expected, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize(
    ("case", "precision", "tolerance", "problem"),
    [(case, "double", 1e-6, SHORT) for case in (*CASES, *INSTANTANEOUS)]
    + [(case, "float", 2e-4, SHORT) for case in ("body", "residual on lag and drag")]
    + [(case, "double", 1e-6, GROWING) for case in ("body", "one column", "residual on lag and drag")],
)
def test_hessian_and_gradient_are_gauss_newtons_of_the_roll_out(
    case: str, precision: Precision, tolerance: float, problem: Problem
) -> None:
    exact, state = solver_of(case, "double", problem)
    by_input, _ = by_input_and_state(exact, state)
    states = rolled_out(exact, state)
    options = fill_options(problem, exact.model)
    shares = np.array(problem.intervals) / problem.node
    weight = np.array([*(share * np.array(list(options.Q)) for share in shares[1:]), list(options.P)]).ravel()
    by_stage = np.repeat(shares, exact.model.input_count)
    jacobian = options.scale * by_input
    hessian = jacobian.T @ (weight[:, None] * jacobian)
    hessian += np.diag(by_stage * options.R[0] * options.scale**2 + options.levenberg_marquardt)
    gradient = jacobian.T @ (weight * (states - exact.state_reference)[1:].ravel())
    gradient += by_stage * options.scale * options.R[0] * (exact.inputs - exact.input_reference).ravel()
    solver, _ = solver_of(case, precision, problem)
    solver.prepare(state)
    np.testing.assert_allclose(solver.hessian, hessian, rtol=0, atol=tolerance * np.abs(hessian).max())
    np.testing.assert_allclose(solver.gradient, gradient, rtol=0, atol=tolerance * np.abs(gradient).max())


def test_a_kernel_refuses_intervals_that_it_was_not_built_for() -> None:
    network, _ = CASES["one column"]
    model = build_model(VEHICLE, effects=[])
    library = build_kernel(kernel_recipe(network, model, SHORT, native_processor(), "double"))
    with pytest.raises(RequestError, match="other intervals"):
        RtiSolver(model, GROWING, library)


def test_intervals_that_a_networks_steps_do_not_fill_are_refused() -> None:
    network, _ = CASES["one column"]
    model = build_model(VEHICLE, effects=[])
    with pytest.raises(RequestError, match="45 ms are no whole number"):
        kernel_recipe(network, model, Problem(nodes=2, horizon=0.09), native_processor())


@pytest.mark.parametrize("streamed_layers", range(5))
def test_tangents_are_the_same_wherever_streaming_ends_and_sweeping_begins(streamed_layers: int) -> None:
    solver, state = solver_of("body", "double")
    solver.prepare(state)
    network, _ = CASES["body"]
    split = split_after(network, streamed_layers)
    recipe = kernel_recipe(network, solver.model, SHORT, native_processor(), "double", split=split)
    other = copied(solver, RtiSolver(solver.model, SHORT, build_kernel(recipe)))
    other.prepare(state)
    np.testing.assert_allclose(other.hessian, solver.hessian, rtol=1e-10, atol=1e-12 * np.abs(solver.hessian).max())


def test_what_a_sweep_keeps_between_preparations_changes_nothing() -> None:
    used, state = solver_of("body", "float")
    used.history[:] = window(CASES["body"][0], 5)[:-1]
    used.inputs[:] *= 0.9
    used.prepare(state + 0.1)
    fresh, state = solver_of("body", "float")
    copied(fresh, used)
    for solver in (fresh, used):
        assert solver.prepare(state) == 0
    np.testing.assert_array_equal(used.hessian, fresh.hessian)
    np.testing.assert_array_equal(used.gradient, fresh.gradient)


@pytest.mark.parametrize("case", ["body", "residual on lag and drag", "residual near the ground"])
def test_feedback_answers_a_state_that_differs_from_the_expected_one(case: str) -> None:
    solver, state = solver_of(case, "double")
    solver.state_reference[:] = rolled_out(solver, state)
    by_input, by_state = by_input_and_state(solver, state)
    options = fill_options(SHORT, solver.model)
    weight = np.array([list(options.Q)] * (SHORT.nodes - 1) + [list(options.P)]).ravel()
    moved = 1e-3 * np.random.default_rng(4).normal(size=state.size)
    solver.prepare(state)
    gradient = solver.gradient + options.scale * by_input.T @ (weight * (by_state @ moved))
    expected = solver.inputs - options.scale * np.linalg.solve(solver.hessian, gradient).reshape(solver.inputs.shape)
    states = solver.states[1:].ravel() + by_state @ moved + by_input @ (expected - solver.inputs).ravel()
    inside = np.clip(expected, options.u_lower[0], options.u_upper[0])
    np.testing.assert_allclose(expected, inside)  # else this test would need an active set
    assert solver.feedback(state + moved) == 0
    np.testing.assert_allclose(solver.inputs, expected, atol=1e-4 * np.abs(expected - options.scale).max())
    np.testing.assert_allclose(solver.states[1:].ravel(), states, atol=1e-4)


def test_propagation_over_parts_of_a_column_holds_the_acceleration() -> None:
    solver, state = solver_of("body", "double")
    network, _ = CASES["body"]
    speed = window(network)[-1, 13:]
    rates = solver.accelerations(state, speed)
    half = solver.propagate(state, speed, 0.005).copy()
    np.testing.assert_allclose(half[3:6], state[3:6] + 0.005 * rates[:3], rtol=1e-12)
    solver.inputs[0] = speed
    np.testing.assert_allclose(solver.propagate(state, speed, 0.05), rolled_out(solver, state)[1], atol=1e-13)


@pytest.mark.parametrize("where", ["state", "history", "reference"])
def test_numbers_that_are_not_finite_are_refused_and_change_nothing(where: str) -> None:
    solver, state = solver_of("body", "float")
    assert solver.prepare(state) == 0
    before = solver.inputs.copy()
    broken = state.copy()
    if where == "state":
        broken[4] = np.nan
    elif where == "history":
        solver.history[3, 5] = np.inf
    else:
        solver.state_reference[2, 1] = np.nan
    assert solver.prepare(broken) == -1
    assert solver.feedback(state) == -1
    np.testing.assert_array_equal(solver.inputs, before)


def test_inputs_and_predictions_that_are_not_finite_are_refused_until_they_are() -> None:
    solver, state = solver_of("body", "float")
    before, far = solver.inputs.copy(), state.copy()
    far[6] = 1e200  # no rotation can be made of it
    solver.inputs[2, 1] = np.nan
    for start, expected in ((state, -1), (far, -2), (state, 0)):
        assert solver.prepare(start) == expected
        assert solver.feedback(state) == (0 if expected == 0 else -1)
        solver.inputs[:] = before


@pytest.mark.parametrize("name", ["avx512", "avx2", "sse2"])
def test_every_vector_width_gives_the_same(name: str) -> None:
    if not PROCESSORS[name].runs_here:
        pytest.skip(f"this processor has no {name}")
    network, _ = CASES["odd widths"]
    solver, state = solver_of("odd widths", "double")
    solver.prepare(state)
    other = copied(solver, kernel_solver(network, build_model(VEHICLE, effects=[]), SHORT, PROCESSORS[name], "double"))
    other.prepare(state)
    np.testing.assert_allclose(other.hessian, solver.hessian, rtol=1e-10, atol=1e-12 * np.abs(solver.hessian).max())
