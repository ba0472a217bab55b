"""The plan of the next tick if nothing but its estimate is new: all that `alula_tick` needs of the flight logic."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from dynamics.arrays import Floats
from runtime.control.controller import Controller
from runtime.control.rti.last_setpoint import LastSetpointModel
from runtime.flight.events import POLICIES, Event
from runtime.flight.failsafe import SUSTAINED
from runtime.flight.takeoff import HandOver
from runtime.link.estimate import StateEstimate


@dataclass(frozen=True)
class TickPlan:
    """A tick of the controller without a fallback.

    controller: that flies, prepared.
    before: the last estimate that was flown, as it was received; None before the first.
    correction: (3,) m/s, of its velocity.
    tilt_rate: limit of roll and pitch rates, rad/s.
    hand_over: transition from another thrust, None without one.
    effectiveness: thrust per modelled thrust.
    last_setpoint: by which setpoints that may be the last ones are checked, None where they are not.
    last_thrust: collective thrust of the setpoint before, N.
    """

    controller: Controller
    before: StateEstimate | None
    correction: Floats
    tilt_rate: float
    hand_over: HandOver | None
    effectiveness: float
    last_setpoint: LastSetpointModel | None
    last_thrust: float


def leaves_tick(events: Iterable[Event]) -> bool:
    """Whether a tick is flown as if none of these events were present, by their policies.

    For a controller of the vehicle file's model: there is none to fall back to in its place.
    """
    policies = [POLICIES[event] for event in events]
    return not any(policy.fallback not in SUSTAINED or policy.lands or policy.probes for policy in policies)
