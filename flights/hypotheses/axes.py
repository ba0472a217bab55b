"""Hypotheses about axes: order and sense of an attitude, frames of pose and sensors, of a velocity and its position."""

from __future__ import annotations

import numpy as np

from dynamics.arrays import Floats
from flights.agreement import both, rms
from flights.hypotheses import pose
from flights.hypotheses.hypothesis import Hypothesis, Streams, after, better_than, is_better
from flights.hypotheses.motion import MIN_SPEED, Motion
from flights.hypotheses.pose import CLOSES, Reading, Turns
from flights.hypotheses.rotation import FRD, NED, axes_text, fitted, in_words, is_none, is_whole
from flights.stream_repair import StreamRepair

_MISALIGNED = np.deg2rad(20.0)  # between position and velocity, of which an estimator errs in the latter when slow
_ONE_MOTION = 0.7  # share of a velocity that the position's change explains where they are one motion


def of_pose(streams: Streams, motion: Motion) -> list[Hypothesis]:
    """How pose and sensors lie, where that is other than declared."""
    as_declared = pose.declared(motion)
    if as_declared is None:
        return []
    required = as_declared.score if as_declared.assumptions else better_than(as_declared.score)
    reading = as_declared
    if required < 1.0:  # none scores more
        others = pose.others(motion)
        reading = next((one for one in others if one.score > required), as_declared)
    if not reading.closures or max(reading.closures) < CLOSES:
        return []
    lateral = pose.lateral_turn(motion, reading)
    turns = pose.turns_of(reading, None if lateral is None else lateral.turn)
    repairs = _pose_repairs(reading, turns, streams)
    if not repairs:
        return []
    as_logged = pose.untouched(motion, as_declared)
    pairs = [
        (name, getattr(reading, part), getattr(as_logged, part))
        for name, part in (("turning and rates", "rate"), ("acceleration and force", "world"))
    ]
    closes = [
        f"{fit.closed:.2f} of {name} agrees then, {0.0 if plain is None else plain.plain:.2f} as declared"
        for name, fit, plain in pairs
        if fit is not None
    ]
    if lateral is not None:
        closes.append(
            f"lateral force follows what the motion needs by {lateral.agreed:.2f} then, {lateral.declared:.2f} before"
        )
    evidence = "; ".join(closes)
    return [Hypothesis(_name(reading, turns), _text(reading, turns), evidence, tuple(repairs))]


def of_velocity(streams: Streams, motion: Motion) -> list[Hypothesis]:
    """A velocity along other axes than the position's change; that of both is wrong which the sensors contradict."""
    if not motion.has("position", "velocity"):
        return []
    pair = both(motion.moved, motion.velocity)
    if pair is None or rms(pair[1]) < MIN_SPEED or rms(pair[0]) == 0.0:
        return []
    fit = fitted(*pair, mirrored=True, snap=_MISALIGNED)
    if not fit.is_turned or fit.closed < _ONE_MOTION or not is_better(fit.closed, fit.plain):
        return []
    evidence = f"{fit.closed:.2f} of it is then the position's change, {fit.plain:.2f} as declared"
    ways = [("velocity", fit.turn.T), ("position", fit.turn)]
    hypotheses = [
        Hypothesis(f"{name}_frame", f"the {name} has {_known_axes(turn.T, name)}", evidence, (_turned(name, turn),))
        for name, turn in ways
    ]
    consistent = (one for one in hypotheses if _is_consistent(after(streams, one)))
    return [next(consistent, hypotheses[0])]


def _is_consistent(streams: Streams) -> bool:
    """Whether pose and sensors lie as declared."""
    return not of_pose(streams, Motion.of(streams))


