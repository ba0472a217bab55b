"""The maps of `dynamics.frames` made fast for the many small vectors that the wire needs in every pass.

All four maps are linear, so their images of the unit vectors define them: a small matrix for attitudes, and for
vectors an order and signs, so that a NaN component (on the wire: not controlled) affects no other.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from dynamics import frames
from dynamics.arrays import Floats

_WORLD = frames.enu_from_ned(np.eye(3)).T
_WORLD_ORDER, _WORLD_SIGN = np.abs(_WORLD).argmax(axis=1), _WORLD.sum(axis=1)
_BODY_SIGN = np.diag(frames.flu_from_frd(np.eye(3)))
_ATTITUDE_OUT = frames.attitude_ned_frd(np.eye(4)).T
_ATTITUDE_IN = frames.attitude_enu_flu(np.eye(4)).T


def enu_from_ned(vector: ArrayLike) -> Floats:
    """A world vector (3,) with north-east-down components as east-north-up, or the other way round."""
    return np.asarray(np.asarray(vector, dtype=float)[_WORLD_ORDER] * _WORLD_SIGN)


def flu_from_frd(vector: ArrayLike) -> Floats:
    """A body vector (3,) with forward-right-down components as forward-left-up, or the other way round."""
    return np.asarray(np.asarray(vector, dtype=float) * _BODY_SIGN)


def attitude_enu_flu(attitude_ned_frd: ArrayLike) -> Floats:
    """Attitude FLU-to-ENU of an attitude FRD-to-NED. Both: (4,), w first."""
    return np.asarray(_ATTITUDE_IN @ np.asarray(attitude_ned_frd, dtype=float))


def attitude_ned_frd(attitude_enu_flu: ArrayLike) -> Floats:
    """Attitude FRD-to-NED of an attitude FLU-to-ENU. Both: (4,), w first."""
    return np.asarray(_ATTITUDE_OUT @ np.asarray(attitude_enu_flu, dtype=float))
