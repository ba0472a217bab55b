"""The regression recovers what is planted, with the covariance that least squares promises."""

from dataclasses import replace

import numpy as np
import pytest

from diagnosis.selection.regression import marginal
from diagnosis.selection.sensor_errors import Biases
from tests.diagnosis.synthetic import CHANNELS, candidate, effect, planted, regression


def test_planted_coefficients_come_back_within_their_covariance(arpl_250g):
    truth = [0.3, -0.2, 0.0]
    errors = []
    for seed in range(150):
        of_one = planted(arpl_250g, truth, seed=seed, flights=2, rows=20)
        theta, _ = of_one.solve([0, 1, 2])
        root = np.linalg.cholesky(np.sum(of_one.gram, axis=0))
        errors.append(root.T @ (theta - truth))
    np.testing.assert_allclose(np.mean(errors, axis=0), 0.0, atol=0.25)
    np.testing.assert_allclose(np.cov(np.transpose(errors)), np.eye(3), atol=0.35)


def test_the_gain_is_the_fall_of_the_squared_residual(arpl_250g):
    of_all = planted(arpl_250g, [0.3, -0.2], seed=0)
    theta, gain = of_all.solve([0, 1])
    squares = sum(np.sum(y**2) - np.sum((y - x @ theta) ** 2) for x, y in zip(of_all.columns, of_all.rows, strict=True))
    assert gain == pytest.approx(squares, rel=1e-6)
    assert of_all.solve([]) == (pytest.approx(np.zeros(0)), 0.0)


def test_marginal_equations_are_the_joint_solution_with_the_prior():
    random = np.random.default_rng(2)
    x = random.standard_normal((50, 5))
    y = random.standard_normal(50)
    biases = Biases((1, 4), np.array([3.0, 7.0]))
    gram, product = marginal(x.T @ x, x.T @ y, biases)
    free = [0, 2, 3]
    theta = np.linalg.solve(gram[np.ix_(free, free)], product[free])
    prior = np.diag([0.0, 3.0, 0.0, 0.0, 7.0])
    together = np.linalg.solve(x.T @ x + prior, x.T @ y)
    np.testing.assert_allclose(theta, together[free], rtol=1e-9)


def test_a_flights_own_bias_is_no_other_effect(arpl_250g):
    random = np.random.default_rng(3)
    columns = [random.standard_normal((100, CHANNELS, 2)) for _ in range(3)]
    own = [2.0, -1.0, 0.5]
    rows = [
        x @ np.array([0.4, bias]) + random.standard_normal((100, CHANNELS))
        for x, bias in zip(columns, own, strict=True)
    ]
    candidates = [candidate(effect("a"), 0), candidate(effect("bias"), 1)]
    of_all = regression(arpl_250g, candidates, columns, rows, biases=Biases((1,), np.array([1e-4])))
    theta, _ = of_all.solve([0])
    assert theta[0] == pytest.approx(0.4, abs=0.1)


def test_what_all_flights_share_is_fitted_beside_the_chosen_columns(arpl_250g):
    """A column that is collinear with a shared unknown has the coefficient of a joint least squares with its prior."""
    random = np.random.default_rng(4)
    columns = []
    for _ in range(3):
        x = random.standard_normal((60, CHANNELS, 3))
        x[:, :, 1] += 0.8 * x[:, :, 0]
        columns.append(x)
    rows = [x @ np.array([0.3, 0.5, 0.0]) + random.standard_normal((60, CHANNELS)) for x in columns]
    candidates = [candidate(effect(name), i) for i, name in enumerate("abc")]
    frozen = regression(arpl_250g, candidates, columns, rows)
    of_all = replace(frozen, shared=Biases((1,), np.array([40.0]), np.array([0.2])))
    theta, gain = of_all.solve([0, 2])
    x, y = np.vstack([c.reshape(-1, 3) for c in columns]), np.concatenate([r.ravel() for r in rows])
    prior = np.diag([0.0, 40.0, 0.0])
    together = np.linalg.solve(x.T @ x + prior, x.T @ y + [0.0, 40.0 * 0.2, 0.0])
    np.testing.assert_allclose(theta, together[[0, 2]], rtol=1e-6)

    def cost(values):
        return np.sum((y - x @ values) ** 2) + 40.0 * (values[1] - 0.2) ** 2

    alone = np.array([0.0, (x[:, 1] @ y + 40.0 * 0.2) / (x[:, 1] @ x[:, 1] + 40.0), 0.0])
    assert gain == pytest.approx(cost(alone) - cost(together), rel=1e-6)
    assert abs(frozen.solve([0, 2])[0][0] - 0.3) > 0.3 > 10 * abs(theta[0] - 0.3)
