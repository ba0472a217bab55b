"""Hamilton quaternions, w first, body to world.

Each formula is defined once, for NumPy arrays (components on the last axis, any leading axes) and CasADi column
vectors alike; torch tensors use the fewer operations of `dynamics.tensor_quaternion`. Functions that only data needs
(Euler angles, sign continuity, matrices to quaternions) are for NumPy alone.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from dynamics import symbolic as ca
from dynamics import tensor_quaternion
from dynamics.arrays import Floats
from dynamics.libraries import Expression, is_symbolic, is_tensor, join, library_of, split

IDENTITY = np.array([1.0, 0.0, 0.0, 0.0])


def multiply(left: Expression, right: Expression) -> Expression:
    """Hamilton product left * right. left, right: (..., 4)."""
    if is_tensor(left):
        return tensor_quaternion.multiply(left, right)
    a, b, c, d = split(left)
    w, x, y, z = split(right)
    return join(
        [
            a * w - b * x - c * y - d * z,
            a * x + b * w + c * z - d * y,
            a * y - b * z + c * w + d * x,
            a * z + b * y - c * x + d * w,
        ]
    )


def conjugate(attitude: Expression) -> Expression:
    """The inverse rotation of a unit quaternion. attitude: (..., 4)."""
    w, x, y, z = split(attitude)
    return join([w, -x, -y, -z])


def rotate(attitude: Expression, vector_body: Expression) -> Expression:
    """A body vector in world axes (the paper's q (.) f). attitude: (..., 4), vector_body: (..., 3)."""
    if is_tensor(attitude):
        return tensor_quaternion.rotate(attitude, vector_body)
    w, x, y, z = split(attitude)
    a, b, c = split(vector_body)
    # v + 2 w (r x v) + 2 r x (r x v), with r the vector part
    s, t, u = 2 * (y * c - z * b), 2 * (z * a - x * c), 2 * (x * b - y * a)
    return join([a + w * s + y * u - z * t, b + w * t + z * s - x * u, c + w * u + x * t - y * s])


def rotate_inverse(attitude: Expression, vector_world: Expression) -> Expression:
    """A world vector in body axes. attitude: (..., 4), vector_world: (..., 3)."""
    return rotate(conjugate(attitude), vector_world)


def small_turn(angle: Expression) -> Expression:
    """(4,) quaternion of a small rotation vector (3,), rad, for CasADi: smooth at zero, off by angle^3 / 12."""
    turn = ca.vertcat(1, angle / 2)
    return turn / ca.sqrt(ca.sumsqr(turn))


def derivative(attitude: Expression, rate_body: Expression) -> Expression:
    """Time derivative of the attitude, 1/2 q * (0, omega) (PI-TCN eq. 1).

    attitude: (..., 4). rate_body: (..., 3) rad/s. Returns (..., 4) 1/s.
    """
    x, y, z = split(rate_body)
    return 0.5 * multiply(attitude, join([0 * x, x, y, z]))


def exponential(rotation_vector: Expression) -> Expression:
    """Quaternion of a rotation vector. rotation_vector: (..., 3) rad, any length, zero included."""
    if is_tensor(rotation_vector):
        return tensor_quaternion.exponential(rotation_vector)
    x, y, z = split(rotation_vector)
    square = x * x + y * y + z * z + 1e-24  # keeps value and derivative finite at zero rotation
    angle = square**0.5
    library = library_of(angle)
    sinc = library.sin(angle / 2) / angle
    return join([library.cos(angle / 2), sinc * x, sinc * y, sinc * z])


def logarithm(attitude: ArrayLike) -> Floats:
    """Rotation vector of the smaller angle, rad. attitude: (..., 4)."""
    q = normalise(attitude)
    q = np.where(q[..., :1] < 0, -q, q)
    sine = np.linalg.norm(q[..., 1:], axis=-1, keepdims=True)
    angle = 2 * np.arctan2(sine, q[..., :1])
    return np.asarray(np.where(sine > 1e-12, angle / np.maximum(sine, 1e-300), 2.0) * q[..., 1:])


def angle_between(first: ArrayLike, second: ArrayLike) -> Floats:
    """Angle of the rotation from one attitude to another, rad in [0, pi]. first, second: (..., 4)."""
    return np.asarray(np.linalg.norm(logarithm(multiply(conjugate(np.asarray(first)), np.asarray(second))), axis=-1))


def normalise(attitude: ArrayLike) -> Floats:
    """Unit quaternions. attitude: (..., 4), none of zero length."""
    q = np.asarray(attitude, dtype=float)
    return np.asarray(q / np.linalg.norm(q, axis=-1, keepdims=True))


def continuous(attitude: ArrayLike) -> Floats:
    """Attitudes with signs chosen so that neighbours never jump. attitude: (n, 4)."""
    q = np.array(attitude, dtype=float)
    flips = np.sum(q[1:] * q[:-1], axis=-1) < 0
    signs = np.concatenate([[1.0], np.cumprod(np.where(flips, -1.0, 1.0))])
    return np.asarray(q * signs[:, None])


def nearest_sign(attitude: Floats, other: Floats) -> Floats:
    """attitude or its negative, whichever lies nearer to other. Both: (4,)."""
    return -attitude if float(attitude @ other) < 0 else attitude


def rotation_matrix(attitude: Expression) -> Expression:
    """Rotation matrix, body to world. attitude: (..., 4). Returns (..., 3, 3), or a CasADi 3 x 3."""
    columns = [rotate(attitude, axis) for axis in np.eye(3)]
    if is_symbolic(attitude):
        return ca.horzcat(*columns)
    return np.stack(columns, axis=-1)


def from_rotation_matrix(matrix: ArrayLike) -> Floats:
    """Quaternion of a rotation matrix, by the numerically largest component. matrix: (..., 3, 3)."""
    m = np.asarray(matrix, dtype=float)
    xx, yy, zz = m[..., 0, 0], m[..., 1, 1], m[..., 2, 2]
    candidates = np.stack(
        [
            np.stack([1 + xx + yy + zz, m[..., 2, 1] - m[..., 1, 2], m[..., 0, 2] - m[..., 2, 0],
                      m[..., 1, 0] - m[..., 0, 1]], -1),
            np.stack([m[..., 2, 1] - m[..., 1, 2], 1 + xx - yy - zz, m[..., 1, 0] + m[..., 0, 1],
                      m[..., 0, 2] + m[..., 2, 0]], -1),
            np.stack([m[..., 0, 2] - m[..., 2, 0], m[..., 1, 0] + m[..., 0, 1], 1 - xx + yy - zz,
                      m[..., 2, 1] + m[..., 1, 2]], -1),
            np.stack([m[..., 1, 0] - m[..., 0, 1], m[..., 0, 2] + m[..., 2, 0], m[..., 2, 1] + m[..., 1, 2],
                      1 - xx - yy + zz], -1),
        ],
        axis=-2,
    )  # fmt: skip
    best = np.argmax(np.diagonal(candidates, axis1=-2, axis2=-1), axis=-1)
    q = np.take_along_axis(candidates, best[..., None, None], axis=-2)[..., 0, :]
    return normalise(np.where(q[..., :1] < 0, -q, q))


def from_euler(roll: ArrayLike, pitch: ArrayLike, yaw: ArrayLike) -> Floats:
    """Attitude of yaw, then pitch, then roll about the moving axes (z-y-x), all rad and broadcastable."""
    half = [np.asarray(angle, dtype=float) / 2 for angle in (roll, pitch, yaw)]
    zero = np.zeros_like(half[0] + half[1] + half[2])
    about_x = join([np.cos(half[0]) + zero, np.sin(half[0]), zero, zero])
    about_y = join([np.cos(half[1]) + zero, zero, np.sin(half[1]), zero])
    about_z = join([np.cos(half[2]) + zero, zero, zero, np.sin(half[2])])
    return np.asarray(multiply(multiply(about_z, about_y), about_x))


def to_euler(attitude: ArrayLike) -> Floats:
    """Roll, pitch and yaw (z-y-x order), rad. attitude: (..., 4). Returns (..., 3)."""
    w, x, y, z = split(np.asarray(attitude, dtype=float))
    roll = np.arctan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))
    pitch = np.arcsin(np.clip(2 * (w * y - z * x), -1.0, 1.0))
    yaw = np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
    return np.stack([roll, pitch, yaw], axis=-1)
