"""The last setpoint of a stream may be held by an autopilot: still, with about hover thrust in the air."""

from __future__ import annotations

from collections.abc import Callable

import msgspec
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import Phase as Stage
from hypothesis import strategies as st

from dynamics.vehicle import Vehicle
from dynamics.vehicle_file import read_vehicle
from runtime.control.controller import Controller
from runtime.flight.decision import Decision
from runtime.flight.engagement import AutopilotRequest
from runtime.flight.events import POLICIES, Event, Fallback
from runtime.flight.flyer import Flyer
from runtime.flight.mission import Plan
from runtime.flight.motion import Transfer
from runtime.flight.phases import Phase
from tests.support.rate_controlled_vehicle import Flight

PLAN = Plan(height=1.0, speed=2.5, acceleration=4.0, settle=0.3)
STILL = 0.05  # rad/s
SILENT = 40  # ticks without a setpoint that end a stream
PHASES = (Phase.RAMP, Phase.CLIMB, Phase.APPROACH, Phase.TRACK, Phase.RETURN, Phase.DESCEND, Phase.TOUCHDOWN)
Fault = Callable[[Flight], None]


@pytest.fixture(scope="module")
def vehicle() -> Vehicle:
    return read_vehicle("vehicles/arpl_250g.toml")


@pytest.fixture(scope="module")
def controller(vehicle: Vehicle) -> Controller:
    return Controller.build(vehicle)


def prepare(vehicle: Vehicle, controller: Controller) -> Flight:
    controller.reset(np.array([*[0.0] * 6, 1.0, *[0.0] * 6]), 0.0)
    reference = Transfer(vehicle, np.array([1.0, 0.0, 1.5, 0.0]), np.array([-1.0, 0.5, 1.5, 0.5]), 3.0)
    return Flight(vehicle, controller, reference, plan=PLAN, effectiveness=0.85)


def stop_at_once(flight: Flight) -> None:
    flight.stop = True


def lose_link(flight: Flight) -> None:
    flight.connected, flight.frozen = False, True


def pilot_takes_over(flight: Flight) -> None:
    flight.mode = "POSCTL"


def lose_estimate(flight: Flight) -> None:
    flight.frozen = True


def solver_fails(flight: Flight) -> None:
    flight.findings = {Event.SOLVER_FAILED.value: "planted"}


def stops(event: Event) -> Fault:
    def plant(flight: Flight) -> None:
        flight.findings = {event.value: "planted"}

    plant.__name__ = event.value
    return plant


STOPPING = [event for event, policy in POLICIES.items() if policy.fallback is Fallback.STOP_STREAMING]
FAULTS: list[Fault] = [
    stop_at_once,
    lose_link,
    pilot_takes_over,
    lose_estimate,
    solver_fails,
    *map(stops, STOPPING),
]


def last_sent(flight: Flight) -> tuple[Decision, int]:
    """The last decision that sent a setpoint, and its tick."""
    ticks = [tick for tick, decision in enumerate(flight.story.decisions) if decision.rate_body is not None]
    return flight.story.decisions[ticks[-1]], ticks[-1]


def run_to_silence(flight: Flight, seconds: float = 6.0) -> None:
    for _ in range(round(seconds / 0.01)):
        flight.run(0.01)
        recent = flight.story.decisions[-SILENT:]
        if len(recent) == SILENT and all(decision.rate_body is None for decision in recent):
            return
    raise AssertionError("the stream did not end")


def hover_thrust(flight: Flight, vehicle: Vehicle) -> float:
    return flight.thrust_map.setpoint(vehicle.weight, flight.flyer.effectiveness.value)


