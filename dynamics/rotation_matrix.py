"""Rotation matrices and rotation vectors of many rows (Sola et al., A micro Lie theory, 2018, ex. 4)."""

from __future__ import annotations

import numpy as np

from dynamics.arrays import Floats

SMALL = 1e-8  # rad, below which series replace quotients


def skew(vector: Floats) -> Floats:
    """(..., 3, 3) matrices of the product vector x, of vectors (..., 3)."""
    x, y, z = np.moveaxis(np.asarray(vector, float), -1, 0)
    zero = np.zeros_like(x)
    rows = [np.stack(row, axis=-1) for row in ((zero, -z, y), (z, zero, -x), (-y, x, zero))]
    return np.stack(rows, axis=-2)


def exponential(vector: Floats) -> Floats:
    """(..., 3, 3) rotations of rotation vectors (..., 3), rad."""
    angle = np.linalg.norm(vector, axis=-1)[..., None, None]
    safe = np.maximum(angle, SMALL)
    K = skew(vector)
    sine = np.where(angle < SMALL, 1.0, np.sin(safe) / safe)
    cosine = np.where(angle < SMALL, 0.5, (1 - np.cos(safe)) / safe**2)
    return np.asarray(np.eye(3) + sine * K + cosine * (K @ K))


def logarithm(rotation: Floats) -> Floats:
    """(..., 3) rotation vectors, rad, of rotations (..., 3, 3) by less than half a turn."""
    doubled = np.stack(
        [
            rotation[..., 2, 1] - rotation[..., 1, 2],
            rotation[..., 0, 2] - rotation[..., 2, 0],
            rotation[..., 1, 0] - rotation[..., 0, 1],
        ],
        axis=-1,
    )
    sine = np.linalg.norm(doubled, axis=-1, keepdims=True) / 2
    cosine = (np.trace(rotation, axis1=-2, axis2=-1)[..., None] - 1) / 2
    angle = np.arctan2(sine, cosine)
    return np.asarray(doubled * np.where(sine < SMALL, 0.5, angle / np.maximum(2 * sine, SMALL)))


def orthonormal(rotation: Floats) -> Floats:
    """(..., 3, 3) rotations nearest to matrices that are almost ones, by one step of Newton's."""
    return np.asarray(rotation @ (1.5 * np.eye(3) - 0.5 * np.swapaxes(rotation, -1, -2) @ rotation))
