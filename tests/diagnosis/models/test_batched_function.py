"""Functions over rows give what CasADi gives one row at a time."""

import casadi as ca
import numpy as np
import pytest

from diagnosis.models.batched_function import BINARY, BLOCK, CHAINED_BLOCK, UNARY, Recurrence, RowFunction

OPERATIONS = {
    "arithmetic": lambda x, y: ca.vertcat(x + y, x - y, x * y, x / y, -x, 2 * x, x**2, x**3, x**y, 1 / x),
    "roots": lambda x, y: ca.vertcat(ca.sqrt(x), ca.exp(x), ca.expm1(x), ca.log(x), ca.log1p(x), ca.hypot(x, y)),
    "angles": lambda x, y: ca.vertcat(ca.sin(x), ca.cos(x), ca.tan(x), ca.asin(x), ca.acos(x), ca.atan(x)),
    "hyperbolic": lambda x, y: ca.vertcat(
        ca.sinh(x), ca.cosh(x), ca.tanh(x), ca.asinh(x), ca.acosh(1 + x), ca.atanh(x)
    ),
    "steps": lambda x, y: ca.vertcat(ca.floor(3 * x), ca.ceil(3 * x), ca.fabs(-x), ca.sign(y - 1), ca.copysign(x, -y)),
    "pairs": lambda x, y: ca.vertcat(ca.fmin(x, y), ca.fmax(x, y), ca.fmod(y, x), ca.remainder(y, x), ca.atan2(x, y)),
    "logic": lambda x, y: ca.vertcat(x < y, x <= y, x == y, x != y, ca.logic_and(x, y), ca.logic_or(x, y)),
    "choices": lambda x, y: ca.vertcat(ca.if_else(y > 1, ca.sqrt(y - 1), x), ca.if_else(x < 0.5, x, y), ca.erf(x)),
    "constants": lambda x, y: ca.vertcat(0, 1.5, ca.logic_not(x), x),
}


@pytest.mark.parametrize("name", OPERATIONS)
def test_every_operation_is_casadis_own(name):
    x, y = ca.SX.sym("x", 2), ca.SX.sym("y")
    function = ca.Function("f", [x, y], [ca.densify(OPERATIONS[name](x[0] + 0.0 * x[1], y))])
    random = np.random.default_rng(1)
    rows, shared = random.uniform(0.05, 0.95, (BLOCK + 40, 2)), random.uniform(0.2, 2.0, (BLOCK + 40, 1))
    expected = np.array([np.array(function(a, b)).ravel() for a, b in zip(rows, shared, strict=True)])
    np.testing.assert_allclose(RowFunction(function)(rows, shared), expected, rtol=1e-13, atol=1e-14)


def test_what_is_shared_is_computed_once_and_results_that_depend_on_nothing_else_are_the_same_for_all_rows():
    x, p = ca.SX.sym("x", 3), ca.SX.sym("p", 2)
    function = ca.Function("f", [x, p], [ca.vertcat(ca.sin(p[0]) * x[1], ca.exp(p[1]), x[2] - x[0])])
    rows, p0 = np.arange(12.0).reshape(4, 3), np.array([0.3, -0.2])
    by_row = RowFunction(function, shared=(1,))(rows, p0)
    np.testing.assert_allclose(by_row, [[np.sin(0.3) * r[1], np.exp(-0.2), r[2] - r[0]] for r in rows], rtol=1e-14)


def test_a_call_that_is_not_inlined_is_evaluated_by_casadis_map():
    """A user's effect may call any function of CasADi's, which has no counterpart in NumPy."""
    assert ca.OP_CALL not in {**UNARY, **BINARY}
    x, y, p = ca.SX.sym("x", 2), ca.SX.sym("y"), ca.SX.sym("p", 2)
    inner = ca.Function("inner", [y], [ca.sin(y)], {"never_inline": True})
    function = ca.Function("f", [x, y, p], [ca.vertcat(inner(x[0]) * p[1], p[0], x[1] - y)])
    rows, more, shared = np.random.default_rng(3).uniform(0, 1, (7, 2)), np.arange(7.0)[:, None], np.array([0.3, -0.2])
    expected = [[-0.2 * np.sin(a), 0.3, b - c] for (a, b), (c,) in zip(rows, more, strict=True)]
    for count in (7, 1):
        by_row = RowFunction(function, shared=(2,))(rows[:count], more[:count], shared)
        np.testing.assert_allclose(by_row, expected[:count], rtol=1e-14)


@pytest.mark.parametrize("kind", ["constant factors", "factors that change", "not linear"])
def test_a_recurrence_follows_one_row_after_the_other(kind):
    h, u, p = ca.SX.sym("h", 2), ca.SX.sym("u", 2), ca.SX.sym("p")
    factor = {"constant factors": ca.exp(-p), "factors that change": ca.exp(-p * u[0]), "not linear": ca.sin(h[1])}
    following = ca.vertcat(factor[kind] * h[0] + u[0], 0.5 * h[1] + p * u[1])
    function = ca.Function("f", [h, u, p], [following])
    rows, p0, now = (
        np.random.default_rng(2).uniform(0, 1, (2 * CHAINED_BLOCK + 9, 2)),
        np.array([0.7]),
        np.array([1.0, 2.0]),
    )
    states = Recurrence(function, shared=(2,))(now, rows, p0)
    for row, state in zip(rows, states, strict=True):
        now = np.array(function(now, row, p0)).ravel()
        np.testing.assert_allclose(state, now, rtol=1e-10)
