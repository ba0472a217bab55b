"""The newest measurements of a flight: estimate, consistent in itself, specific force, battery voltage. Pure."""

from __future__ import annotations

from math import isnan, nan

import msgspec
import numpy as np

from dynamics.arrays import Floats
from dynamics.state import ATTITUDE
from runtime.flight.consistent_heading import ConsistentHeading
from runtime.flight.consistent_velocity import ConsistentVelocity
from runtime.flight.events import Event
from runtime.flight.health import FrozenEstimate
from runtime.flight.thrust import specific_force_z
from runtime.link.estimate import StateEstimate
from runtime.record.records import ObservationRecord


class Measurements:
    """Measurements up to the present tick.

    estimate: the newest, its velocity and heading corrected; None before the first.
    state: (13,) of it, None before the first.
    fresh: whether it is newer than at the last tick.
    force: (3,) specific force, m/s^2, body; NaN where none is new.
    voltage: of the battery, V; NaN before the first.
    heading: the estimate's, against the motion.
    """

    def __init__(self) -> None:
        self.estimate: StateEstimate | None = None
        self.state: Floats | None = None
        self.fresh = False
        self.force = np.full(3, np.nan)
        self.voltage = nan
        self._received: StateEstimate | None = None
        self._previous: StateEstimate | None = None
        self._observation: ObservationRecord | None = None
        self._turned: Floats | None = None
        self.heading = ConsistentHeading()
        self._velocity, self._frozen = ConsistentVelocity(), FrozenEstimate()

    def take(self, observation: ObservationRecord, received: StateEstimate | None, *, aloft: bool) -> None:
        """Take one tick.

        received: the newest estimate, the same object while there is no newer. aloft: whether the vehicle flies, so
        that it is the thrust which moves it.
        """
        self.fresh = received is not None and received is not self._received
        self._received = received
        force = np.append(observation.specific_force_xy, observation.specific_force_z)
        estimate = None if received is None else self.estimate
        if not aloft:
            self.heading.clear()
        if received is not None and self.fresh:
            moved_yaw = observation.reset_yaw if observation.reset else 0.0
            consistent = self.heading.correct(received, force, moved_yaw=moved_yaw)
            late = observation.answered and bool(self.heading.turned)
            self._turned = consistent.attitude if late else None
            estimate = self._velocity.correct(received if late else consistent, moved=observation.reset)
            self.state = estimate.state
        self._previous, self.estimate = self.estimate, estimate
        self.force = force
        self.voltage = observation.battery_voltage if observation.battery_voltage > 0 else self.voltage
        self._observation = observation

    def take_turn(self) -> None:
        """Correct the heading of an estimate that was answered before it was known to be wrong."""
        if self._turned is None or self.estimate is None:
            return
        state = self.estimate.state.copy()
        state[ATTITUDE], self._turned = self._turned, None
        self.estimate, self.state = msgspec.structs.replace(self.estimate, state=state), state

    @property
    def correction(self) -> tuple[StateEstimate | None, Floats]:
        """The last estimate as it was received, None before the first, and the correction (3,) m/s of its velocity."""
        return self._velocity.before, self._velocity.correction

    def take_observation(self) -> ObservationRecord | None:
        """The last observation, once."""
        observation, self._observation = self._observation, None
        return observation

    @property
    def moved_on(self) -> bool:
        """Whether the estimate is another one than at the last tick."""
        return self.estimate is not None and self.estimate is not self._previous

    @property
    def vertical_force(self) -> float:
        """Specific force along body z, m/s^2: measured, else from two estimates; NaN without either."""
        force, now, before = float(self.force[2]), self.estimate, self._previous
        if isnan(force) and now is not None and before is not None and now.time - before.time > 1e-3:
            elapsed = now.time - before.time
            return specific_force_z(before.velocity_world, now.velocity_world, elapsed, now.attitude)
        return force

    def frozen(self) -> dict[Event, str]:
        """The event of estimates that stay the same while the force changes, if they do."""
        return {} if self._received is None else self._frozen.update(self._received, self.force)
