"""The flight logic's settings, the outcome of one of its ticks, and how a flight ends."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import msgspec

from dynamics.arrays import Floats
from dynamics.controller_settings import CONTROL_PERIOD
from runtime.flight.engagement import AutopilotRequest, EngagementSettings, Transition
from runtime.flight.events import EventChange, Fallback
from runtime.flight.failsafe import FallbackBounds
from runtime.flight.health import HealthLimits
from runtime.flight.thrust import EffectivenessSettings

LastSetpointMode = Literal["auto", "replace", "off"]


class FlyerSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """How a flight is flown, besides vehicle, controller and mission.

    period: of the control thread, s.
    engagement: how control is taken.
    bounds: of the fallbacks.
    health: limits of the health checks.
    thrust: of the effectiveness filter.
    last_setpoint: which setpoints are replaced that must not be the last ones, see `runtime.flight.last_setpoint`.
        Recordings without the key were flown without.
    """

    period: float = CONTROL_PERIOD
    engagement: EngagementSettings = EngagementSettings()
    bounds: FallbackBounds = FallbackBounds()
    health: HealthLimits = HealthLimits()
    thrust: EffectivenessSettings = EffectivenessSettings()
    last_setpoint: LastSetpointMode = "off"


@dataclass
class Decision:
    """The outcome of a tick.

    rate_body: (3,) rad/s; None: nothing may be sent.
    thrust: 0..1, as it is sent.
    collective_thrust: N, that it stands for.
    held_thrust: 0..1, of a setpoint without rates that may be held if the stream has to end before the next tick.
    fallback: that is flown.
    solver_status: 0 solved, 1 cut short with inputs within their limits, -1 no solution was computed.
    feedback_seconds: of the solver.
    requests: for the autopilot.
    transitions: of the engagement.
    event_changes: events raised and cleared.
    """

    rate_body: Floats | None = None
    thrust: float = 0.0
    collective_thrust: float = 0.0
    held_thrust: float = 0.0
    fallback: Fallback = Fallback.NONE
    solver_status: int = -1
    feedback_seconds: float = 0.0
    requests: tuple[AutopilotRequest, ...] = ()
    transitions: list[Transition] = field(default_factory=list)
    event_changes: list[EventChange] = field(default_factory=list)


@dataclass
class Ending:
    """How a flight ends on the ground: by its landing, unless one of these says why it does not.

    crashed: what it has met.
    not_flown: why it never left the ground.
    """

    crashed: str = ""
    not_flown: str = ""

    @property
    def landed(self) -> bool:
        """Whether it ends by its landing."""
        return not (self.crashed or self.not_flown)

    def describe(self, disarmed: str) -> str:
        """In words. disarmed: what became of the motors."""
        if self.landed:
            return f"landed {disarmed}"
        return (
            f"crashed {disarmed}: {self.crashed}" if self.crashed else f"did not take off {disarmed}: {self.not_flown}"
        )
