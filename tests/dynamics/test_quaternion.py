"""Quaternions: the algebra, its agreement between NumPy and CasADi, and facts about rotations."""

import casadi as ca
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from numpy.testing import assert_allclose

from dynamics import quaternion

finite = st.floats(-10.0, 10.0)
vectors = hnp.arrays(float, 3, elements=finite)
attitudes = (
    hnp.arrays(float, 4, elements=st.floats(-1.0, 1.0))
    .filter(lambda q: np.linalg.norm(q) > 1e-3)
    .map(quaternion.normalise)
)
angles = st.floats(-3.1, 3.1)


def same_rotation(first, second):
    """Two quaternions that differ at most in sign."""
    assert_allclose(quaternion.rotation_matrix(first), quaternion.rotation_matrix(second), atol=1e-9)


def rodrigues(vector):
    """Rotation matrix of a rotation vector, by Rodrigues' formula."""
    angle = np.linalg.norm(vector)
    if angle < 1e-12:
        return np.eye(3)
    k = np.cross(np.eye(3), vector / angle)
    return np.eye(3) + np.sin(angle) * k + (1 - np.cos(angle)) * k @ k


def test_hamilton_units_multiply_as_hamilton_said():
    one, i, j, k = np.eye(4)
    for left, right, product in [(i, j, k), (j, k, i), (k, i, j), (i, i, -one), (j, j, -one), (k, k, -one)]:
        assert_allclose(quaternion.multiply(left, right), product)


def test_a_quarter_turn_about_z_carries_x_to_y():
    assert_allclose(quaternion.rotate(quaternion.from_euler(0, 0, np.pi / 2), [1, 0, 0]), [0, 1, 0], atol=1e-15)


def test_nose_down_pitch_is_positive_about_the_left_axis():
    forward = quaternion.rotate(quaternion.from_euler(0, 0.1, 0), [1, 0, 0])
    assert forward[2] == pytest.approx(-np.sin(0.1))


@given(attitudes, vectors)
def test_rotation_agrees_with_the_sandwich_product(q, v):
    sandwich = quaternion.multiply(quaternion.multiply(q, np.append(0.0, v)), quaternion.conjugate(q))
    assert_allclose(quaternion.rotate(q, v), sandwich[1:], atol=1e-12)


@given(attitudes, vectors)
def test_rotating_there_and_back_changes_nothing(q, v):
    assert_allclose(quaternion.rotate_inverse(q, quaternion.rotate(q, v)), v, atol=1e-12)


@given(attitudes, attitudes, vectors)
def test_a_product_rotates_by_the_right_factor_first(first, second, v):
    both = quaternion.rotate(quaternion.multiply(first, second), v)
    assert_allclose(both, quaternion.rotate(first, quaternion.rotate(second, v)), atol=1e-12)


