"""ODOMETRY from its payload, and its 13 numbers in our frames."""

from __future__ import annotations

import struct

import msgspec
import numpy as np

from dynamics import frames
from dynamics.state import ATTITUDE, POSITION, RATE, RIGID_BODY_STATES, VELOCITY

# layout of ODOMETRY's 13 numbers
WIRE_POSITION, WIRE_ATTITUDE, WIRE_VELOCITY, WIRE_RATE = slice(0, 3), slice(3, 7), slice(7, 10), slice(10, 13)


def _rows_from_wire() -> list[tuple[int, float, int, float]]:
    """Each of our 13 state numbers as a sum of two of ODOMETRY's: index, factor, index, factor.

    The wire has position and attitude NED, velocity NED and rate FRD. Plain numbers, because one NumPy call on a
    processor that has just woken up takes as long as all the checks of an estimate.
    """
    matrix = np.zeros((RIGID_BODY_STATES, RIGID_BODY_STATES))
    matrix[POSITION, WIRE_POSITION] = frames.enu_from_ned(np.eye(3)).T
    matrix[ATTITUDE, WIRE_ATTITUDE] = frames.attitude_enu_flu(np.eye(4)).T
    matrix[VELOCITY, WIRE_VELOCITY] = frames.enu_from_ned(np.eye(3)).T
    matrix[RATE, WIRE_RATE] = frames.flu_from_frd(np.eye(3)).T
    rows = []
    for row in matrix:
        first, second = np.argsort(-np.abs(row), kind="stable")[:2].tolist()
        rows.append((first, float(row[first]), second, float(row[second])))
    return rows


ROWS = _rows_from_wire()
# time_usec; x, y, z, q, vx, vy, vz, body rates; covariances skipped; frame_id, child_frame_id, reset_counter
_ODOMETRY = struct.Struct("<Q13f168x3B")


class Odometry(msgspec.Struct, frozen=True, gc=False):
    """The fields of ODOMETRY that are used. time: the vehicle's, s. wire: 13 numbers as they are sent."""

    time: float
    wire: tuple[float, ...]
    frame_id: int
    child_frame_id: int
    reset_counter: int


def read_odometry(payload: bytes) -> Odometry:
    """ODOMETRY from its payload without the covariances, in a third of the time of decoding it all."""
    fields = _ODOMETRY.unpack_from(payload.ljust(_ODOMETRY.size, b"\0"))
    return Odometry(fields[0] * 1e-6, fields[1:14], *fields[14:17])


def state_from_wire(wire: tuple[float, ...]) -> list[float]:
    """Our state from ODOMETRY's 13 numbers, whose velocity is taken for NED."""
    return [factor * wire[first] + other * wire[second] for first, factor, second, other in ROWS]