@settings(
    max_examples=8, deadline=None, suppress_health_check=list(HealthCheck), phases=[Stage.explicit, Stage.generate]
)
@given(
    fault=st.sampled_from(FAULTS),
    phase=st.sampled_from(PHASES),
    later=st.integers(0, 80),
    turn=st.tuples(*[st.floats(-5.0, 5.0)] * 3),
)
def test_whatever_ends_a_stream_its_last_setpoint_can_be_held(
    vehicle: Vehicle, controller: Controller, fault: Fault, phase: Phase, later: int, turn: tuple[float, float, float]
) -> None:
    flight = prepare(vehicle, controller)
    flight.run(30.0, until=phase)
    flight.run(0.01 * later)
    if flight.flyer.over or not flight.flyer.mission.airborne:
        return  # landed meanwhile
    flight.plant.state[10:13] += turn
    flight.grants = flight.grants - {AutopilotRequest.LAND}
    fault(flight)
    run_to_silence(flight)
    decision, tick = last_sent(flight)
    if not flight.armed or flight.story.states[tick][2] < 0.02:
        return
    assert np.linalg.norm(decision.rate_body) <= STILL, (fault.__name__, phase, decision.rate_body)
    assert decision.thrust == pytest.approx(hover_thrust(flight, vehicle), rel=0.05)


@pytest.mark.parametrize("fault", FAULTS, ids=lambda fault: fault.__name__)
def test_a_flight_that_is_given_up_is_left_level_and_to_a_mode_that_holds(
    vehicle: Vehicle, controller: Controller, fault: Fault
) -> None:
    flight = prepare(vehicle, controller)
    flight.run(30.0, until=Phase.TRACK)
    flight.run(0.3)
    flight.plant.state[10:13] += (4.0, -3.0, 1.0)
    fault(flight)
    run_to_silence(flight)
    requests = {request for decision in flight.story.decisions for request in decision.requests}
    taken_over = fault in (pilot_takes_over,) or fault.__name__ == "other_controller"
    assert (AutopilotRequest.LAND in requests) is not taken_over
    decision, _ = last_sent(flight)
    assert np.linalg.norm(decision.rate_body) <= STILL


def test_the_last_setpoint_is_sent_several_times(vehicle: Vehicle, controller: Controller) -> None:
    flight = prepare(vehicle, controller)
    flight.run(30.0, until=Phase.TRACK)
    flight.grants = set()
    flight.stop = True
    run_to_silence(flight)
    sent = [decision for decision in flight.story.decisions if decision.rate_body is not None]
    assert all(np.linalg.norm(decision.rate_body) <= STILL for decision in sent[-4:])
    assert flight.flyer.over


def test_on_the_ground_the_last_setpoint_has_no_thrust(vehicle: Vehicle, controller: Controller) -> None:
    flight = prepare(vehicle, controller)
    flight.run(30.0, until=Phase.RAMP)
    flight.run(0.2)
    assert flight.plant.on_ground
    flight.stop = True
    run_to_silence(flight)
    decision, _ = last_sent(flight)
    assert decision.thrust == 0.0


def test_a_vehicle_that_disarmed_is_sent_nothing_more(vehicle: Vehicle, controller: Controller) -> None:
    flight = prepare(vehicle, controller)
    flight.run(30.0, until=Phase.TRACK)
    flight.armed = False
    flight.run(0.01)
    assert flight.story.decisions[-1].rate_body is None


def test_every_setpoint_says_what_may_be_held_in_its_place(vehicle: Vehicle, controller: Controller) -> None:
    """A control thread that dies between two ticks must have it ready."""
    flight = prepare(vehicle, controller)
    story = flight.run(40.0)
    for decision, state, (observation, _) in zip(story.decisions, story.states, story.observations, strict=True):
        if decision.rate_body is None:
            continue
        assert np.isfinite(decision.held_thrust)
        if state[2] > 0.3 and observation.armed:
            assert decision.held_thrust > 0.2
        if not observation.armed:
            assert decision.held_thrust == 0.0


def test_a_recorded_stop_is_replayed(vehicle: Vehicle, controller: Controller) -> None:
    flight = prepare(vehicle, controller)
    flight.run(30.0, until=Phase.TRACK)
    flight.stop = True
    run_to_silence(flight)
    again = prepare(vehicle, controller)
    flyer: Flyer = again.flyer
    for (observation, estimate), decision in zip(flight.story.observations, flight.story.decisions, strict=True):
        encoded = msgspec.structs.asdict(observation)
        repeated = flyer.step(type(observation)(**encoded), estimate)
        flyer.prepare(observation.time)
        assert (repeated.rate_body is None) == (decision.rate_body is None)
        if decision.rate_body is not None:
            assert np.array_equal(repeated.rate_body, decision.rate_body)
            assert repeated.thrust == decision.thrust
