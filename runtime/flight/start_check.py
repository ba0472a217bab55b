"""Whether a reference can be started from where the vehicle stands. Pure."""

from __future__ import annotations

import numpy as np

from dynamics.arrays import Floats
from dynamics.state import POSITION
from runtime.flight.motion import Motion

MAX_DISTANCE = 50.0  # m from the vehicle to the start of the reference
MIN_CLEARANCE = 0.15  # m of the reference above the ground on which the vehicle stands
MAX_DURATION = 600.0  # s of the reference that are checked
STEP = 0.02  # s
Corner = tuple[float, float, float]
Box = tuple[Corner, Corner]


def start_refusal(
    reference: Motion, position: Floats, *, on_ground: bool, from_here: bool = False, box: Box | None = None
) -> str:
    """Why a reference must not be flown from here, empty when it may be.

    position: (3,) m, of the vehicle. on_ground: whether it stands there, so that the reference must clear it.
    from_here: whether the reference's coordinates count from there. box: lower and upper corner of the allowed
    positions, m, None for any.
    """
    times = np.arange(0.0, min(reference.duration, MAX_DURATION), STEP)
    path = reference.states(times)[:, POSITION] + (position if from_here else np.zeros(3))
    distance = float(np.linalg.norm(path[0] - position))
    if distance > MAX_DISTANCE:
        place = ", ".join(f"{value:.1f}" for value in position)
        return (
            f"the reference starts {distance:.0f} m from the vehicle, which is at {place} m (east, north, up). "
            f"Start within {MAX_DISTANCE:g} m of it."
        )
    ground, lowest = float(position[2]), float(np.min(path[:, 2]))
    if on_ground and lowest < ground + MIN_CLEARANCE:
        stands = f"the vehicle stands at {ground:.2f} m of the estimator's height, from which it counts here"
        return (
            f"the reference comes down to {lowest - ground:.2f} m above the place of take-off"
            f"{'' if from_here else f' ({stands})'}. Keep {MIN_CLEARANCE:g} m above it: give the manoeuvre a height, "
            f"as in lemniscate:height=1{'' if from_here else ', or let it count from there with --origin takeoff'}."
        )
    return _box_refusal(path, box)


def _box_refusal(path: Floats, box: Box | None) -> str:
    if box is None:
        return ""
    for axis, place, low, high in zip("xyz", path.T, *box, strict=True):
        if place.min() < low or place.max() > high:
            return (
                f"from here the reference covers {place.min():.2f} to {place.max():.2f} m in {axis}, the vehicle "
                f"file's limits.box {low:g} to {high:g} m. Start at another place, or make the manoeuvre smaller."
            )
    return ""
