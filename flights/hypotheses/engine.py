"""What a log's columns really are: hypotheses about clocks, units, order and axes, by how well physics closes.

Each step sees the streams as the steps before it repaired them, so that a wrong unit hides no wrong order.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from flights.agreement import both, rms
from flights.hypotheses import clocks, pose, scales
from flights.hypotheses.hypothesis import Hypothesis
from flights.hypotheses.motion import Motion
from flights.hypotheses.pose import CLOSES, Reading, Turns
from flights.hypotheses.rotation import FRD, NED, axes_text, fitted, in_words, is_none, is_whole
from flights.log import Stream
from flights.stream_repair import TIME, StreamRepair, apply

_FOLLOWS = 0.6  # correlation of sizes beyond which a unit is compared
_SURELY = 0.95  # the same, and share that closes, for a factor that is no unit's: errors change sizes as well
_MIN_SPEED = 0.15  # m/s rms
_IMPOSSIBLE_SPEED = 150.0  # m/s, faster than any multirotor flies
_MISALIGNED = np.deg2rad(20.0)  # between position and velocity, of which an estimator errs in the latter when slow
_ONE_MOTION = 0.7  # share of a velocity that the position's change explains where they are one motion
_GAIN = 0.1  # of the score, by which another reading must be better than the declared one
Streams = Mapping[str, Stream]


def explain(streams: Sequence[Stream]) -> tuple[Hypothesis, ...]:
    """What the streams are other than declared; empty where they close as they are, or move too little to tell."""
    first: dict[str, Stream] = {}
    for stream in streams:
        first.setdefault(stream.name, stream)
    found: list[Hypothesis] = []
    for step in _STEPS:
        for hypothesis in step(first):
            found.append(hypothesis)
            for repair in hypothesis.repairs:
                concerned = [name for name in first if repair.quantity in (TIME, name)]
                first |= {name: apply(first[name], repair) for name in concerned}
    return tuple(found)


def _gyro_unit(streams: Streams) -> list[Hypothesis]:
    motion = Motion.of(streams)
    if not motion.has("attitude", "rate"):
        return []
    compared = scales.of_lengths(motion.rate, motion.turning(motion.values["attitude"]), pose.MIN_TURNING)
    if compared is None or compared[1] < _FOLLOWS:
        return []
    found = scales.named(compared[0], scales.ANGLES)
    if found is None or not (found[0] or compared[1] > _SURELY):
        return []
    unit, size = found
    what = f"are in {unit}/s" if unit else f"are {size:.3g} times too large"
    text = f"the body rates {what}" + (": a factor that is no unit" if not unit else "")
    evidence = f"{compared[0]:.3g} times the attitude's turning, which they follow by {compared[1]:.2f}"
    name = "rates_in_degrees" if unit == "deg" else "rate_unit"
    return [Hypothesis(name, text, evidence, (StreamRepair("rate", scale=_factor(size)),))]


def _factor(size: float) -> float:
    """The factor that takes a size to 1, to six digits."""
    return float(f"{1 / size:.6g}")


def _force_unit(streams: Streams) -> list[Hypothesis]:
    found = scales.gravity_scale(streams["specific_force"].values) if "specific_force" in streams else None
    if found is None:
        return []
    name = "force_in_g" if found.unit == "g" else "force_unit"
    repair = StreamRepair("specific_force", scale=_factor(1 / found.factor))
    return [Hypothesis(name, f"the specific force is in {found.unit}", f"{found.evidence}, wanted 9.81", (repair,))]


def _axes(streams: Streams) -> list[Hypothesis]:
    motion = Motion.of(streams)
    as_declared, ways = pose.declared(motion), pose.readings(motion)
    if as_declared is None or not ways:
        return []
    gain = _GAIN if not as_declared.assumptions else 0.0
    reading = ways[0] if ways[0].score > as_declared.score + gain else as_declared
    if not reading.closures or max(reading.closures) < CLOSES:
        return []
    lateral = pose.lateral_turn(motion, reading)
    turns = pose.turns_of(reading, lateral)
    repairs = _pose_repairs(reading, turns, streams)
    if not repairs:
        return []
    before = ", ".join(f"{c:.2f}" for c in as_declared.closures)
    after = ", ".join(f"{c:.2f}" for c in reading.closures)
    names = [n for n, fit in (("turning and rates", reading.rate), ("acceleration and force", reading.world)) if fit]
    evidence = f"of {' and '.join(names)} {after} of the motion then agrees"
    if reading is not as_declared:
        evidence += f", as declared {before}"
    return [Hypothesis(_name(reading, turns), _text(reading, turns), evidence, tuple(repairs))]


def _velocity_axes(streams: Streams) -> list[Hypothesis]:
    """A velocity along other axes than the position's change; that of both is wrong which the sensors contradict."""
    motion = Motion.of(streams)
    if not motion.has("position", "velocity"):
        return []
    pair = both(motion.moved, motion.velocity)
    if pair is None or rms(pair[1]) < _MIN_SPEED or rms(pair[0]) == 0.0:
        return []
    fit = fitted(*pair, mirrored=True, snap=_MISALIGNED)
    if not fit.is_turned or fit.closed < _ONE_MOTION:
        return []
    evidence = f"{fit.closed:.2f} of it is then the position's change, {fit.plain:.2f} as declared"
    ways = [("velocity", fit.turn.T), ("position", fit.turn)]
    found = [
        Hypothesis(f"{name}_frame", f"the {name} has {_known_axes(turn.T, name)}", evidence,
                   (StreamRepair(name, **_turn("", turn)),))
        for name, turn in ways
    ]  # fmt: skip
    consistent = [h for h in found if not _axes({**streams, **{r.quantity: apply(streams[r.quantity], r) for r in h.repairs}})]
    return [(consistent or found)[0]]


