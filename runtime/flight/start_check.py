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


def start_refusal(reference: Motion, position: Floats, *, on_ground: bool) -> str:
    """Why a reference must not be flown from here, empty when it may be.

    position: (3,) m, of the vehicle. on_ground: whether it stands there, so that the reference must clear it.
    """
    times = np.arange(0.0, min(reference.duration, MAX_DURATION), STEP)
    path = reference.states(times)[:, POSITION]
    distance = float(np.linalg.norm(path[0] - position))
    if distance > MAX_DISTANCE:
        place = ", ".join(f"{value:.1f}" for value in position)
        return (
            f"the reference starts {distance:.0f} m from the vehicle, which is at {place} m (east, north, up). "
            f"Start within {MAX_DISTANCE:g} m of it."
        )
    ground, lowest = float(position[2]), float(np.min(path[:, 2]))
    if on_ground and lowest < ground + MIN_CLEARANCE:
        return (
            f"the reference comes down to {lowest:.2f} m, the vehicle stands at {ground:.2f} m. Keep "
            f"{MIN_CLEARANCE:g} m above it: give the manoeuvre a height, as in lemniscate:height=1."
        )
    return ""
