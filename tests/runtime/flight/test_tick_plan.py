"""The flight logic plans the next tick only where no event, phase or fallback could decide otherwise."""

from __future__ import annotations

import numpy as np
import pytest

from dynamics.vehicle import Vehicle
from runtime.control.controller import Controller
from runtime.flight.events import POLICIES, Event, Fallback
from runtime.flight.failsafe import SUSTAINED
from runtime.flight.motion import Transfer
from runtime.flight.phases import Handler, Phase
from runtime.flight.tick_plan import leaves_tick
from tests.support.rate_controlled_vehicle import Flight
from tests.support.tick_in_c import FlightInC


@pytest.fixture(scope="module")
def controller(arpl_250g: Vehicle) -> Controller:
    return Controller.build(arpl_250g)


def reference_of(vehicle: Vehicle) -> Transfer:
    return Transfer(vehicle, np.array([1.0, 0.0, 1.5, 0.0]), np.array([-1.0, 0.5, 1.5, 0.5]), 3.0)


def test_ticks_are_planned_while_the_controller_flies_and_only_then(arpl_250g: Vehicle, controller: Controller) -> None:
    flight = Flight(arpl_250g, controller, reference_of(arpl_250g))
    planned: dict[Handler, list[bool]] = {}
    while not (flight.flyer.over and flight.story.transitions):
        flight.run(0.01)
        policy = flight.flyer.mission.policy
        planned.setdefault(policy.handler, []).append(flight.flyer.plan() is not None)
    assert all(planned[Handler.FLY])
    assert not any(any(plans) for handler, plans in planned.items() if handler is not Handler.FLY)


@pytest.mark.parametrize("event", [Event.ESTIMATE_JUMP, Event.LINK_LOST, Event.IMPACT])
def test_no_tick_is_planned_while_an_event_acts(event: Event, arpl_250g: Vehicle, controller: Controller) -> None:
    flight = Flight(arpl_250g, controller, reference_of(arpl_250g))
    flight.run(20.0, until=Phase.TRACK)
    assert flight.flyer.plan() is not None
    flight.findings = {event.value: "planted"}
    flight.run(0.02 + POLICIES[event].onset)
    assert flight.flyer.plan() is None or flight.flyer.mission.landing_reason


def test_events_that_change_no_setpoint_leave_a_tick() -> None:
    assert leaves_tick([Event.SOLVER_CUT, Event.LINK_JITTER, Event.RATES_LOW, Event.DEADLINES_MISSED])
    for event, policy in POLICIES.items():
        if policy.fallback not in SUSTAINED or policy.lands or policy.probes:
            assert not leaves_tick([Event.SOLVER_CUT, event])


@pytest.mark.parametrize("event", [Event.SETPOINT_REFUSED, Event.IMPACT, Event.ESTIMATE_JUMP])
def test_what_is_observed_after_the_setpoint_left_acts_from_the_next_tick_on(
    event: Event, arpl_250g: Vehicle, controller: Controller
) -> None:
    flight = FlightInC(arpl_250g, controller, reference_of(arpl_250g))
    flight.run(20.0, until=Phase.TRACK)
    answered, flight.late_findings = flight.answered, {event.value: "planted"}
    flight.run(0.01)
    assert flight.answered == answered + 1
    assert not flight.differing  # the setpoint is that of the plan
    assert flight.story.decisions[-1].fallback is Fallback.NONE
    assert flight.flyer.plan() is None
    flight.run(0.01)
    assert flight.answered == answered + 1
    settles = flight.flyer.mission.policy.handler is not Handler.FLY
    assert settles or flight.story.decisions[-1].fallback is not Fallback.NONE or not flight.flyer.engagement.streaming
