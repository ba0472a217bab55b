"""The box-constrained quadratic program of every RTI step, against HPIPM and against its optimality conditions."""

import numpy as np
import pytest
from scipy.optimize import lsq_linear

from dynamics.arrays import Floats
from fixtures.box_programs import BoxProgram, BoxSolvers, SoftRows, Solution
from runtime.control.rti.processor import PROCESSORS, native_processor

TOLERANCE = 1e-9  # of the largest gradient at zero


def random_program(seed: int, size: int) -> BoxProgram:
    """Conditions up to 1e5, boxes from wide to narrow around zero, scales over six decades."""
    rng = np.random.default_rng(seed)
    turned = np.linalg.qr(rng.normal(size=(size, size)))[0]
    eigenvalues = 10 ** rng.uniform(-rng.uniform(0, 5), 0, size)
    hessian = turned * eigenvalues @ turned.T
    width = 10 ** rng.uniform(-1.5, 1.5) * rng.uniform(0.2, 2, size)
    share = rng.uniform(0, 1, size)
    scale = 10 ** rng.uniform(-2, 4)
    gradient = scale * rng.normal(size=size)
    return BoxProgram(scale * (hessian + hessian.T) / 2, gradient, -width * share, width * (1 - share))


ROWS, ROW_TOLERANCE = 100, 1e-6


