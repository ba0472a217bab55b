"""How the vehicle stands before take-off: where it is, and whether it stands upright. Pure."""

from __future__ import annotations

from collections import deque
from math import degrees, radians

import numpy as np

from dynamics.arrays import Floats
from dynamics.state import ATTITUDE, POSITION
from runtime.flight.contact import tilt_of
from runtime.flight.events import Event
from runtime.link.start_conditions import MAX_START_TILT

MAX_TILT = radians(MAX_START_TILT)
MEDIAN_TIME = 1.0  # s over which the place of take-off is taken: the estimate moves by centimetres at rest


class StartPose:
    """Collects the estimates of the last second before the motors start."""

    def __init__(self) -> None:
        self._positions: deque[tuple[float, Floats]] = deque(maxlen=512)
        self._tilt = 0.0

    def add(self, state: Floats, time: float, *, moved: bool) -> None:
        """Add an estimate. state: (13,). time: s. moved: whether the estimator has moved its frame since the last."""
        if moved:
            self._positions.clear()
        self._positions.append((time, state[POSITION].copy()))
        while self._positions[0][0] < time - MEDIAN_TIME:
            self._positions.popleft()
        self._tilt = tilt_of(state[ATTITUDE])

    def median(self, state: Floats) -> Floats:
        """The state (13,) with the position's median over the last second."""
        result = state.copy()
        if self._positions:
            result[POSITION] = np.median([position for _, position in self._positions], axis=0)
        return result

    def leaning(self, state: Floats) -> float:
        """How much more the vehicle is tilted than before the motors started, rad. state: (13,)."""
        return tilt_of(state[ATTITUDE]) - self._tilt

    def findings(self) -> dict[Event, str]:
        """The event of a vehicle that does not stand upright, if it does not."""
        if self._tilt <= MAX_TILT:
            return {}
        return {
            Event.NOT_UPRIGHT: f"tilted by {degrees(self._tilt):.0f} degrees, at most {degrees(MAX_TILT):.0f} may be: "
            "put it on level ground, or calibrate its attitude"
        }
