"""A recorded flight comes out of the flight logic again exactly, and a changed vehicle is noticed."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
import pytest

from dynamics.errors import DataError
from dynamics.vehicle import Vehicle
from runtime.control.adaptation_settings import AdaptationSettings
from runtime.control.controller import Controller, ControllerOptions
from runtime.flight.decision import FlyerSettings
from runtime.flight.mission import Plan
from runtime.flight.motion import Transfer
from runtime.record.parts import parts_of
from runtime.record.recorder import Recorder
from runtime.record.recording import FlightRecording, read_recording
from runtime.record.records import EstimateRecord, SetpointRecord, StateRecord
from runtime.replay import replay
from tests.support.rate_controlled_vehicle import Flight, Story


def reference_of(vehicle: Vehicle) -> Transfer:
    return Transfer(vehicle, np.array([1.0, 0.0, 1.5, 0.0]), np.array([-1.0, 0.5, 1.5, 0.5]), 3.0)


@pytest.fixture(scope="module")
def recording(arpl_250g: Vehicle, tmp_path_factory: pytest.TempPathFactory) -> FlightRecording:
    return recorded(arpl_250g, Controller.build(arpl_250g), tmp_path_factory.mktemp("replay"))


def recorded(
    arpl_250g: Vehicle,
    controller: Controller,
    folder: Path,
    *,
    max_bytes: int | None = None,
    settings: FlyerSettings | None = None,
) -> FlightRecording:
    flight = Flight(arpl_250g, controller, reference_of(arpl_250g), settings=settings)
    return record(flight.run(11.0), controller, folder, max_bytes=max_bytes, settings=settings)


def record(
    story: Story,
    controller: Controller,
    folder: Path,
    *,
    max_bytes: int | None = None,
    settings: FlyerSettings | None = None,
) -> FlightRecording:
    metadata = {
        "plan": msgspec.json.encode(Plan()).decode(),
        "settings": msgspec.json.encode(settings or FlyerSettings()).decode(),
        "controller": msgspec.json.encode(controller.options).decode(),
    }
    recorder = Recorder(folder, "flight", metadata=metadata, capacity=100_000, simulated_epoch=0.0, max_bytes=max_bytes)
    for (observation, estimate), decision in zip(story.observations, story.decisions, strict=True):
        assert estimate is not None
        parts = (estimate.position_world, estimate.velocity_world, estimate.attitude, estimate.rate_body)
        recorder.put(EstimateRecord(estimate.time, estimate.received, *parts, 0), observation.time)
        recorder.put(observation, observation.time)
        if decision.rate_body is not None:
            setpoint = SetpointRecord(
                observation.time, decision.rate_body, decision.collective_thrust, decision.thrust, 1.0
            )
            recorder.put(setpoint, observation.time)
        for step in decision.transitions:
            recorder.put(StateRecord(step.time, step.before.value, step.after.value, step.reason), observation.time)
    recorder.close()
    return read_recording(recorder.path)


def test_the_same_flight_comes_out_bit_for_bit(recording: FlightRecording, arpl_250g: Vehicle) -> None:
    report = replay(recording, arpl_250g, reference_of(arpl_250g))
    assert report.exact
    assert report.compared > 500
    assert report.lost == 0
    assert report.first_difference is None


def test_a_model_that_followed_follows_again(arpl_250g: Vehicle, tmp_path: Path) -> None:
    adaptation = AdaptationSettings(mode="on", follow=("rotor_drag",))
    options = ControllerOptions.for_vehicle(arpl_250g, adaptation=adaptation)
    controller = Controller.build(arpl_250g, options)
    recording = recorded(arpl_250g, controller, tmp_path)
    assert controller.adaptation is not None
    assert np.abs(controller.adaptation.followed.disturbance).max() > 0.0
    assert replay(recording, arpl_250g, reference_of(arpl_250g)).exact


def test_setpoints_that_were_replaced_are_replaced_again(arpl_250g: Vehicle, tmp_path: Path) -> None:
    """A check of setpoints that may be the last ones depends on what the recording has, and on nothing else."""
    limits = msgspec.structs.replace(arpl_250g.limits, box=((-2.5, -2.5, -1.0), (2.5, 2.5, 3.0)))
    vehicle = msgspec.structs.replace(arpl_250g, limits=limits)
    flown = recorded(vehicle, Controller.build(vehicle), tmp_path, settings=FlyerSettings(last_setpoint="replace"))
    assert replay(flown, vehicle, reference_of(vehicle)).exact
    unchecked = {**flown.metadata, "settings": msgspec.json.encode(FlyerSettings()).decode()}
    assert not replay(replace(flown, metadata=unchecked), vehicle, reference_of(vehicle)).exact


def test_a_recording_of_another_version_may_word_its_reasons_differently(
    recording: FlightRecording, arpl_250g: Vehicle
) -> None:
    rows = [{**row, "reason": "worded otherwise"} for row in recording.messages["/state"]]
    older = replace(recording, messages={**recording.messages, "/state": rows})
    assert replay(older, arpl_250g, reference_of(arpl_250g)).exact
    shorter = replace(recording, messages={**recording.messages, "/state": rows[:-1]})
    assert not replay(shorter, arpl_250g, reference_of(arpl_250g)).states_agree


def test_another_vehicle_flies_differently(recording: FlightRecording, arpl_250g: Vehicle) -> None:
    heavier = msgspec.structs.replace(arpl_250g, body=msgspec.structs.replace(arpl_250g.body, mass=0.3))
    report = replay(recording, heavier, reference_of(heavier))
    assert not report.exact
    assert report.thrust_difference > 0.01
    assert report.first_difference is not None


def test_a_recording_without_a_flight_is_refused_with_the_reason(tmp_path: Path, arpl_250g: Vehicle) -> None:
    Recorder(tmp_path, "empty", metadata={"seed": "1"}).close()
    with pytest.raises(DataError, match="lacks the settings plan, settings, controller"):
        replay(read_recording(tmp_path / "empty.mcap"), arpl_250g, reference_of(arpl_250g))


def test_a_flight_in_parts_comes_out_exactly_while_all_are_there_and_is_refused_without_the_first(
    arpl_250g: Vehicle, tmp_path: Path
) -> None:
    recording = recorded(arpl_250g, Controller.build(arpl_250g), tmp_path, max_bytes=1_000_000)
    parts = parts_of(recording.path)
    assert len(parts) > 1
    assert replay(recording, arpl_250g, reference_of(arpl_250g)).exact
    parts[1].unlink()
    with pytest.raises(DataError, match=r"before part 2 are not there, as --record-limit removes them"):
        replay(read_recording(recording.path), arpl_250g, reference_of(arpl_250g))
