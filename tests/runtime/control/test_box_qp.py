"""The box-constrained quadratic program of every RTI step, against HPIPM and against its optimality conditions."""

import numpy as np
import pytest

from fixtures.box_programs import BoxProgram, BoxSolvers, Solution
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
