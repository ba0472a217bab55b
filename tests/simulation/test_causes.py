"""Disturbances of control have their names: this computer, the link, another controller, and only then the vehicle."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from dynamics.references import named_reference
from runtime.flight.composition import Controllers
from runtime.flight.events import Event
from runtime.flight.mission import Plan
from runtime.flight.phases import Phase
from simulation.whole_flight import Lockstep, WholeFlight, fly_whole
from sitl_mock.autopilot.fault_schedule import Fault
from sitl_mock.mock import MockOptions
from sitl_mock.scenario import Scenario
from vehicles import FOLDER

FILE = FOLDER / "px4_sih.toml"
PLAN = Plan(height=1.5, duration=4.0, settle=0.3, origin="takeoff", low=0.7)
FEIGNED = {Event.SETPOINT_REFUSED, Event.IMPACT, Event.GROUND_CONTACT, Event.HELD}
CAUSES = {Event.HOST_STALLED, Event.HOST_STARVED, Event.LINK_JITTER, Event.LINK_UNSTEADY, Event.OTHER_CONTROLLER}
Watch = Callable[[Lockstep], None]


def fly(controllers: Controllers, watch: Watch | None = None, *faults: Fault, seed: int = 41) -> WholeFlight:
    reference = named_reference("Circle:height=2,size=1.5,speed=2", controllers.flying.trim)
    options = MockOptions(FILE, scenario=Scenario(faults=faults), seed=seed)
    return fly_whole(options, reference, plan=PLAN, controllers=controllers, watch=watch, limit=60.0)


def stalls(duration: float, every: float) -> Watch:
    """A computer that stands still for so many s again and again while the reference is tracked."""

    def watch(flown: Lockstep) -> None:
        time = flown.autopilot.time
        if flown.flyer.mission.phase is Phase.TRACK and time >= state[0]:
            state[0] = time + every
            flown.stall = duration

    state = [0.0]
    return watch


def jitters(longest: float) -> Watch:
    def watch(flown: Lockstep) -> None:
        flown.jitter = longest if flown.flyer.mission.phase is Phase.TRACK else 0.0

    return watch


OTHER = [(0.0, 0.0, 0.0, 0.9), (2.0, -1.0, 0.0, 0.5), (0.0, 0.0, 3.0, 0.45), (0.0, 0.0, 0.0, 0.2)]


@pytest.mark.parametrize(
    ("watch", "faults", "named"),
    [
        pytest.param(stalls(0.3, 100.0), (), {Event.HOST_STALLED}, id="stalled once"),
        pytest.param(stalls(0.25, 0.3), (), {Event.HOST_STALLED, Event.HOST_STARVED}, id="starved"),
        pytest.param(stalls(0.12, 0.14), (), {Event.HOST_STALLED, Event.HOST_STARVED}, id="starved in short"),
        pytest.param(jitters(0.2), (), {Event.LINK_JITTER}, id="jitter"),
        *[
            pytest.param(
                None, (Fault("other_controller", 4.0, "takeoff", setpoint=setpoint),), {Event.OTHER_CONTROLLER}
            )
            for setpoint in OTHER
        ],
        pytest.param(None, (), set(), id="nothing"),
    ],
)
def test_each_cause_has_its_name_and_no_other(
    controllers: Controllers, watch: Watch | None, faults: tuple[Fault, ...], named: set[Event]
) -> None:
    flight = fly(controllers, watch, *faults)
    text = [(round(time, 2), event.value, detail) for time, event, detail in flight.events]
    assert named <= flight.raised, (flight.outcome, text)
    assert not flight.raised & FEIGNED, (flight.outcome, text)
    others = CAUSES - named - {Event.LINK_UNSTEADY if Event.LINK_JITTER in named else None}
    assert not flight.raised & others, (flight.outcome, text)
    assert named or flight.landed


def test_one_standstill_does_not_end_a_flight(controllers: Controllers) -> None:
    flight = fly(controllers, stalls(0.3, 100.0))
    assert flight.outcome == "landed and disarmed"
    assert flight.landing_reason == ""


def test_a_vehicle_that_does_not_follow_is_still_called_so(controllers: Controllers) -> None:
    flight = fly(controllers, None, Fault("held", 4.0, "takeoff"))
    assert flight.raised & (FEIGNED | {Event.TRACKING_LOST})
    assert not flight.raised & CAUSES


def test_a_starved_computer_hands_over_before_the_vehicle_is_lost(controllers: Controllers) -> None:
    flight = fly(controllers, stalls(0.25, 0.3))
    assert "this computer" in flight.outcome
    assert np.degrees(flight.tilt.max()) < 60.0
