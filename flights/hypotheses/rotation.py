"""The rotation between two sets of axes that saw the same vectors (Wahba's problem), and its words."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np

from dynamics.arrays import Floats

SNAP = np.deg2rad(10.0)  # from the axes' own directions, within which a turn is an alignment error and no other frame
_BLOCKS = 4  # parts of a flight, each of which must show a turn of any other angle
_EXPLAINED = 0.25  # share of what whole axes leave open that a turn by any other angle must explain
ALIKE = 0.02  # of the motion, by which two turns may differ that it does not tell apart
_SECOND = 0.05  # of the largest singular value: less motion about a second axis leaves the turn about the first open


FRD = np.diag([1.0, -1.0, -1.0])
NED = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
Y_UP = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])  # x, z, -y
USUAL = (np.eye(3), FRD, NED, Y_UP, Y_UP.T)


def _whole_axes(hand: float) -> Floats:
    """(24, 3, 3) all turns of one hand that carry axes into axes."""
    signed = [
        np.array(signs)[:, None] * np.eye(3)[list(order)]
        for order in itertools.permutations(range(3))
        for signs in itertools.product((1.0, -1.0), repeat=3)
    ]
    return np.array([turn for turn in signed if np.linalg.det(turn) * hand > 0])


WHOLE_AXES = {True: _whole_axes(1.0), False: _whole_axes(-1.0)}  # right-handed, left-handed


@dataclass(frozen=True, eq=False)
class Fit:
    """y = gain * turn @ x of vectors seen in two sets of axes.

    turn: (3, 3), orthogonal; with determinant -1 one set of axes is left-handed.
    gain: of size.
    closed: share of y's variance that it explains, 0 to 1.
    plain: the same without any turn.
    """

    turn: Floats
    gain: float
    closed: float
    plain: float

    @property
    def is_turned(self) -> bool:
        """Whether the axes are other ones, rather than a little misaligned."""
        return not np.array_equal(self.turn, np.eye(3))


def fitted(x: Floats, y: Floats, *, mirrored: bool = False, snap: float = SNAP) -> Fit:
    """The turn that carries vectors x (n, 3) into y (n, 3), snapped to whole axes within an angle, rad.

    mirrored: whether it may be left-handed. A turn that the motion leaves open, as that about the only axis of the
    motion, is none. Wahba (1965), solved as Markley (1988) by singular values.
    """
    size_x, size_y = float(np.sum(x**2)), float(np.sum(y**2))
    if size_x == 0.0 or size_y == 0.0:
        return Fit(np.eye(3), 1.0, 0.0, 0.0)
    product = y.T @ x
    plain = float(np.trace(product)) / np.sqrt(size_x * size_y)
    singular = np.linalg.svd(product, compute_uv=False)
    turn = _raw(product, 1.0)
    left_handed = _raw(product, -1.0)
    if mirrored and float(np.sum(left_handed * product)) > (1 + ALIKE) * float(np.sum(turn * product)):
        turn = left_handed
    if singular[1] < _SECOND * singular[0]:
        turn = _shortest_of_one_axis(product)
    turn = (
        snapped(turn, snap)
        if _is_repeated(turn, x, y) and _explains(turn, product, size_x * size_y)
        else _nearest(turn)
    )
    along = float(np.sum(turn * product))
    for usual in USUAL:  # of turns that the motion hardly tells apart the most usual one
        if along > 0.0 and float(np.sum(usual * product)) > np.sqrt(1 - ALIKE) * along:
            turn, along = usual, float(np.sum(usual * product))
            break
    return Fit(turn, along / size_x, max(along, 0.0) ** 2 / (size_x * size_y), max(plain, 0.0) ** 2)


def fitted_with_up(x: Floats, y: Floats, up_x: Floats, up_y: Floats) -> Fit:
    """The turn of vectors x (n, 3) into y (n, 3) that carries one direction (3,) into another as well.

    Of sensors that turn as one, gravity tells what motion about one axis leaves open.
    """
    size_x, size_y = float(np.sum(x**2)), float(np.sum(y**2))
    if size_x == 0.0 or size_y == 0.0:
        return Fit(np.eye(3), 1.0, 0.0, 0.0)
    product = y.T @ x
    turn = snapped(_raw(product + np.sqrt(size_x * size_y) * np.outer(up_y, up_x), 1.0))
    along, plain = float(np.sum(turn * product)), float(np.trace(product))
    size = size_x * size_y
    return Fit(turn, along / size_x, max(along, 0.0) ** 2 / size, max(plain, 0.0) ** 2 / size)


def _shortest_of_one_axis(product: Floats) -> Floats:
    """Of motion along one axis: no turn where its sense agrees, else the smallest one that carries it over."""
    left, _, right = np.linalg.svd(product)
    return shortest_turn(right[0], left[:, 0])


def shortest_turn(start: Floats, end: Floats) -> Floats:
    """(3, 3) the smallest rotation of a unit vector (3,) into another."""
    axis, cosine = np.cross(start, end), float(start @ end)
    if cosine < -1 + 1e-9:
        other = np.eye(3)[int(np.argmin(np.abs(start)))]
        normal = np.cross(start, other)
        normal /= np.linalg.norm(normal)
        return np.asarray(2 * np.outer(normal, normal) - np.eye(3))
    cross = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
    return np.asarray(np.eye(3) + cross + cross @ cross / (1 + cosine))


def snapped(turn: Floats, snap: float = SNAP) -> Floats:
    """The turn (3, 3), or that of whole axes within an angle, rad, of it; of those of one hand."""
    nearest = _nearest(turn)
    return nearest if angle_between(nearest, turn) < snap else np.asarray(turn)


def _nearest(turn: Floats) -> Floats:
    """The whole axes of one hand with a turn (3, 3) that are nearest to it."""
    turns = WHOLE_AXES[bool(np.linalg.det(turn) > 0)]
    return np.array(turns[int(np.argmax(np.einsum("aij,ij->a", turns, turn)))])


def _is_repeated(turn: Floats, x: Floats, y: Floats) -> bool:
    """Whether each part of the flight closes better by a turn than by the nearest whole axes: noise does so in some."""
    nearest = _nearest(turn)
    if angle_between(nearest, turn) < SNAP:
        return True
    moved = np.cumsum(np.sum(x**2, axis=1))  # parts of equal motion: one of hover shows nothing
    edges = np.searchsorted(moved, moved[-1] * np.arange(1, _BLOCKS) / _BLOCKS)
    parts = zip(np.split(x, edges), np.split(y, edges), strict=True)
    return all(float(np.sum((turn - nearest) * (part_y.T @ part_x))) > 0 for part_x, part_y in parts)


def _explains(turn: Floats, product: Floats, size: float) -> bool:
    """Whether a turn explains a good part of what whole axes leave open; a shift in time does a little by chance."""
    closed, nearest = (max(float(np.sum(one * product)), 0.0) ** 2 / size for one in (turn, _nearest(turn)))
    return closed - nearest > _EXPLAINED * (1 - nearest)


def _raw(product: Floats, hand: float) -> Floats:
    left, _, right = np.linalg.svd(product)
    sign = np.sign(np.linalg.det(left) * np.linalg.det(right)) * np.sign(hand)
    return np.asarray(left @ np.diag([1.0, 1.0, sign]) @ right)


def angle_between(one: Floats, other: Floats) -> float:
    """Angle, rad, of the rotation from one turn (3, 3) to another of the same hand."""
    cosine = 0.5 * (float(np.trace(one.T @ other)) - 1.0)
    return float(np.arccos(np.clip(cosine, -1.0, 1.0)))


def axis_angle(turn: Floats) -> tuple[Floats, float]:
    """Axis (3,) and angle, rad, 0 to pi, of a proper rotation (3, 3)."""
    angle = angle_between(np.eye(3), turn)
    if angle > np.pi - 1e-6:
        symmetric = (turn + np.eye(3)) / 2
        axis = symmetric[:, int(np.argmax(np.diag(symmetric)))]
        return np.asarray(axis / np.linalg.norm(axis)), angle
    axis = np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]])
    length = float(np.linalg.norm(axis))
    return (np.array([0.0, 0.0, 1.0]), 0.0) if length == 0.0 else (np.asarray(axis / length), angle)


def in_words(turn: Floats) -> str:
    """A turn for people: "90.0 degrees about z", or the axes where it is mirrored."""
    if np.linalg.det(turn) < 0:
        return f"mirrored (x, y, z are {axes_text(turn)})"
    axis, angle = axis_angle(turn)
    return f"{np.degrees(angle):.1f} degrees about {axis_text(axis)}"


def axis_text(axis: Floats) -> str:
    """An axis (3,) for people: z, -y, or its components."""
    place = int(np.argmax(np.abs(axis)))
    if abs(axis[place]) > np.cos(SNAP):
        return f"{'' if axis[place] > 0 else '-'}{'xyz'[place]}"
    return "(" + ", ".join(f"{part:.2f}" for part in axis) + ")"


def is_whole(turn: Floats) -> bool:
    """Whether a turn carries axes into axes."""
    return bool(np.all((np.abs(turn) < 1e-9) | (np.abs(np.abs(turn) - 1) < 1e-9)))


def axes_text(turn: Floats) -> str:
    """A turn of whole axes as the axes that x, y and z are made of: "x, -z, y"."""
    places = np.argmax(np.abs(turn), axis=1)
    return ", ".join(f"{'-' if turn[i, p] < 0 else ''}{'xyz'[p]}" for i, p in enumerate(places))


def is_none(turn: Floats) -> bool:
    """Whether a turn (3, 3) leaves its axes as they are."""
    return float(np.linalg.det(turn)) > 0 and angle_between(np.eye(3), turn) < 1e-6
