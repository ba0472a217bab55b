"""The maps of `dynamics.frames` as matrices, for the many small vectors that the wire needs in every pass.

All four maps are linear, so their images of the unit vectors say everything, and one small matrix product costs a
tenth of the general functions.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dynamics import frames

_WORLD = frames.enu_from_ned(np.eye(3)).T
_BODY = frames.flu_from_frd(np.eye(3)).T
_ATTITUDE_OUT = frames.attitude_ned_frd(np.eye(4)).T
_ATTITUDE_IN = frames.attitude_enu_flu(np.eye(4)).T

Vector = NDArray[np.float64]


def enu_from_ned(vector: ArrayLike) -> Vector:
    """A world vector (3,) with north-east-down components as east-north-up, or the other way round."""
    return np.asarray(_WORLD @ np.asarray(vector, dtype=float))


def flu_from_frd(vector: ArrayLike) -> Vector:
    """A body vector (3,) with forward-right-down components as forward-left-up, or the other way round."""
    return np.asarray(_BODY @ np.asarray(vector, dtype=float))


def attitude_enu_flu(attitude_ned_frd: ArrayLike) -> Vector:
    """Attitude FLU-to-ENU of an attitude FRD-to-NED. Both: (4,), w first."""
    return np.asarray(_ATTITUDE_IN @ np.asarray(attitude_ned_frd, dtype=float))


def attitude_ned_frd(attitude_enu_flu: ArrayLike) -> Vector:
    """Attitude FRD-to-NED of an attitude FLU-to-ENU. Both: (4,), w first."""
    return np.asarray(_ATTITUDE_OUT @ np.asarray(attitude_enu_flu, dtype=float))
