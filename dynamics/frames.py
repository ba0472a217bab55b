"""From the autopilot's frames to ours and back: NED to ENU in the world, FRD to FLU on the body.

Every map here is its own inverse but for the attitude's sign, which a quaternion leaves free.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from dynamics import quaternion
from dynamics.arrays import Floats

# half turns that carry NED axes into ENU axes (about north-east) and FRD into FLU (about forward)
_ENU_FROM_NED = np.array([0.0, np.sqrt(0.5), np.sqrt(0.5), 0.0])
_FRD_FROM_FLU = np.array([0.0, 1.0, 0.0, 0.0])


def enu_from_ned(vector: ArrayLike) -> Floats:
    """A world vector (..., 3) with north-east-down components as east-north-up, or the other way round."""
    v = np.asarray(vector, dtype=float)
    return np.stack([v[..., 1], v[..., 0], -v[..., 2]], axis=-1)


def flu_from_frd(vector: ArrayLike) -> Floats:
    """A body vector (..., 3) with forward-right-down components as forward-left-up, or the other way round."""
    v = np.asarray(vector, dtype=float)
    return np.stack([v[..., 0], -v[..., 1], -v[..., 2]], axis=-1)


def attitude_enu_flu(attitude_ned_frd: ArrayLike) -> Floats:
    """Attitude FLU-to-ENU of an attitude FRD-to-NED. Both: (..., 4), w first."""
    return attitude_of_flu(attitude_to_enu(attitude_ned_frd))


def attitude_to_enu(attitude_to_ned: ArrayLike) -> Floats:
    """Attitude of any body axes to ENU of the same to NED. Both: (..., 4), w first."""
    return np.asarray(quaternion.multiply(_ENU_FROM_NED, np.asarray(attitude_to_ned, dtype=float)))


def attitude_of_flu(attitude_of_frd: ArrayLike) -> Floats:
    """Attitude of FLU body axes to any world of the same of FRD. Both: (..., 4), w first."""
    return np.asarray(quaternion.multiply(np.asarray(attitude_of_frd, dtype=float), _FRD_FROM_FLU))


def attitude_ned_frd(attitude_enu_flu: ArrayLike) -> Floats:
    """Attitude FRD-to-NED of an attitude FLU-to-ENU. Both: (..., 4), w first."""
    q = quaternion.multiply(quaternion.conjugate(_ENU_FROM_NED), np.asarray(attitude_enu_flu, dtype=float))
    return np.asarray(quaternion.multiply(q, quaternion.conjugate(_FRD_FROM_FLU)))


def quaternion_from_xyzw(attitude: ArrayLike) -> Floats:
    """The w-first order of a quaternion stored x, y, z, w (ROS, Crazyflie). attitude: (..., 4)."""
    return np.roll(np.asarray(attitude, dtype=float), 1, axis=-1)
