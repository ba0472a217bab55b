"""Flights whose ticks C answers: the flight logic decides the same, and a replay in Python has the same bits."""

from __future__ import annotations

from pathlib import Path

import msgspec
import numpy as np
import pytest

from dynamics.vehicle import Vehicle
from dynamics.vehicle_file import read_vehicle, with_settings
from runtime.control.adaptation_settings import AdaptationSettings
from runtime.control.controller import Controller, ControllerOptions
from runtime.flight.consistent_heading import ConsistentHeading
from runtime.flight.decision import FlyerSettings
from runtime.flight.events import Event
from runtime.flight.motion import Transfer
from runtime.flight.phases import Phase
from runtime.link.estimate import StateEstimate
from runtime.replay import replay
from tests.runtime.test_replay import record, reference_of
from tests.support.rate_controlled_vehicle import Flight, Story
from tests.support.tick_in_c import FlightInC
from vehicles import FOLDER


def drawn(vehicle: Vehicle, seed: int) -> tuple[FlightInC, Transfer]:
    """A transfer between two places, over an estimate with noise and a vehicle whose thrust is off."""
    random = np.random.default_rng(seed)
    places = random.uniform((-1.5, -1.5, 1.2, -1.0), (1.5, 1.5, 1.8, 1.0), (2, 4))
    reference = Transfer(vehicle, *places, random.uniform(2.0, 4.0))
    adaptation = AdaptationSettings(mode="on" if random.random() < 0.5 else "off")
    controller = Controller.build(vehicle, ControllerOptions.for_vehicle(vehicle, adaptation=adaptation))
    flight = FlightInC(vehicle, controller, reference, effectiveness=random.uniform(0.85, 1.15))
    noise = random.uniform(0.0, 1.0) * np.repeat((0.002, 0.02, 0.005), 3)
    flight.estimate_error = lambda time: noise * random.standard_normal(9)
    return flight, reference


def check(flight: FlightInC, reference: Transfer, vehicle: Vehicle, controller: Controller, folder: Path) -> None:
    story = flight.run(11.0)
    assert flight.answered > 500
    assert not flight.differing
    assert sum(observation.answered for observation, _ in story.observations) == flight.answered
    assert replay(record(story, controller, folder), vehicle, reference).exact


def setpoints_of(story: Story) -> list[tuple[float, ...]]:
    sent = [(decision.rate_body, decision.thrust) for decision in story.decisions]
    return [(*rate.tolist(), thrust) for rate, thrust in sent if rate is not None]


@pytest.mark.parametrize("seed", range(3))
def test_a_flight_answered_in_c_replays_in_python_bit_for_bit(seed: int, arpl_250g: Vehicle, tmp_path: Path) -> None:
    flight, reference = drawn(arpl_250g, seed)
    check(flight, reference, arpl_250g, flight.flyer.controllers.main, tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3, 100))
def test_a_hundred_flights_answered_in_c_replay_in_python(seed: int, arpl_250g: Vehicle, tmp_path: Path) -> None:
    flight, reference = drawn(arpl_250g, seed)
    check(flight, reference, arpl_250g, flight.flyer.controllers.main, tmp_path)


def test_a_flight_with_growing_intervals_replays_bit_for_bit(arpl_250g: Vehicle, tmp_path: Path) -> None:
    vehicle = with_settings(arpl_250g, ["controller.nodes=14", "controller.growth=1.06"])
    flight, reference = drawn(vehicle, 0)
    check(flight, reference, vehicle, flight.flyer.controllers.main, tmp_path)


def test_a_model_whose_rotors_lag_is_answered_as_python_does(tmp_path: Path) -> None:
    vehicle = read_vehicle(FOLDER / "px4_sih.toml")
    controller = Controller.build(vehicle)
    assert controller.model.hidden_count > 0
    reference = reference_of(vehicle)
    check(FlightInC(vehicle, controller, reference), reference, vehicle, controller, tmp_path)


def test_c_and_python_fly_the_same_flight(arpl_250g: Vehicle) -> None:
    """Answered in C or not: as long as nothing but estimates is new, all setpoints of the flight are the same bits."""
    reference = reference_of(arpl_250g)
    stories = [
        kind(arpl_250g, Controller.build(arpl_250g), reference).run(11.0) for kind in (Flight, FlightInC)
    ]  # fmt: skip
    assert setpoints_of(stories[0]) == setpoints_of(stories[1])
    assert stories[0].phases == stories[1].phases


def test_setpoints_that_must_not_be_the_last_ones_are_replaced_in_c_as_in_python(
    arpl_250g: Vehicle, tmp_path: Path
) -> None:
    limits = msgspec.structs.replace(arpl_250g.limits, box=((-2.5, -2.5, -1.0), (2.5, 2.5, 3.0)))
    vehicle = msgspec.structs.replace(arpl_250g, limits=limits)
    settings = FlyerSettings(last_setpoint="replace")
    stories = []
    for kind in (Flight, FlightInC):
        controller = Controller.build(vehicle)
        flight = kind(vehicle, controller, reference_of(vehicle), settings=settings)
        stories.append(flight.run(11.0))
    assert setpoints_of(stories[0]) == setpoints_of(stories[1])
    assert Event.LAST_SETPOINT_REPLACED in stories[1].raised
    assert isinstance(flight, FlightInC)
    assert flight.answered > 500
    assert not flight.differing
    recording = record(stories[1], controller, tmp_path, settings=settings)
    assert replay(recording, vehicle, reference_of(vehicle)).exact


def test_a_heading_that_turns_in_an_answered_tick_is_corrected_from_the_next_on(
    arpl_250g: Vehicle, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    controller, reference = Controller.build(arpl_250g), reference_of(arpl_250g)
    flight = FlightInC(arpl_250g, controller, reference)
    flight.run(30.0, until=Phase.TRACK)
    moment = flight.time + 0.5

    def learn(heading: ConsistentHeading, before: StateEstimate, now: StateEstimate, force: np.ndarray) -> None:
        if before.time < moment <= now.time:
            heading._turn(0.6)

    monkeypatch.setattr(ConsistentHeading, "_learn", learn)
    story = flight.run(20.0)
    raised = next(change.time for change in story.event_changes if change.event is Event.HEADING_WRONG)
    turned = story.times.index(raised)
    assert story.observations[turned][0].answered
    assert not story.observations[turned + 1][0].answered
    assert not flight.differing
    assert replay(record(story, controller, tmp_path), arpl_250g, reference).exact