def _pose_repairs(reading: Reading, turns: Turns, streams: Streams) -> list[StreamRepair]:
    repairs = []
    order = "xyzw" if reading.order == "xyzw" else ""
    if order or reading.conjugate or not (is_none(turns.world) and is_none(turns.body)):
        (axes, rows), (body_axes, body_rows) = _fields(turns.world), _fields(turns.body)
        repair = StreamRepair(
            "attitude", order=order, conjugate=reading.conjugate, axes=axes, turn=rows, body_axes=body_axes,
            body_turn=body_rows,
        )  # fmt: skip
        repairs.append(repair)
    for names, turn in (
        (("position", "velocity", "acceleration"), turns.place),
        (("rate",), turns.gyro),
        (("specific_force",), turns.accelerometer),
    ):
        if not is_none(turn):
            repairs += [_turned(name, turn) for name in names if name in streams]
    return repairs


def _turned(quantity: str, turn: Floats) -> StreamRepair:
    """The repair of a vector that is turned. turn: (3, 3)."""
    axes, rows = _fields(turn)
    return StreamRepair(quantity, axes=axes, turn=rows)


def _fields(turn: Floats) -> tuple[tuple[str, ...], tuple[tuple[float, ...], ...]]:
    """Axes, or the rows of a matrix where they are not whole ones, as of a `StreamRepair`; neither for no turn."""
    if is_none(turn):
        return (), ()
    if is_whole(turn):
        return tuple(axes_text(turn).split(", ")), ()
    return (), tuple(tuple(round(float(value), 6) for value in row) for row in turn)


def _name(reading: Reading, turns: Turns) -> str:
    if _is_upside_down(turns):
        return "frames_upside_down"
    if reading.order == "xyzw":
        return "quaternion_order"
    if reading.conjugate:
        return "attitude_conjugate"
    if is_none(turns.gyro) and not is_none(turns.accelerometer):
        return "force_frame"
    if not is_none(turns.gyro):
        return "rate_frame"
    return "attitude_frame" if not is_none(turns.world) or not is_none(turns.body) else "position_frame"


def _text(reading: Reading, turns: Turns) -> str:
    if _is_upside_down(turns):
        return "these are NED and FRD axes: z points down in the pose and on the IMU"
    parts = []
    if reading.order == "xyzw":
        parts.append("the attitude's quaternion is x, y, z, w")
    if reading.conjugate:
        parts.append("the attitude is from world to body, the conjugate")
    gyro, force = turns.gyro, turns.accelerometer
    if not is_none(turns.gyro) and not is_none(turns.accelerometer) and np.allclose(gyro, force):
        parts.append(f"the IMU {_sensor_words(gyro)}")
    else:
        for name, turn in (("gyro", gyro), ("accelerometer", force)):
            if not is_none(turn):
                parts.append(f"the {name} {_sensor_words(turn)}")
    of_pose = {"attitude's world": turns.world, "attitude's body": turns.body, "position": turns.place}
    parts += [f"the {name} has {_known_axes(turn.T, name)}" for name, turn in of_pose.items() if not is_none(turn)]
    return "; ".join(parts)


def _sensor_words(turn: Floats) -> str:
    """How a sensor's axes lie. turn: (3, 3) from them to the body's."""
    if np.array_equal(turn, FRD):
        return "is in FRD axes, beside an attitude of FLU axes"
    if np.linalg.det(turn) < 0:
        return f"has left-handed axes (x, y, z of the body are its {axes_text(turn)})"
    return f"is turned by {in_words(turn)} against the attitude"


def _is_upside_down(turns: Turns) -> bool:
    """Whether everything is in the autopilot's axes."""
    pairs = ((turns.world, NED), (turns.place, NED), (turns.body, FRD), (turns.gyro, FRD))
    return all(np.array_equal(turn, axes) for turn, axes in pairs)


def _known_axes(turn: Floats, name: str) -> str:
    """Axes (3, 3), from ours to the logged ones, by their common names where they have one."""
    up = turn @ np.array([0.0, 0.0, 1.0])
    upward = next((f"{'-' if up[i] < 0 else ''}{'xyz'[i]} up" for i in range(3) if abs(up[i]) > 0.9), "a tilted z")
    if np.linalg.det(turn) < 0:
        return f"left-handed axes, {upward} (x, y, z are {axes_text(turn)})"
    if upward == "-z up":
        return "z down (FRD)" if "body" in name else "z down (NED)"
    return f"axes turned by {in_words(turn.T)}" + ("" if upward == "z up" else f", {upward}")
