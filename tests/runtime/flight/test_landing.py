"""Landings on an estimate that drifts on, on ground that turns nothing upright: contact by force, then no authority."""

from __future__ import annotations

import numpy as np
import pytest

from dynamics.state import ATTITUDE
from dynamics.vehicle import GRAVITY, Vehicle
from dynamics.vehicle_file import read_vehicle
from runtime.control.controller import Controller
from runtime.flight.contact import tilt_of
from runtime.flight.decision import FlyerSettings
from runtime.flight.engagement import AutopilotRequest, EngagementSettings, State
from runtime.flight.events import Event
from runtime.flight.motion import Transfer
from runtime.flight.phases import Phase
from tests.support.drifting_estimate import DriftingEstimate
from tests.support.rate_controlled_vehicle import Flight, Story


@pytest.fixture(scope="module")
def vehicle() -> Vehicle:
    return read_vehicle("vehicles/px4_sih.toml")


@pytest.fixture(scope="module")
def controller(vehicle: Vehicle) -> Controller:
    return Controller.build(vehicle)


def prepare(vehicle: Vehicle, controller: Controller, seed: int = 1, height: float = 0.5) -> Flight:
    """A vehicle that hovers in the air and is told to land as soon as it flies."""
    controller.reset(np.array([*[0.0] * 6, 1.0, *[0.0] * 6]), 0.0)
    reference = Transfer(vehicle, np.zeros(4), np.zeros(4), 2.0)
    settings = FlyerSettings(engagement=EngagementSettings(stream_time=0.1, resume=True))
    flight = Flight(vehicle, controller, reference, settings=settings)
    flight.armed, flight.reports_landed = True, False
    flight.plant.state[2], flight.plant.force, flight.plant.righting = height, vehicle.weight, False
    flight.estimate_error = DriftingEstimate(seed, start_height=0.8)
    flight.held_until_offboard = True
    flight.run(3.0, until=State.ENGAGED)
    flight.leave = "SIGINT"
    return flight


def contact_of(story: Story) -> int:
    """The tick at which the vehicle touched the ground for the last time in the air."""
    heights = np.array([state[2] for state in story.states])
    return int(np.flatnonzero(heights > 0.02)[-1]) + 1


def steepest(story: Story) -> float:
    """Greatest tilt from shortly before the contact on, degrees."""
    return float(np.degrees(max(tilt_of(state[ATTITUDE]) for state in story.states[contact_of(story) - 1 :])))


@pytest.mark.parametrize("seed", range(4))
def test_it_stays_upright_and_its_motors_stop_within_a_second(
    vehicle: Vehicle, controller: Controller, seed: int
) -> None:
    flight = prepare(vehicle, controller, seed)
    story = flight.run(15.0)
    assert story.transitions[-1].reason == "landed and disarmed"
    assert steepest(story) < 10.0
    contact = story.times[contact_of(story)]
    after = [d.collective_thrust for d, t in zip(story.decisions, story.times, strict=True) if t > contact + 1.0]
    assert max(after, default=0.0) < 0.05 * vehicle.weight


def test_without_inertial_samples_the_estimated_velocity_shows_the_contact(
    vehicle: Vehicle, controller: Controller
) -> None:
    flight = prepare(vehicle, controller)
    flight.imu = False
    story = flight.run(15.0)
    assert story.transitions[-1].reason == "landed and disarmed"
    assert steepest(story) < 10.0


@pytest.mark.parametrize("refusals", [1, 3])
def test_it_asks_for_disarming_until_it_is_done(vehicle: Vehicle, controller: Controller, refusals: int) -> None:
    flight = prepare(vehicle, controller)
    flight.grants = set(AutopilotRequest) - {AutopilotRequest.DISARM}
    flight.run(15.0, until=Phase.SHUTDOWN)
    flight.run(0.35 + 0.5 * (refusals - 1))
    assert sum(AutopilotRequest.DISARM in decision.requests for decision in flight.story.decisions) == refusals
    flight.grants = set(AutopilotRequest)
    flight.run(2.0)
    assert flight.story.transitions[-1].reason == "landed and disarmed"


def test_a_gust_that_was_mistaken_for_the_ground_costs_little_height(vehicle: Vehicle, controller: Controller) -> None:
    flight = prepare(vehicle, controller, height=2.0)
    flight.run(15.0, until=Phase.TOUCHDOWN)
    flight.run(0.5)
    height = flight.plant.state[2]
    flight.plant.disturbance = np.array([0.0, 0.0, 0.4 * GRAVITY])
    flight.run(2.0, until=Phase.CONTACT)
    flight.plant.disturbance = np.zeros(3)
    flight.run(0.6)
    assert Event.CONTACT_LOST in flight.story.raised
    assert flight.flyer.mission.phase is Phase.TOUCHDOWN
    assert flight.plant.state[2] > height - 0.6
    story = flight.run(15.0)
    assert story.transitions[-1].reason == "landed and disarmed"
    assert steepest(story) < 10.0


@pytest.mark.parametrize("speed", [0.3, 0.8])
def test_a_bounce_is_caught_softly(vehicle: Vehicle, controller: Controller, speed: float) -> None:
    flight = prepare(vehicle, controller)
    flight.run(15.0, until=Phase.TOUCHDOWN)
    flight.run(15.0, until=Phase.CONTACT)
    bounced = len(flight.story.states)
    flight.plant.state[2], flight.plant.state[5] = 0.01, speed
    story = flight.run(20.0)
    assert story.transitions[-1].reason == "landed and disarmed"
    assert max(state[2] for state in story.states[bounced:]) < 0.01 + speed**2 / 2 / GRAVITY + 0.15
    assert max(decision.collective_thrust for decision in story.decisions[bounced:]) < 1.4 * vehicle.weight
    assert steepest(story) < 10.0


def test_an_estimate_that_freezes_at_touch_down_leaves_the_contact_to_the_accelerometer(
    vehicle: Vehicle, controller: Controller
) -> None:
    flight = prepare(vehicle, controller)
    flight.run(15.0, until=Phase.TOUCHDOWN)
    while flight.plant.state[2] > 0.1:
        flight.run(0.01)
    flight.frozen = True
    story = flight.run(5.0)
    assert Event.ESTIMATE_STALE in story.raised
    assert story.transitions[-1].reason == "landed and disarmed"
    assert steepest(story) < 10.0


def test_an_estimate_that_is_lost_while_landing_is_left_to_the_autopilot_s_own_landing(
    vehicle: Vehicle, controller: Controller
) -> None:
    flight = prepare(vehicle, controller, height=3.0)
    flight.run(15.0, until=Phase.TOUCHDOWN)
    flight.frozen = True
    story = flight.run(5.0)
    assert flight.mode == "LAND"  # its failsafe might have been a return, and a climb
    assert "failsafe" in story.transitions[-1].reason


@pytest.mark.parametrize("jump", [-1.0, 1.0])
def test_a_height_that_jumps_while_landing_neither_drops_the_vehicle_nor_lifts_it(
    vehicle: Vehicle, controller: Controller, jump: float
) -> None:
    flight = prepare(vehicle, controller, height=0.6)
    flight.run(15.0, until=Phase.TOUCHDOWN)
    before, height = len(flight.story.states), flight.plant.state[2]
    flight.offset = np.array([0.0, 0.0, jump])
    story = flight.run(15.0)
    assert story.transitions[-1].reason == "landed and disarmed"
    assert max(state[2] for state in story.states[before:]) < height + 0.3
    assert min(state[5] for state in story.states[before:]) > -1.0
    assert steepest(story) < 10.0
