"""Hypotheses about what a log's columns really are: clocks, units, order and axes, by how well physics closes.

Each step sees the streams as the steps before it repaired them, so that a wrong unit hides no wrong order.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from dynamics.vehicle import GRAVITY
from flights import plausibility
from flights.hypotheses import axes, clocks, pose, scales
from flights.hypotheses.hypothesis import Hypothesis, Streams, after
from flights.hypotheses.motion import MIN_ROWS, MIN_SPEED, Motion
from flights.hypotheses.pose import CLOSES
from flights.log import Stream
from flights.stream_repair import StreamRepair

_FAR, _FAR_FOLLOWS = 8.0, 0.1  # ratio beyond which no error makes it, and the correlation that it needs
_FOLLOWS = 0.6  # correlation of sizes beyond which a unit is compared
_SURELY = 0.95  # the same, and share that closes, for a factor that is no unit's: errors change sizes as well
_IMPOSSIBLE_SPEED = 150.0  # m/s, faster than any multirotor flies


def explain(streams: Sequence[Stream]) -> tuple[Hypothesis, ...]:
    """Hypotheses about the streams; empty where they close as declared, or move too little to tell.

    After them, without repairs, the contradictions that no hypothesis repairs.
    """
    first: dict[str, Stream] = {}
    for stream in streams:
        first.setdefault(stream.name, stream)
    hypotheses: list[Hypothesis] = []
    in_the_world = plausibility.force_in_the_world(list(first.values()))
    if in_the_world is not None:
        hypotheses.append(Hypothesis(in_the_world.name, in_the_world.text, "", ()))
        del first["specific_force"]
    for clock_step in (clocks.bursts, clocks.time_unit, clocks.offsets):
        for hypothesis in clock_step(first):
            hypotheses.append(hypothesis)
            first = after(first, hypothesis)
    motion = Motion.of(first)
    for step in _STEPS:
        steps = step(first, motion)
        for hypothesis in steps:
            hypotheses.append(hypothesis)
            first = after(first, hypothesis)
        motion = Motion.of(first) if steps else motion
    rest = plausibility.check(list(first.values()))
    return (*hypotheses, *(Hypothesis(one.name, one.text, "", ()) for one in rest))


def _gyro_unit(_: Streams, motion: Motion) -> list[Hypothesis]:
    if not motion.has("attitude", "rate"):
        return []
    compared = scales.of_lengths(motion.rate, motion.turning(motion.values["attitude"]), pose.MIN_TURNING)
    if compared is None or not _is_clear(*compared):
        return []
    scale = scales.named(compared[0], scales.ANGLES)
    if scale is None or not (scale[0] or compared[1] > _SURELY):
        return []
    unit, size = scale
    what = f"are in {unit}/s" if unit else f"are {size:.3g} times too large"
    text = f"the body rates {what}" + (": a factor that is no unit" if not unit else "")
    evidence = f"{compared[0]:.3g} times the attitude's turning, which they follow by {compared[1]:.2f}"
    name = "rates_in_degrees" if unit == "deg" else "rate_unit"
    return [Hypothesis(name, text, evidence, (StreamRepair("rate", scale=_factor(size)),))]


def _factor(size: float) -> float:
    """The factor that takes a size to 1, to six digits."""
    return float(f"{1 / size:.6g}")


def _force_unit(streams: Streams, _: Motion) -> list[Hypothesis]:
    usual = scales.usual_force(streams["specific_force"].values) if "specific_force" in streams else np.nan
    scale = scales.named(usual / GRAVITY, scales.FORCES, scales.NEAR_GRAVITY)
    if scale is None or not scale[0]:
        return []
    unit, size = scale
    evidence = f"its usual size in flight is {usual:.4g}, wanted {GRAVITY}"
    repair = StreamRepair("specific_force", scale=_factor(size))
    name = "force_in_g" if unit == "g" else "force_unit"
    return [Hypothesis(name, f"the specific force is in {unit}", evidence, (repair,))]


def _lengths(streams: Streams, motion: Motion) -> list[Hypothesis]:
    """Units of velocity and position, by the specific force in the world, by each other, or by what can fly."""
    hypotheses: list[Hypothesis] = []
    reading = pose.declared(motion)
    against_force = None if reading is None else reading.world
    is_compared = against_force is not None and against_force.closed > CLOSES
    faster = "velocity" if "velocity" in streams else "position" if "position" in streams else None
    if faster is None:
        return []
    one = None if not is_compared or against_force is None else scales.named(against_force.gain, scales.LENGTHS)
    if one is not None and against_force is not None and (one[0] or against_force.closed > _SURELY):
        evidence = f"its acceleration is {against_force.gain:.3g} times what the specific force makes"
        hypotheses.append(_length(faster, one, evidence))
    else:
        hypotheses += _impossible(motion, faster)
    if faster == "velocity" and "position" in streams:
        hypotheses += _against_velocity(Motion.of(after(streams, hypotheses[0])) if hypotheses else motion)
    return hypotheses


def _against_velocity(motion: Motion) -> list[Hypothesis]:
    """Units of position and velocity by each other: which of both is in a unit that people use."""
    compared = scales.of_lengths(motion.moved, motion.velocity, MIN_SPEED)
    if compared is None or not _is_clear(*compared):
        return []
    ratio = compared[0]
    slower = scales.named(1 / ratio, scales.LENGTHS)
    if slower is not None and slower[0]:
        return [_length("velocity", slower, f"it is {1 / ratio:.3g} times the position's change")]
    one = scales.named(ratio, scales.LENGTHS)
    if one is None or not (one[0] or compared[1] > _SURELY):
        return []
    return [_length("position", one, f"it changes by {ratio:.3g} times the velocity")]


def _is_clear(ratio: float, following: float) -> bool:
    """Whether sizes that follow each other so far tell a unit; of a far ratio errors of either make none."""
    return following > (_FOLLOWS if 1 / _FAR < ratio < _FAR else _FAR_FOLLOWS)


def _length(quantity: str, scale: tuple[str, float], evidence: str) -> Hypothesis:
    unit, size = scale
    per = "/s" if quantity == "velocity" else ""
    what = f"in {unit}{per}" if unit else f"{size:.3g} times too large, a factor that is no unit"
    text = f"the {quantity} is {what}"
    return Hypothesis(f"{quantity}_unit", text, evidence, (StreamRepair(quantity, scale=_factor(size)),))


def _impossible(motion: Motion, quantity: str) -> list[Hypothesis]:
    speed = np.linalg.norm(motion.velocity if quantity == "velocity" else motion.moved, axis=1)
    speed = speed[np.isfinite(speed)]
    fastest = float(np.percentile(speed, 90)) if len(speed) >= MIN_ROWS else 0.0
    if fastest < _IMPOSSIBLE_SPEED:
        return []
    return [
        _length(quantity, ("mm", 1000.0), f"else the vehicle moves at {fastest:.0f} m/s, which none with rotors does")
    ]


_STEPS: tuple[Callable[[Streams, Motion], list[Hypothesis]], ...] = (
    _gyro_unit, _force_unit, axes.of_velocity, axes.of_pose, _lengths,
)  # fmt: skip
