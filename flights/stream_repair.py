"""Repairs of a log's streams that a user keeps in a mapping file: unit, order, axes, clock of single quantities.

A repair is what a hypothesis of `flights.hypotheses` proposes; nothing is repaired that the user did not write down or
ask for.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import msgspec
import numpy as np

from dynamics import frames, quaternion
from dynamics.arrays import Floats
from dynamics.errors import DataError, RequestError
from dynamics.spelling import nearest
from flights.log import LogContent, Repair, Stream
from flights.quantities import QUANTITIES

TIME = "time"  # the time of all quantities
_AXES = {"x": (0, 1.0), "y": (1, 1.0), "z": (2, 1.0), "-x": (0, -1.0), "-y": (1, -1.0), "-z": (2, -1.0)}
_ATTITUDE = ("w", "x", "y", "z")
_ORTHOGONAL = 1e-3  # by which the rows of a matrix may miss being unit vectors at right angles
_MIN_FOR_PERIOD = 3  # samples, or bursts
_BURST_STEP = 0.25  # of the mean period, beyond which a step is none within a burst


class StreamRepair(msgspec.Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True):
    """A repair of one quantity, or of the time of all, in the order of its fields.

    quantity: of `flights.quantities`, or "time".
    scale: factor to the quantity's unit; of the time to seconds.
    order: in which the columns of an attitude are, "xyzw" where they were read w first.
    conjugate: an attitude from world to body.
    axes: of a vector, the old axes that the new x, y and z are: ["x", "-z", "y"]; of an attitude those of its world.
    turn: the same as a matrix, three rows.
    body_axes, body_turn: of an attitude, those of its body.
    late: s by which its stamps are late.
    even: stamp the samples evenly: they were stamped in bursts.
    """

    quantity: str
    scale: float = 1.0
    order: str = ""
    conjugate: bool = False
    axes: tuple[str, ...] = ()
    turn: tuple[tuple[float, ...], ...] = ()
    body_axes: tuple[str, ...] = ()
    body_turn: tuple[tuple[float, ...], ...] = ()
    late: float = 0.0
    even: bool = False

    def __post_init__(self) -> None:
        """Refuse what the quantity cannot have."""
        names = (TIME, *QUANTITIES)
        if self.quantity not in names:
            raise RequestError(f"unknown quantity {self.quantity!r}{nearest(self.quantity, names)}.")
        if not (np.isfinite(self.scale) and self.scale != 0.0 and np.isfinite(self.late)):
            raise RequestError(f"{self.quantity}: scale and late must be finite, and scale not 0.")
        if self.quantity == TIME and (self.scale < 0.0 or self.late or self.even):
            raise RequestError(f"{TIME}: give a scale above 0 and no more; late and even are of one quantity.")
        is_attitude = self._parts == _ATTITUDE
        for name in ("order", "conjugate", "body_axes", "body_turn"):
            if getattr(self, name) and not is_attitude:
                raise RequestError(f"{self.quantity} is no attitude: leave {name} out.")
        if is_attitude and self.scale != 1.0:
            raise RequestError(f"{self.quantity} is of unit length: leave scale out.")
        if self.order not in ("", "wxyz", "xyzw"):
            raise RequestError(f"{self.quantity}: order {self.order!r} does not fit; give 'wxyz' or 'xyzw'.")
        if (self.axes or self.turn) and not is_attitude and self._parts != ("x", "y", "z"):
            raise RequestError(f"{self.quantity} is no vector: leave axes and turn out.")
        matrix_of(self.axes, self.turn, self.quantity)
        body = matrix_of(self.body_axes, self.body_turn, self.quantity)
        world = matrix_of(self.axes, self.turn, self.quantity)
        if is_attitude and min(np.linalg.det(body), np.linalg.det(world)) < 0:
            raise RequestError(f"{self.quantity}: its axes must be right-handed; mirror the position instead.")

    @property
    def _parts(self) -> tuple[str, ...] | None:
        return None if self.quantity == TIME else QUANTITIES[self.quantity].parts

    def __str__(self) -> str:
        """The repair as the lines of a mapping file."""
        lines = [f"{name} = {toml_value(value)}" for name, value in msgspec.to_builtins(self).items()]
        return "\n".join(["[[repairs]]", *lines])


def matrix_of(axes: Sequence[str], turn: Sequence[Sequence[float]], quantity: str) -> Floats:
    """(3, 3) the matrix of axes or of a turn, that of no turn where both are empty. Raises RequestError."""
    if axes and turn:
        raise RequestError(f"{quantity}: give axes or a turn, not both.")
    if axes:
        if len(axes) != 3 or {_AXES[a][0] for a in axes if a in _AXES} != {0, 1, 2}:
            raise RequestError(f"{quantity}: axes {list(axes)} are no three axes such as ['x', '-z', 'y'].")
        matrix = np.zeros((3, 3))
        for row, name in enumerate(axes):
            place, sign = _AXES[name]
            matrix[row, place] = sign
        return matrix
    if not turn:
        return np.eye(3)
    matrix = np.array([row if len(row) == 3 else [np.nan] * 3 for row in turn], dtype=float)
    if matrix.shape != (3, 3) or not np.allclose(matrix @ matrix.T, np.eye(3), atol=_ORTHOGONAL):
        raise RequestError(f"{quantity}: turn must be three rows of three, unit vectors at right angles.")
    left, _, right = np.linalg.svd(matrix)
    return np.asarray(left @ right)


def repaired(content: LogContent, repairs: Sequence[StreamRepair]) -> LogContent:
    """The content with its streams repaired, which its own list of repairs says.

    Raises DataError for a repair of a quantity that it does not have.
    """
    streams = list(content.streams)
    for repair in repairs:
        if repair.quantity != TIME and all(stream.name != repair.quantity for stream in streams):
            raise DataError(f"the mapping repairs {repair.quantity}, which is not in this log. Leave that repair out.")
        streams = [apply(s, repair) if repair.quantity in (TIME, s.name) else s for s in streams]
    made = (Repair("mapped_repair", _summary(repair)) for repair in repairs)
    return replace(content, streams=tuple(streams), repairs=(*content.repairs, *made))


def apply(stream: Stream, repair: StreamRepair) -> Stream:
    """A stream, repaired."""
    time, values = stream.time, stream.values
    if repair.quantity == TIME:
        return replace(stream, time=time * repair.scale)
    if stream.quantity.parts == _ATTITUDE:
        values = _attitude(values, repair)
    else:
        values = values * repair.scale
        if repair.axes or repair.turn:
            values = values @ matrix_of(repair.axes, repair.turn, repair.quantity).T
    if repair.even:
        sampled = np.isfinite(values).any(axis=1)
        time, values = evenly(time[sampled]), values[sampled]
    return Stream(stream.name, time - repair.late, values, stream.source)


def _attitude(values: Floats, repair: StreamRepair) -> Floats:
    if repair.order == "xyzw":
        values = frames.quaternion_from_xyzw(values)
    if repair.conjugate:
        values = quaternion.conjugate(values)
    world = quaternion.from_rotation_matrix(matrix_of(repair.axes, repair.turn, repair.quantity))
    body = quaternion.from_rotation_matrix(matrix_of(repair.body_axes, repair.body_turn, repair.quantity))
    values = quaternion.multiply(quaternion.multiply(world, values), quaternion.conjugate(body))
    good = np.flatnonzero(np.isfinite(values).all(axis=1))
    repaired_values = np.full_like(values, np.nan)
    repaired_values[good] = quaternion.continuous(values[good]) if len(good) else values[good]
    return repaired_values


def evenly(time: Floats) -> Floats:
    """(n,) stamps at whole periods, of samples that were stamped in bursts, when they arrived.

    The period is the median time of a burst for each of its samples, then the slope through the last of each burst, so
    that lost samples leave a gap. No sample is stamped before it was taken: the promptest gives the line's height.
    """
    if len(time) < _MIN_FOR_PERIOD:
        return time
    steps = np.diff(time)
    last = np.concatenate([np.flatnonzero(steps > _BURST_STEP * float(steps.mean())), [len(time) - 1]])
    count = np.diff(np.concatenate([[-1], last]))
    if len(last) < _MIN_FOR_PERIOD:
        return np.asarray(np.linspace(time[0], time[-1], len(time)))
    ends = time[last]
    period = float(np.median(np.repeat(np.diff(ends) / count[1:], count[1:])))
    for _ in range(3):  # by then no burst moves to another row
        row = np.round((ends - ends[0]) / period)
        period = float(np.polyfit(row, ends, 1)[0])
    rows = np.repeat(row, count) - (np.repeat(last, count) - np.arange(len(time)))
    rows = np.maximum.accumulate(rows - np.arange(len(time))) + np.arange(len(time))  # no two samples on one row
    return np.asarray(period * rows + float(np.min(time - period * rows)))


def _summary(repair: StreamRepair) -> str:
    parts = [f"{name} {toml_value(value)}" for name, value in msgspec.to_builtins(repair).items() if name != "quantity"]
    return f"{repair.quantity} by the mapping: {', '.join(parts)}"


def toml_value(value: object) -> str:
    """A value as TOML writes it, in one line."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return f'"{value}"'
    if isinstance(value, (list, tuple)):
        return "[" + ", ".join(toml_value(one) for one in value) + "]"
    return f"{value:.10g}"