def _pose_repairs(reading: Reading, turns: Turns, streams: Streams) -> list[StreamRepair]:
    repairs = []
    world, body = _turn("", turns.world), _turn("body_", turns.body)
    if reading.order == "xyzw" or reading.conjugate or world or body:
        order = "xyzw" if reading.order == "xyzw" else ""
        repairs.append(StreamRepair("attitude", order=order, conjugate=reading.conjugate, **world, **body))
    for names, turn in (
        (("position", "velocity", "acceleration"), turns.place),
        (("rate",), turns.gyro),
        (("specific_force",), turns.accelerometer),
    ):
        if not is_none(turn):
            repairs += [StreamRepair(name, **_turn("", turn)) for name in names if name in streams]
    return repairs


def _turn(prefix: str, turn: np.ndarray) -> dict[str, tuple]:
    """The fields of a `StreamRepair` for a turn (3, 3), none where there is no turn."""
    if is_none(turn):
        return {}
    if is_whole(turn):
        return {f"{prefix}axes": tuple(axes_text(turn).split(", "))}
    return {f"{prefix}turn": tuple(tuple(round(float(v), 6) for v in row) for row in turn)}


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
    for name, turn in (("attitude's world", turns.world.T), ("attitude's body", turns.body.T), ("position", turns.place.T)):
        if not is_none(turn):
            parts.append(f"the {name} has {_known_axes(turn, name)}")
    return "; ".join(parts)


def _sensor_words(turn: np.ndarray) -> str:
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


def _known_axes(turn: np.ndarray, name: str) -> str:
    """Axes (3, 3), from ours to the logged ones, by their common names where they have one."""
    up = turn @ np.array([0.0, 0.0, 1.0])
    upward = next((f"{'-' if up[i] < 0 else ''}{'xyz'[i]} up" for i in range(3) if abs(up[i]) > 0.9), "a tilted z")
    if np.linalg.det(turn) < 0:
        return f"left-handed axes, {upward} (x, y, z are {axes_text(turn)})"
    if upward == "-z up":
        return "z down (FRD)" if "body" in name else "z down (NED)"
    return f"axes turned by {in_words(turn.T)}" + ("" if upward == "z up" else f", {upward}")


def _lengths(streams: Streams) -> list[Hypothesis]:
    """Units of velocity and position, by the specific force in the world, by each other, or by what can fly."""
    motion, found = Motion.of(streams), []
    reading = pose.declared(motion)
    against_force = None if reading is None else reading.world
    known = against_force is not None and against_force.closed > CLOSES
    faster = "velocity" if "velocity" in streams else "position" if "position" in streams else None
    if faster is None:
        return []
    one = None if not known or against_force is None else scales.named(against_force.gain, scales.LENGTHS)
    if one is not None and against_force is not None and (one[0] or against_force.closed > _SURELY):
        evidence = f"its acceleration is {against_force.gain:.3g} times what the specific force makes"
        found.append(_length(faster, one, evidence))
    else:
        found += _impossible(motion, faster)
    if faster == "velocity" and "position" in streams:
        repaired = {n: apply(s, r) for n, s in streams.items() for h in found for r in h.repairs if r.quantity == n}
        motion = Motion.of({**streams, **repaired})
        compared = scales.of_lengths(motion.moved, motion.velocity, _MIN_SPEED)
        one = None if compared is None or compared[1] < _FOLLOWS else scales.named(compared[0], scales.LENGTHS)
        if compared is not None and one is not None and (one[0] or compared[1] > _SURELY):
            found.append(_length("position", one, f"it changes by {compared[0]:.3g} times the velocity"))
    return found


def _length(quantity: str, found: tuple[str, float], evidence: str) -> Hypothesis:
    unit, size = found
    per = "/s" if quantity == "velocity" else ""
    text = f"the {quantity} is in {unit}{per}" if unit else f"the {quantity} is {size:.3g} times too large: no unit's factor"
    return Hypothesis(f"{quantity}_unit", text, evidence, (StreamRepair(quantity, scale=_factor(size)),))


def _impossible(motion: Motion, quantity: str) -> list[Hypothesis]:
    speed = np.linalg.norm(motion.velocity if quantity == "velocity" else motion.moved, axis=1)
    speed = speed[np.isfinite(speed)]
    fastest = float(np.percentile(speed, 90)) if len(speed) else 0.0
    if fastest < _IMPOSSIBLE_SPEED:
        return []
    return [_length(quantity, ("mm", 1000.0), f"else the vehicle moves at {fastest:.0f} m/s, which none with rotors does")]


_STEPS: tuple[Callable[[Streams], list[Hypothesis]], ...] = (
    clocks.bursts, clocks.time_unit, clocks.offsets, _gyro_unit, _force_unit, _velocity_axes, _axes, _lengths,
)  # fmt: skip
