"""The C solver against independent CasADi code: same derivatives, same optimum, bounds that hold."""

from pathlib import Path
from typing import Any

import casadi as ca
import msgspec
import numpy as np
import pytest

import vehicles
from dynamics.codegen import build_library
from dynamics.errors import RequestError
from dynamics.integrators import rk4
from dynamics.model import ENVIRONMENT_DEFAULT, Model, build_model
from dynamics.trim import Trim
from dynamics.vehicle import EffectUse, Limits, Vehicle
from dynamics.vehicle_file import read_vehicle
from runtime.control.rti import solver as rti_solver
from runtime.control.rti.problem import Problem, fill_options
from runtime.control.rti.solver import AXES, CUT, DISTURBANCE, SOLVED, RtiSolver

VEHICLE = read_vehicle(Path(vehicles.FOLDER) / "arpl_250g.toml")
EQUAL, GROWING = Problem(nodes=8, horizon=0.4), Problem(nodes=8, horizon=0.6, growth=1.3)
FADING_FORCE = AXES  # place of the fading disturbance along world x
UNLIMITED = msgspec.structs.replace(VEHICLE, limits=Limits(rate=(1e3, 1e3, 1e3)))


def hovering(model: Model) -> np.ndarray:
    return model.initial_state(np.array([0.0, 0.0, 1.0, *[0.0] * 3, 1.0, *[0.0] * 6]))


def disturbed(model: Model, seed: int = 0) -> np.ndarray:
    noise = np.random.default_rng(seed).normal(size=model.state_count)
    state = hovering(model)
    state[:13] += noise[:13] * np.array([0.3] * 3 + [0.5] * 3 + [0.05] * 4 + [0.3] * 3)
    state[6:10] /= np.linalg.norm(state[6:10])
    return state


def excited(solver: RtiSolver, seed: int = 0) -> np.ndarray:
    """A solver with random inputs along the horizon and a moving reference; returns the state it starts from."""
    rng = np.random.default_rng(seed)
    state = disturbed(solver.model, seed)
    solver.reset(state)
    solver.inputs[:] *= 1 + 0.05 * rng.normal(size=solver.inputs.shape)
    solver.state_reference[:] = hovering(solver.model)
    solver.state_reference[:, 0] += np.linspace(0, 0.5, solver.states.shape[0])
    solver.input_reference[:] = solver.model.vehicle.hover_speed
    return state


def residuals(solver: RtiSolver) -> ca.Function:
    """Weighted residuals of the horizon as a function of the scaled inputs and the first state, by single shooting."""
    model, problem = solver.model, solver.problem
    options = fill_options(problem, model)
    lags = [item.values[name] for item in model.effects for name in item.effect.time_constants]
    x0, v = ca.MX.sym("x0", model.state_count), ca.MX.sym("v", model.input_count * problem.nodes)
    x, parts = x0, []
    quiet = np.zeros(model.hidden_count)
    for k, interval in enumerate(problem.intervals):
        substeps, share = max([1, *(int(np.ceil(interval / lag)) for lag in lags)]), np.sqrt(interval / problem.node)
        u = solver.inputs[k].copy() + options.scale * v[k * model.input_count : (k + 1) * model.input_count]
        if k:
            parts.append(share * np.sqrt(list(options.Q)) * (x - solver.state_reference[k]))
        parts.append(share * np.sqrt(list(options.R)) * (u - solver.input_reference[k]))
        for _ in range(substeps):
            x = rk4(
                lambda s, u=u: model.derivative(s, u, model.parameter_values, ENVIRONMENT_DEFAULT, quiet),
                x,
                interval / substeps,
            )
    parts.append(np.sqrt(list(options.P)) * (x - solver.state_reference[-1]))
    return ca.Function("residuals", [x0, v], [ca.vertcat(*parts)])


