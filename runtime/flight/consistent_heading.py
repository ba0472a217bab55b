"""The estimated heading, made consistent with the motion: an estimator may take a magnet for the north. Pure.

Turned by an angle, the measured specific force accelerates the vehicle elsewhere than its estimated velocity says, and
a position controller that tilts it by such a heading spirals away, from about a radian on, within two seconds. The
angle between the two changes of velocity is the heading's error (least squares, with the error's deviation from the
accelerations that there were). Hovering shows nothing of it.
"""

from __future__ import annotations

from math import atan2, degrees, exp, hypot, inf, isfinite, remainder, sqrt, tau

import msgspec
import numpy as np

from dynamics import quaternion
from dynamics.arrays import Floats
from dynamics.state import ATTITUDE
from runtime.flight.events import Event
from runtime.link.estimate import StateEstimate

WINDOW = 0.3  # s over which a change of velocity is measured
NOISE = 0.2  # m/s of such a change, of both together: PX4's in its own simulation are 0.09 and 0.06
MEMORY = 2.0  # s
CERTAIN = 5.0  # standard deviations of the angle
MIN_EXCITATION = 0.5  # (m/s)^2, sum of the squared changes: what biases and noise have in hover is a quarter of it
WRONG = 0.5  # rad of a heading's error, from which the position's control has little damping left
MAX_GAP = 0.1  # s between two estimates


class ConsistentHeading:
    """Corrects estimates by the angle between accelerometer and velocity, where it is certain and large.

    correction: rad about up, of the last estimate.
    turned: rad by which the last call has changed it.
    """

    def __init__(self) -> None:
        self.correction = self.turned = 0.0
        self._detail = ""
        self.clear()

    def clear(self) -> None:
        """Forget the accelerations, as on the ground."""
        self._before: StateEstimate | None = None
        self._across = self._along = self._excitation = 0.0
        self._begin_window()

    def _begin_window(self) -> None:
        self._elapsed = 0.0
        self._predicted, self._estimated = np.zeros(2), np.zeros(2)

    def correct(self, estimate: StateEstimate, specific_force: Floats, *, moved_yaw: float) -> StateEstimate:
        """An estimate with its heading corrected.

        specific_force: (3,) m/s^2, body; NaN where none is new. moved_yaw: rad by which a reset has moved the heading.
        """
        self.turned = 0.0
        if moved_yaw:
            self._follow_reset(moved_yaw)
        before, self._before = self._before, estimate
        if before is not None and np.isfinite(specific_force).all():
            self._learn(before, estimate, specific_force)
        if not self.correction:
            return estimate
        state = estimate.state.copy()
        state[ATTITUDE] = quaternion.multiply(quaternion.from_euler(0.0, 0.0, self.correction), state[ATTITUDE])
        return msgspec.structs.replace(estimate, state=state)

    def findings(self) -> dict[Event, str]:
        """The event of a heading that was corrected, if it was."""
        return {Event.HEADING_WRONG: self._detail} if self.correction else {}

    def _follow_reset(self, yaw: float) -> None:
        """Believe a reset; where the heading was corrected before it, keep what is left of the correction."""
        self.clear()
        if self.correction:
            left = remainder(self.correction - yaw, tau)
            self._turn(0.0 if abs(left) < WRONG else left)

    def _learn(self, before: StateEstimate, now: StateEstimate, specific_force: Floats) -> None:
        elapsed = now.time - before.time
        if not 0.0 < elapsed < MAX_GAP:
            self._begin_window()
            return
        self._elapsed += elapsed
        self._predicted += elapsed * np.asarray(quaternion.rotate(now.attitude, specific_force))[:2]
        self._estimated += now.velocity_world[:2] - before.velocity_world[:2]
        if self._elapsed >= WINDOW:
            self._take_window()

    def _take_window(self) -> None:
        (east, north), (moved_east, moved_north) = self._predicted, self._estimated
        share = exp(-self._elapsed / MEMORY)
        self._along = share * self._along + east * moved_east + north * moved_north
        self._across = share * self._across + east * moved_north - north * moved_east
        self._excitation = share * self._excitation + east**2 + north**2
        self._begin_window()
        error = atan2(self._across, self._along)
        deviation = NOISE / sqrt(self._excitation) if self._excitation > MIN_EXCITATION else inf
        wrong = abs(remainder(error - self.correction, tau))
        if isfinite(deviation) and wrong > max(WRONG, CERTAIN * deviation) and self._explains:
            self._detail = f"by {degrees(error):.0f} degrees, +- {degrees(deviation):.0f}"
            self._turn(error)

    @property
    def _explains(self) -> bool:
        """Whether the angle explains the most of the accelerations: a velocity that errs otherwise does not turn."""
        return hypot(self._across, self._along) > 0.5 * self._excitation

    def _turn(self, correction: float) -> None:
        self.turned = remainder(correction - self.correction, tau)
        self.correction = correction
