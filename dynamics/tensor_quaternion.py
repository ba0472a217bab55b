"""Hamilton quaternions of torch tensors in few operations, each of which costs training time forward and backward.

`dynamics.quaternion` calls these for tensors; a test compares them with its own formulas.
"""

from __future__ import annotations

import sys

from dynamics.libraries import Expression


def multiply(left: Expression, right: Expression) -> Expression:
    """Hamilton product. left, right: (..., 4)."""
    torch = sys.modules["torch"]
    w, a, other_w, b = left[..., :1], left[..., 1:], right[..., :1], right[..., 1:]
    scalar = w * other_w - (a * b).sum(-1, keepdim=True)
    return torch.cat([scalar, w * b + other_w * a + torch.linalg.cross(a, b)], -1)


def rotate(attitude: Expression, vector: Expression) -> Expression:
    """A body vector in world axes. attitude: (..., 4), vector: (..., 3), which may be an array."""
    torch = sys.modules["torch"]
    w, r = attitude[..., :1], attitude[..., 1:]
    vector = torch.as_tensor(vector, dtype=attitude.dtype, device=attitude.device).expand(r.shape)
    twice = 2 * torch.linalg.cross(r, vector)
    return vector + w * twice + torch.linalg.cross(r, twice)


def exponential(rotation_vector: Expression) -> Expression:
    """Quaternion of a rotation vector (..., 3)."""
    torch = sys.modules["torch"]
    angle = (rotation_vector.square().sum(-1, keepdim=True) + 1e-24).sqrt()  # its derivative is finite at zero
    return torch.cat([torch.cos(angle / 2), torch.sin(angle / 2) / angle * rotation_vector], -1)