@given(attitudes)
def test_rotation_matrix_is_a_proper_rotation(q):
    matrix = quaternion.rotation_matrix(q)
    assert_allclose(matrix @ matrix.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(matrix) == pytest.approx(1.0)


@given(attitudes)
def test_rotation_matrix_round_trip(q):
    same_rotation(quaternion.from_rotation_matrix(quaternion.rotation_matrix(q)), q)


@pytest.mark.parametrize("axis", np.eye(3))
def test_half_turns_survive_the_rotation_matrix(axis):
    same_rotation(quaternion.from_rotation_matrix(2 * np.outer(axis, axis) - np.eye(3)), np.append(0.0, axis))


@given(vectors)
def test_exponential_is_rodrigues_formula(v):
    assert_allclose(quaternion.rotation_matrix(quaternion.exponential(v)), rodrigues(v), atol=1e-10)


@given(attitudes)
def test_exponential_undoes_logarithm(q):
    same_rotation(quaternion.exponential(quaternion.logarithm(q)), q)


@given(vectors.map(lambda v: v * 0.17))
def test_logarithm_undoes_exponential_below_half_a_turn(v):
    assert_allclose(quaternion.logarithm(quaternion.exponential(v)), v, atol=1e-9)


@given(attitudes)
def test_logarithm_takes_the_shorter_way_whatever_the_sign(q):
    assert_allclose(quaternion.angle_between(q, -q), 0.0, atol=1e-7)
    assert np.linalg.norm(quaternion.logarithm(q)) <= np.pi + 1e-12


def test_exponential_has_a_finite_derivative_at_zero_rotation():
    v = ca.SX.sym("v", 3)
    jacobian = ca.Function("jacobian", [v], [ca.jacobian(quaternion.exponential(v), v)])
    assert_allclose(np.array(jacobian(np.zeros(3))), np.vstack([np.zeros(3), 0.5 * np.eye(3)]), atol=1e-9)


@given(angles, st.floats(-1.5, 1.5), angles)
def test_euler_round_trip(roll, pitch, yaw):
    assert_allclose(quaternion.to_euler(quaternion.from_euler(roll, pitch, yaw)), [roll, pitch, yaw], atol=1e-6)


@given(angles, angles, angles)
def test_euler_is_yaw_then_pitch_then_roll_about_moving_axes(roll, pitch, yaw):
    matrix = rodrigues(np.array([0, 0, yaw])) @ rodrigues(np.array([0, pitch, 0])) @ rodrigues(np.array([roll, 0, 0]))
    assert_allclose(quaternion.rotation_matrix(quaternion.from_euler(roll, pitch, yaw)), matrix, atol=1e-12)


@given(attitudes, vectors)
def test_derivative_is_the_slope_of_the_motion(q, rate):
    h = 1e-6
    after, before = (quaternion.multiply(q, quaternion.exponential(sign * h * rate)) for sign in (1, -1))
    assert_allclose(quaternion.derivative(q, rate), (after - before) / (2 * h), atol=1e-6)


@given(hnp.arrays(bool, 50), st.integers(0, 2**32 - 1))
def test_continuous_undoes_any_pattern_of_sign_flips(flips, seed):
    steps = quaternion.exponential(np.random.default_rng(seed).normal(scale=0.3, size=(50, 3)))
    path = [steps[0]]
    for step in steps[1:]:
        path.append(quaternion.multiply(path[-1], step))
    flipped = np.where(flips[:, None], -1.0, 1.0) * np.array(path)
    smooth = quaternion.continuous(flipped)
    assert np.all(np.sum(smooth[1:] * smooth[:-1], axis=1) >= 0)
    assert_allclose(smooth, np.sign(smooth[0] @ path[0]) * np.array(path))


@given(attitudes, attitudes)
def test_nearest_sign_is_the_nearer_of_the_two(q, other):
    chosen = quaternion.nearest_sign(q, other)
    assert np.linalg.norm(chosen - other) <= np.linalg.norm(-chosen - other) + 1e-12


@given(attitudes, attitudes, vectors)
def test_casadi_and_numpy_agree(q, r, v):
    pairs = [
        (quaternion.multiply, (q, r)),
        (quaternion.conjugate, (q,)),
        (quaternion.rotate, (q, v)),
        (quaternion.rotate_inverse, (q, v)),
        (quaternion.derivative, (q, v)),
        (quaternion.exponential, (v,)),
        (quaternion.rotation_matrix, (q,)),
    ]
    for function, arguments in pairs:
        symbolic = np.array(function(*map(ca.DM, arguments))).squeeze()
        assert_allclose(symbolic, function(*arguments), atol=1e-14)


def test_leading_axes_are_carried_through():
    q = quaternion.normalise(np.random.default_rng(0).normal(size=(5, 7, 4)))
    v = np.random.default_rng(1).normal(size=(5, 7, 3))
    assert_allclose(quaternion.rotate(q, v)[3, 2], quaternion.rotate(q[3, 2], v[3, 2]))
    assert quaternion.rotation_matrix(q).shape == (5, 7, 3, 3)
    same_rotation(quaternion.from_rotation_matrix(quaternion.rotation_matrix(q)), q)
