"""Look at the flight that is planned, a few setpoints in each tick: which must not be the last ones. Pure."""

from __future__ import annotations

from collections.abc import Iterator
from math import cos

import numpy as np

from dynamics.arrays import Floats
from dynamics.state import ATTITUDE, POSITION, RATE
from dynamics.vehicle import GRAVITY
from runtime.control.rti.last_setpoint import LastSetpointCheck
from runtime.flight.mission import Mission
from runtime.flight.motion import Motion

SAMPLES, MAX_SAMPLED = 150, 600.0  # of a motion that is to be flown, in its first s
BATCH = 10  # samples a tick: a tenth of a millisecond
STILL = 1e-6  # rad/s
MORE_RATE, MORE_THRUST = 0.3, 0.05  # rad/s and share of the weight, by which setpoints are more than their plan's
MOVED = 0.1  # m or rad that a vehicle moves, before its flight is looked at once more


def failing_share(check: LastSetpointCheck, motion: Motion, duration: float, thrust_constant: float) -> float:
    """Share of a motion's setpoints that must not be the last ones.

    duration: s of it. thrust_constant: of its inputs, N s^2/rad^2.
    """
    return failing(check, motion, sampled_times(duration), thrust_constant) / SAMPLES


def sampled_times(duration: float) -> Floats:
    """Times (SAMPLES,), s, at which a motion that is flown for `duration` s is looked at."""
    return np.linspace(0.0, min(duration, MAX_SAMPLED), SAMPLES)


def failing(check: LastSetpointCheck, motion: Motion, times: Floats, thrust_constant: float) -> int:
    """Number of a motion's setpoints at times (n,), s, that must not be the last ones."""
    weight = check.model.mass * GRAVITY
    states, later = motion.states(times), motion.states(times + check.model.lag[0])[:, RATE]
    thrusts = thrust_constant * np.sum(motion.inputs(times) ** 2, axis=1)
    rates = later + MORE_RATE * later / np.maximum(np.linalg.norm(later, axis=1), STILL)[:, None]
    sent = thrusts + MORE_THRUST * weight * np.sign(thrusts - weight)
    rows = zip(states, thrusts.tolist(), rates, sent.tolist(), strict=True)
    return sum(check.harm(state, 0.0, now, rate, thrust) > 0 for state, now, rate, thrust in rows)


class PlanReview:
    """Looks at the transfer to the reference and at the reference, BATCH samples at each call.

    share: of setpoints that must not be the last ones; None before the look is complete.
    """

    def __init__(self, check: LastSetpointCheck, thrust_constant: float) -> None:
        """thrust_constant: of the rotors, N s^2/rad^2."""
        self.share: float | None = None
        self._check, self._thrust_constant = check, thrust_constant
        self._rest: Iterator[float | None] = iter(())
        self._start: Floats | None = None

    def clear(self) -> None:
        """Forget the flight: it is planned anew, or elsewhere."""
        self.share, self._start, self._rest = None, None, iter(())

    def go_on(self, mission: Mission, state: Floats, *, standing: bool) -> bool:
        """Look at the next setpoints of the flight that would begin here. Returns whether that completes a look.

        state: (13,) of the vehicle. standing: whether it stands on the ground. A complete look is done once more where
        the vehicle has moved since.
        """
        if self._start is None or (self.share is not None and self._has_moved(state)):
            self.share, self._start = None, state
            self._rest = self._shares(mission, state, standing)
        if self.share is None:
            self.share = next(self._rest)
            return self.share is not None
        return False

    def _has_moved(self, state: Floats) -> bool:
        assert self._start is not None
        turned = abs(float(state[ATTITUDE] @ self._start[ATTITUDE])) < cos(MOVED / 2)
        return turned or float(np.linalg.norm(state[POSITION] - self._start[POSITION])) > MOVED

    def _shares(self, mission: Mission, state: Floats, standing: bool) -> Iterator[float | None]:
        """None after each batch, at the end the share."""
        ground, motions = mission.planned(state, standing=standing)
        yield None
        count = 0
        for motion, duration in motions:
            for times in np.split(sampled_times(duration), SAMPLES // BATCH):
                self._check.model.ground = ground
                count += failing(self._check, motion, times, self._thrust_constant)
                yield None
        yield count / (SAMPLES * len(motions))