def gauss_newton(solver: RtiSolver, state: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Hessian and gradient by CasADi's derivative of the residuals."""
    function = residuals(solver)
    x0, v = ca.MX.sym("x0", function.size1_in(0)), ca.MX.sym("v", function.size1_in(1))
    value = function(x0, v)
    both = ca.Function("both", [x0, v], [value, ca.jacobian(value, v)])
    residual, jacobian = (np.array(part) for part in both(state, np.zeros(function.size1_in(1))))
    damping = solver.problem.levenberg_marquardt * np.eye(jacobian.shape[1])
    return jacobian.T @ jacobian + damping, (jacobian.T @ residual).ravel()


def six_rotors() -> Vehicle:
    angles = np.arange(6) * np.pi / 3
    position = tuple((0.2 * float(np.cos(a)), 0.2 * float(np.sin(a)), 0.0) for a in angles)
    rotors = msgspec.structs.replace(VEHICLE.rotors, position=position, spin=(1, -1) * 3)
    return msgspec.structs.replace(VEHICLE, rotors=rotors)


@pytest.mark.parametrize(
    ("vehicle", "effects"),
    [
        (VEHICLE, []),
        (VEHICLE, [EffectUse("motor_lag", {"time_constant": 0.02}), EffectUse("parasitic_drag")]),
        (six_rotors(), []),
    ],
    ids=["nominal", "lag and drag", "six rotors"],
)
@pytest.mark.parametrize("problem", [EQUAL, GROWING], ids=["equal", "growing"])
def test_condensed_hessian_and_gradient_are_gauss_newtons(
    vehicle: Vehicle, effects: list[EffectUse], problem: Problem
) -> None:
    solver = RtiSolver(build_model(vehicle, effects=effects), problem)
    state = excited(solver)
    solver.prepare(state)
    hessian, gradient = gauss_newton(solver, state)
    np.testing.assert_allclose(solver.hessian, hessian, rtol=1e-9, atol=1e-9 * np.abs(hessian).max())
    np.testing.assert_allclose(solver.gradient, gradient, rtol=1e-9, atol=1e-9 * np.abs(gradient).max())


def reference_step(solver: RtiSolver, hessian: np.ndarray, gradient: np.ndarray) -> np.ndarray:
    """The box-constrained optimum by CasADi's own active-set method, as inputs (N, nu)."""
    options = fill_options(solver.problem, solver.model)
    size = gradient.size
    lower = (np.tile(list(options.u_lower), solver.problem.nodes) - solver.inputs.ravel()) / options.scale
    upper = (np.tile(list(options.u_upper), solver.problem.nodes) - solver.inputs.ravel()) / options.scale
    quadratic = {"h": ca.Sparsity.dense(size, size), "a": ca.Sparsity(0, size)}
    conic = ca.conic("qp", "qrqp", quadratic, {"print_iter": False, "print_header": False, "print_info": False})
    answer = conic(h=hessian, g=gradient, lbx=lower, ubx=upper)
    return solver.inputs + options.scale * np.array(answer["x"]).reshape(solver.inputs.shape)


@pytest.mark.parametrize(("horizon", "growth"), [(0.5, 1.0), (1.0, 1.1)], ids=["equal", "growing"])
@pytest.mark.parametrize("push", [0.0, 4.0], ids=["inside", "saturated"])
def test_feedback_finds_the_optimum_of_its_quadratic_program(push: float, horizon: float, growth: float) -> None:
    problem = Problem(nodes=10, horizon=horizon, growth=growth, tolerance=1e-8, iterations=50)
    solver = RtiSolver(build_model(UNLIMITED), problem)
    expected = excited(solver)
    solver.prepare(expected)
    measured = expected.copy()
    measured[:6] += 0.02
    measured[0] -= push
    hessian, _ = gauss_newton(solver, expected)
    by_state = np.zeros((solver.gradient.size, 13))
    for i in range(13):
        by_state[:, i] = gradient_by_state(solver, expected, i)
    gradient = solver.gradient + by_state @ (measured - expected)
    optimum = reference_step(solver, hessian, gradient)
    assert solver.feedback(measured) == 0
    np.testing.assert_allclose(solver.inputs, optimum, atol=0.05)
    limits = (optimum < fill_options(solver.problem, solver.model).u_lower[0] + 1e-3) | (
        optimum > VEHICLE.rotors.speed_max - 1e-3
    )
    assert limits.any() == (push > 0)


def gradient_by_state(solver: RtiSolver, expected: np.ndarray, index: int) -> np.ndarray:
    """Column of J_v' J_x0, the exact feedback of one initial state, by CasADi."""
    function = residuals(solver)
    x0, v = ca.MX.sym("x0", 13), ca.MX.sym("v", function.size1_in(1))
    value = function(x0, v)
    both = ca.Function("both", [x0, v], [ca.jacobian(value, v), ca.jacobian(value, x0)[:, index]])
    by_input, by_state = (np.array(part) for part in both(expected, np.zeros(function.size1_in(1))))
    return (by_input.T @ by_state).ravel()


def test_body_rates_stay_within_their_limits_and_the_extra_rows_are_solved_only_then() -> None:
    limited = msgspec.structs.replace(VEHICLE, limits=Limits(rate=(2.0, 2.0, 2.0)))
    solver = RtiSolver(build_model(limited), Problem())
    state = hovering(solver.model)
    solver.reset(state)
    solver.state_reference[:] = state
    solver.input_reference[:] = VEHICLE.hover_speed
    solver.prepare(state)
    assert solver.feedback(state) == 0
    assert solver.report.rows == 0
    solver.state_reference[:, 0] = 1.0
    peaks, rows = [], []
    for _ in range(40):
        solver.prepare(state)
        assert solver.feedback(state) == 0
        peaks.append(np.abs(solver.states[1:, 10:13]).max())
        rows.append(solver.report.rows)
        state = solver.propagate(state, solver.inputs[0], 0.01).copy()
    assert max(rows) > 0
    assert max(peaks) < 2.0 * 1.02
    assert max(peaks) > 1.9  # the limit acts


def test_collective_thrust_settles_within_its_limits() -> None:
    weight = VEHICLE.weight
    limits = Limits(rate=(20.0, 20.0, 20.0), thrust=(0.5 * weight, 1.1 * weight))
    solver = RtiSolver(build_model(msgspec.structs.replace(VEHICLE, limits=limits)), Problem())
    state = hovering(solver.model)
    solver.reset(state)
    solver.state_reference[:] = state
    solver.state_reference[:, 2] = 1.4
    solver.input_reference[:] = VEHICLE.hover_speed
    for _ in range(20):
        solver.prepare(state)
        assert solver.feedback(state) == 0
    thrust = VEHICLE.rotors.thrust_constant * (solver.inputs**2).sum(axis=1)
    assert thrust.max() < 1.1 * weight * 1.01
    assert thrust.max() > 1.08 * weight
    assert thrust.min() > 0.5 * weight * 0.99


def test_the_position_box_holds_the_prediction_back() -> None:
    boxed = msgspec.structs.replace(
        VEHICLE, limits=Limits(rate=(20.0, 20.0, 20.0), box=((-1.0, -1.0, 0.0), (0.3, 1.0, 2.0)))
    )
    ends = []
    for keep in (False, True):
        solver = RtiSolver(build_model(boxed), Problem(keep_in_box=keep))
        state = hovering(solver.model)
        solver.reset(state)
        solver.state_reference[:] = state
        solver.state_reference[:, 0] = 1.0
        solver.input_reference[:] = VEHICLE.hover_speed
        for _ in range(150):
            solver.prepare(state)
            solver.feedback(state)
            state = solver.propagate(state, solver.inputs[0], 0.01).copy()
        ends.append(state[0])
    assert ends[0] > 0.9
    assert ends[1] < 0.35


@pytest.mark.parametrize("fades", [False, True])
def test_a_push_towards_the_wall_is_held_within_the_box(fades: bool) -> None:
    """A constant push that the prediction has beside a wall that the reference leaves; without it the box is left."""
    wall, push = 0.3, 3.0  # m, m/s^2
    boxed = msgspec.structs.replace(
        VEHICLE, limits=Limits(rate=(20.0, 20.0, 20.0), box=((-1.0, -1.0, 0.0), (wall, 1.0, 2.0)))
    )
    reached = []
    for predicted in (False, True):
        solver, plant = (RtiSolver(build_model(boxed), Problem()) for _ in range(2))
        plant.disturbance[0] = push
        if predicted:
            solver.disturbance[6 if fades else 0], solver.disturbance[12] = push, 1.0
        state = hovering(solver.model)
        solver.reset(state)
        solver.state_reference[:] = state
        solver.state_reference[:, 0] = 1.0
        solver.input_reference[:] = VEHICLE.hover_speed
        positions = []
        for _ in range(300):
            solver.prepare(state)
            assert solver.feedback(state) in (SOLVED, CUT)
            state = plant.propagate(state, solver.inputs[0], 0.01).copy()
            positions.append(state[0])
        reached.append(max(positions))
        assert not predicted or abs(positions[-1] - wall) < 0.001
    assert reached[0] > wall + 0.03
    assert reached[1] < wall + 0.005


def test_the_prediction_stays_within_the_vehicles_speed() -> None:
    slow = msgspec.structs.replace(VEHICLE, limits=Limits(rate=(20.0, 20.0, 20.0), speed=1.0))
    solver = RtiSolver(build_model(slow), Problem())
    state = hovering(solver.model)
    solver.reset(state)
    solver.state_reference[:] = state
    solver.state_reference[:, 0] = 1.0
    solver.input_reference[:] = VEHICLE.hover_speed
    fastest = 0.0
    for _ in range(120):
        solver.prepare(state)
        solver.feedback(state)
        state = solver.propagate(state, solver.inputs[0], 0.01).copy()
        fastest = max(fastest, abs(state[3]))
    assert 0.9 < fastest < 1.05


def test_a_state_that_is_not_finite_changes_nothing() -> None:
    solver = RtiSolver(build_model(VEHICLE), Problem())
    state = excited(solver)
    solver.prepare(state)
    before = solver.inputs.copy()
    for bad in (np.nan, np.inf):
        broken = state.copy()
        broken[4] = bad
        assert solver.feedback(broken) == -1
        np.testing.assert_array_equal(solver.inputs, before)
    assert solver.feedback(state) == 0


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_a_quadratic_program_that_is_not_finite_changes_nothing_and_leaves_nothing_behind(bad: float) -> None:
    solver, fresh = (RtiSolver(build_model(VEHICLE), Problem()) for _ in range(2))
    state = excited(solver)
    excited(fresh)
    for used in (solver, fresh):
        used.state_reference[:, 0] += 10  # rotors saturate
    before = solver.inputs.copy()
    for broken in (solver.hessian, solver.gradient):
        assert solver.prepare(state) == 0
        broken[...] = bad
        assert solver.feedback(state) > 0
        np.testing.assert_array_equal(solver.inputs, before)
    for used in (solver, fresh):
        assert used.prepare(state) == 0
        assert used.feedback(state) in (SOLVED, CUT)
        assert used.report.iterations > 0
    np.testing.assert_array_equal(solver.inputs, fresh.inputs)


def test_a_prediction_that_is_not_finite_is_refused() -> None:
    solver = RtiSolver(build_model(VEHICLE), Problem())
    state = excited(solver)
    solver.parameters[0] = np.nan
    assert solver.prepare(state) == -2
    assert solver.feedback(state) == -1


def test_a_rotor_whose_bounds_coincide_keeps_its_speed(monkeypatch: pytest.MonkeyPatch) -> None:
    speed = VEHICLE.hover_speed

    def one_rotor_fixed(problem: Problem, model: Model, trim: Trim) -> Any:
        options = fill_options(problem, model, trim)
        options.u_lower[2] = options.u_upper[2] = speed
        return options

    monkeypatch.setattr(rti_solver, "fill_options", one_rotor_fixed)
    solver = RtiSolver(build_model(UNLIMITED), Problem(nodes=5, horizon=0.25))
    state = excited(solver)
    solver.inputs[:, 2] = speed
    assert solver.prepare(state) == 0
    expected = solver.inputs.ravel().copy()
    free = np.arange(expected.size) % 4 != 2
    scale = fill_options(solver.problem, solver.model).scale
    expected[free] -= scale * np.linalg.solve(solver.hessian[np.ix_(free, free)], solver.gradient[free])
    assert solver.feedback(state) == 0
    np.testing.assert_allclose(solver.inputs.ravel(), expected, atol=1e-3 * speed)


def test_shifting_by_a_whole_node_moves_every_input_to_the_node_before() -> None:
    solver = RtiSolver(build_model(VEHICLE), Problem())
    excited(solver)
    before = solver.inputs.copy()
    solver.shift(solver.problem.node)
    np.testing.assert_allclose(solver.inputs[:-1], before[1:])
    np.testing.assert_allclose(solver.inputs[-1], before[-1])


def test_shifting_by_less_than_the_shortest_interval_moves_what_the_inputs_integrate_to() -> None:
    """Over each interval, whatever its length: the mean of what was planned for that time."""
    problem = Problem(nodes=6, horizon=0.6, growth=1.5)
    solver = RtiSolver(build_model(VEHICLE), problem)
    excited(solver)
    seconds = 0.7 * problem.node
    ends = np.concatenate([problem.offsets, [problem.horizon + 1.0]])  # the last input goes on
    integral = np.vstack([np.zeros(4), np.cumsum(np.diff(ends)[:, None] * solver.inputs[[*range(6), 5]], axis=0)])

    def planned(times: np.ndarray) -> np.ndarray:
        return np.column_stack([np.interp(times, ends, integral[:, rotor]) for rotor in range(4)])

    expected = np.diff(planned(problem.offsets + seconds), axis=0) / np.array(problem.intervals)[:, None]
    solver.shift(seconds)
    np.testing.assert_allclose(solver.inputs, expected, rtol=1e-9)


def test_the_disturbance_fades_by_the_time_of_a_node_whatever_the_intervals() -> None:
    rates = [DISTURBANCE - 2, DISTURBANCE - 1]
    state, lengths = None, []
    for problem in (Problem(nodes=60, horizon=0.6), Problem(nodes=8, horizon=0.6, growth=1.3)):
        solver = RtiSolver(build_model(VEHICLE, effects=[EffectUse("motor_lag", {"time_constant": 0.01})]), problem)
        state = hovering(solver.model)
        solver.reset(state)
        solver.state_reference[:], solver.input_reference[:] = state, solver.model.vehicle.hover_speed
        solver.disturbance[FADING_FORCE], solver.disturbance[rates] = 1.0, 5.0
        assert solver.prepare(state) == 0
        lengths.append(solver.states[-1, 3])
    assert lengths[1] == pytest.approx(lengths[0], rel=1e-3)
    assert lengths[0] == pytest.approx((1 - np.exp(-3.0)) / 5.0, rel=1e-3)


@pytest.mark.parametrize("growth", [1.0, 1.2], ids=["equal", "growing"])
def test_repeated_iterations_converge_to_the_nonlinear_optimum(growth: float) -> None:
    solver = RtiSolver(build_model(UNLIMITED), Problem(nodes=10, horizon=0.5, growth=growth))
    state = excited(solver)
    state[:13] = hovering(solver.model) + 0.2 * (state - hovering(solver.model))
    state[6:10] /= np.linalg.norm(state[6:10])
    for _ in range(30):
        solver.prepare(state)
        solver.feedback(state)
    solver.prepare(state)
    free = (solver.inputs > fill_options(solver.problem, solver.model).u_lower[0] + 1.0) & (
        solver.inputs < VEHICLE.rotors.speed_max - 1.0
    )
    assert np.abs(solver.gradient[free.ravel()]).max() < 1e-3 * np.abs(np.diag(solver.hessian)).max()
    step_before = solver.inputs.copy()
    solver.feedback(state)
    np.testing.assert_allclose(solver.inputs, step_before, atol=0.5)


def test_a_kernel_of_another_version_is_refused(tmp_path: Path) -> None:
    """One that was exported before this version lacks functions: its dimensions say so first."""
    source = "void rti_dimensions(int *built) { for (int i = 0; i < 9; i++) built[i] = 1; }"
    library = build_library({"older.c": source}, entry="older.c")
    with pytest.raises(RequestError, match=r"filter_bytes 0 instead of .* Export the model again"):
        RtiSolver(build_model(VEHICLE), Problem(), library)