def program_with_rows(seed: int, size: int = 80, nodes: int = 20) -> BoxProgram:
    """A program whose rows act as those of a horizon do: node k's by the inputs up to it, many beyond their limits."""
    rng = np.random.default_rng(seed)
    program, quantities = random_program(seed, size), ROWS // nodes
    scale = float(np.abs(program.gradient).max())
    rows = rng.normal(size=(ROWS, size)) / np.sqrt(size)
    for row in range(ROWS):
        rows[row, (row // quantities + 1) * size // nodes :] = 0
    free = np.clip(np.linalg.solve(program.hessian, -program.gradient), program.lower, program.upper)
    reach = np.abs(rows @ free) + 1e-3 * np.abs(free).max()
    upper, lower = reach * rng.uniform(0.1, 2, ROWS), -reach * rng.uniform(0.1, 2, ROWS)
    penalty = 10 ** rng.uniform(0, 2)
    normalized = BoxProgram(program.hessian / scale, program.gradient / scale, program.lower, program.upper)
    return BoxProgram(**{**vars(normalized), "soft": SoftRows(rows, lower, upper, penalty)})


def stationarity(program: BoxProgram, v: Floats) -> float:
    """KKT residual at v: the least gradient that the multipliers of acting bounds and rows leave, largest entry.

    The multipliers of rows at a limit are free between none and the whole linear penalty; bounds push inwards alone.
    """
    soft = program.soft
    assert soft is not None
    value, near = soft.rows @ v, 1e-3 * (1 + np.abs(soft.upper))
    at_upper, at_lower = np.abs(value - soft.upper) <= near, np.abs(value - soft.lower) <= near
    beyond = np.where(at_upper | at_lower, 0.0, soft.price(v))
    slope = program.hessian @ v + program.gradient + soft.rows.T @ beyond
    room = 1e-3 * (program.upper - program.lower)
    columns = [
        soft.rows[at_upper].T, -soft.rows[at_lower].T,
        -np.eye(v.size)[:, v <= program.lower + room], np.eye(v.size)[:, v >= program.upper - room],
    ]  # fmt: skip
    counts = np.count_nonzero(at_upper) + np.count_nonzero(at_lower), v.size
    limits = [*[1.001 * soft.penalty] * counts[0], *[np.inf] * (sum(part.shape[1] for part in columns) - counts[0])]
    pushes = np.concatenate(columns, axis=1)
    if not pushes.size:
        return float(np.abs(slope).max())
    answer = lsq_linear(pushes, -slope, (0, np.array(limits)), tol=1e-12)
    return float(np.abs(slope + pushes @ answer.x).max())


def solved(solvers: BoxSolvers, program: BoxProgram, max_iterations: int = 50) -> Solution:
    return solvers.solve(
        program, tolerance=TOLERANCE * float(np.nanmax(np.abs(program.gradient))), max_iterations=max_iterations
    )


@pytest.mark.parametrize("name", ["avx512", "avx2", "sse2"])
@pytest.mark.parametrize("size", [80, 13])
def test_random_programs_are_solved_as_hpipm_solves_them(size: int, name: str) -> None:
    if not PROCESSORS[name].runs_here:
        pytest.skip(f"this processor has no {name}")
    solvers = BoxSolvers(size, PROCESSORS[name])
    acting, compared = 0, 0
    for seed in range(200):
        program = random_program(seed, size)
        solution = solved(solvers, program)
        assert solution.status == 0
        assert solution.iterations <= 15
        assert (solution.v >= program.lower).all()
        assert (solution.v <= program.upper).all()
        tolerance = 1e-3 * TOLERANCE * float(np.abs(program.gradient).max())  # it never solves on the bounds
        reference = solvers.solve(program, tolerance=tolerance, by="hpipm")
        if reference.status == 0:
            assert program.cost(solution.v) <= program.cost(reference.v) + 1e-7 * abs(program.cost(reference.v))
            np.testing.assert_allclose(solution.v, reference.v, atol=1e-3 * np.abs(reference.v).max())
            compared += 1
        acting += int(np.count_nonzero((solution.v == program.lower) | (solution.v == program.upper)))
    assert acting > 10 * size  # else nothing was shown
    assert compared > 190


@pytest.mark.parametrize("name", ["avx512", "avx2", "sse2"])
def test_programs_with_soft_rows_are_solved_as_hpipm_solves_them_and_keep_their_optimality(name: str) -> None:
    if not PROCESSORS[name].runs_here:
        pytest.skip(f"this processor has no {name}")
    solvers, acting, compared = BoxSolvers(80, PROCESSORS[name], ROWS), 0, 0
    for seed in range(60):
        program = program_with_rows(seed)
        assert program.soft is not None
        solution = solvers.solve(program, tolerance=ROW_TOLERANCE)
        assert solution.status == 0
        assert (solution.v >= program.lower).all()
        assert (solution.v <= program.upper).all()
        assert stationarity(program, solution.v) < 1e-3  # a complementarity of 1e-6 over the narrowest widths
        reference = solvers.solve(program, tolerance=ROW_TOLERANCE, max_iterations=200, by="hpipm")
        if reference.status == 0:
            assert program.cost(solution.v) <= program.cost(reference.v) + 1e-5 * (1 + abs(program.cost(reference.v)))
            compared += 1
        value = program.soft.rows @ solution.v
        acting += np.count_nonzero((value > program.soft.upper - 1e-4) | (value < program.soft.lower + 1e-4))
    assert acting > 5 * 60  # else nothing was shown
    assert compared > 50


def test_a_prepared_program_has_the_same_optimum() -> None:
    solvers = BoxSolvers(80, native_processor(), ROWS)
    for seed in range(40):
        program, rng = program_with_rows(seed), np.random.default_rng(seed)
        expected = program.gradient + 0.1 * rng.normal(size=80)
        prepared = solvers.solve(program, tolerance=ROW_TOLERANCE, expected=expected)
        assert prepared.status == 0
        assert program.cost(prepared.v) == pytest.approx(
            program.cost(solvers.solve(program, tolerance=ROW_TOLERANCE).v), rel=1e-4, abs=1e-4
        )


@pytest.mark.parametrize("iterations", [0, 1, 3])
def test_a_solve_that_is_cut_says_so_and_keeps_its_bounds(iterations: int) -> None:
    solvers, costs = BoxSolvers(80, native_processor(), ROWS), []
    for seed in range(40):
        program, rng = program_with_rows(seed), np.random.default_rng(seed)
        expected = program.gradient + rng.normal(size=80)
        cut = solvers.solve(program, tolerance=ROW_TOLERANCE, max_iterations=iterations, expected=expected)
        assert cut.status == 1
        assert cut.iterations <= iterations
        assert (cut.v >= program.lower).all()
        assert (cut.v <= program.upper).all()
        costs.append(program.cost(cut.v) - program.cost(solvers.solve(program, tolerance=ROW_TOLERANCE).v))
    assert min(costs) > -1e-4


def test_an_optimum_on_bounds_is_one_to_rounding() -> None:
    solvers = BoxSolvers(80, native_processor())
    for seed in range(100):
        program = random_program(seed, 80)
        assert program.optimality(solved(solvers, program).v) < 1e-10


def test_inside_the_box_the_optimum_is_newtons_step() -> None:
    solvers = BoxSolvers(13, native_processor())
    program = random_program(3, 13)
    newton_step = np.linalg.solve(program.hessian, -program.gradient)
    for room in (2.0, 0.5):
        bound = room * np.abs(newton_step)
        optimum, inside = solvers.free_optimum(BoxProgram(program.hessian, program.gradient, -bound, bound))
        assert inside == (room > 1)
        np.testing.assert_allclose(optimum, newton_step, rtol=1e-8)


def test_what_is_no_such_program_is_refused() -> None:
    solvers = BoxSolvers(13, native_processor())
    good = random_program(1, 13)
    nothing, infinite = good.upper.copy(), good.upper.copy()
    nothing[4], infinite[4] = good.lower[4], np.inf
    broken, unknown, overflown = good.gradient.copy(), good.hessian.copy(), good.hessian.copy()
    broken[2] = unknown[5, 3] = unknown[3, 5] = np.nan
    overflown[7, 7] = np.inf
    concave = good.hessian - 1.01 * np.linalg.eigvalsh(good.hessian)[0] * np.eye(13)  # in one direction, and hardly
    for program in (
        BoxProgram(good.hessian, good.gradient, good.lower, nothing),
        BoxProgram(good.hessian, good.gradient, good.lower, infinite),
        BoxProgram(good.hessian, broken, good.lower, good.upper),
        BoxProgram(unknown, good.gradient, good.lower, good.upper),
        BoxProgram(overflown, good.gradient, good.lower, good.upper),
        BoxProgram(concave, good.gradient, good.lower, good.upper),
    ):
        assert solved(solvers, program).status == 3
    assert solved(solvers, good, max_iterations=0).status == 1
    assert solved(solvers, good).status == 0


@pytest.mark.parametrize("size", [80, 13])
def test_where_rounding_leaves_no_room_nothing_is_called_an_optimum_that_is_none(size: int) -> None:
    """Boxes of a few units in the last place, far from zero, and numbers near the ends of what a double holds."""
    solvers = BoxSolvers(size, native_processor())
    answered = 0
    for seed in range(60):
        program, rng = random_program(seed, size), np.random.default_rng(seed)
        place, scale = 10 ** rng.uniform(0, 16) * rng.normal(size=size), 10 ** rng.uniform(-140, 140)
        room = np.spacing(np.abs(place)) * rng.integers(2, 30, size)
        lower, upper = (place, place + room) if seed % 2 else (program.lower, program.upper)
        program = BoxProgram(scale * program.hessian, scale * program.gradient, lower, upper)
        solution = solved(solvers, program)
        if solution.status == 0:
            assert (solution.v >= program.lower).all()
            assert (solution.v <= program.upper).all()
            assert seed % 2 or program.optimality(solution.v) < 1e-10
        answered += solution.status == 0
    assert answered >= 30  # nothing of a refusal stays behind
