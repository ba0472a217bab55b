"""Between two ticks nothing that the link received is lost, and nothing is handed over twice."""

from __future__ import annotations

import numpy as np
import pytest

from runtime.flight.events import Event
from runtime.link.estimate import ResetStep, StateEstimate
from runtime.link.peer import Reaction
from runtime.link.rotors import RotorReader
from runtime.link.telemetry import BatterySample, ImuSample, LinkEvent, MotorOutputs, RotorSpeeds, Text
from runtime.telemetry_buffer import RATE_WINDOW, TelemetryBuffer


def reset_by(shift: tuple[float, float, float], yaw: float) -> ResetStep:
    return ResetStep(np.array(shift), np.zeros(3), yaw)


def imu(force: float) -> Reaction:
    return Reaction(telemetry=ImuSample(1.0, 1.0, (0.0, 0.0, force), (0.0, 0.0, 0.0)))


def estimate(received: float) -> Reaction:
    state = np.array([0.0] * 6 + [1.0] + [0.0] * 6)
    return Reaction(estimate=StateEstimate(received, received, state, 0, True, "ODOMETRY"))


def test_resets_between_two_ticks_add_up_and_are_handed_over_once() -> None:
    buffer = TelemetryBuffer()
    buffer.reset(reset_by((1.0, 0.0, 0.0), 0.1))
    buffer.reset(reset_by((0.5, -1.0, 0.0), 0.2))
    update = buffer.take()
    assert update.reset
    assert update.reset_position == pytest.approx([1.5, -1.0, 0.0])
    assert update.reset_yaw == pytest.approx(0.3)
    again = buffer.take()
    assert not again.reset
    assert not again.reset_position.any()


def test_only_events_with_a_consequence_reach_the_tick_and_all_are_notified() -> None:
    buffer = TelemetryBuffer()
    buffer.event(LinkEvent(1.0, "estimate_jump", "warning", "by 3 m"))
    buffer.event(LinkEvent(1.0, "landed_state", "info", "in the air"))
    assert buffer.take().events == {Event.ESTIMATE_JUMP: "by 3 m"}
    assert buffer.take().events == {}
    assert [event.name for event in buffer.notifications] == ["estimate_jump", "landed_state"]


def test_the_newest_specific_force_is_handed_over_once_and_nan_is_never_taken_for_one() -> None:
    buffer = TelemetryBuffer()
    buffer.reaction(imu(9.0))
    buffer.reaction(imu(9.5))
    buffer.reaction(imu(float("nan")))
    assert buffer.take().specific_force_body[2] == 9.5
    assert np.isnan(buffer.take().specific_force_body).all()


def test_rotor_speeds_are_handed_over_once_and_measured_ones_before_commanded_ones() -> None:
    buffer = TelemetryBuffer()
    measured = Reaction(telemetry=RotorSpeeds(1.0, 1.0, 0, (10.0, 20.0)))
    commanded = Reaction(telemetry=MotorOutputs(1.01, 1.01, "SERVO_OUTPUT_RAW", (1100.0, 1200.0)))
    buffer.reaction(measured)
    assert buffer.take().rotors is None  # nobody needs them
    buffer.rotor_reader = RotorReader((1, 0), lambda signal: 100.0 * signal)
    buffer.reaction(measured)
    buffer.reaction(commanded)
    reading = buffer.take().rotors
    assert reading is not None
    assert reading.measured
    assert reading.speed == pytest.approx([20.0, 10.0])
    assert buffer.take().rotors is None
    buffer.reaction(commanded)
    reading = buffer.take().rotors
    assert reading is not None
    assert reading.speed == pytest.approx([20.0, 10.0])


def test_an_almost_empty_battery_is_an_event_and_an_unknown_charge_is_none() -> None:
    buffer = TelemetryBuffer()
    buffer.reaction(Reaction(telemetry=BatterySample(1.0, 1.0, 14.0, 1.0, float("nan"))))
    assert buffer.take().events == {}
    buffer.reaction(Reaction(telemetry=BatterySample(1.0, 1.0, 14.0, 1.0, 0.09)))
    assert buffer.take().events == {Event.BATTERY_LOW: "9% left"}


def test_the_rate_of_estimates_is_that_of_the_last_moments() -> None:
    buffer = TelemetryBuffer()
    for tick in range(200):
        buffer.reaction(estimate(0.01 * tick))
    assert buffer.estimate_rate(1.995) == pytest.approx(100.0, abs=1 / RATE_WINDOW)
    assert buffer.estimate_rate(3.0) == 0.0


def test_texts_of_the_vehicle_wait_for_the_supervisor() -> None:
    buffer = TelemetryBuffer()
    buffer.reaction(Reaction(texts=[Text(1.0, 4, "Preflight Fail"), Text(1.0, 6, "Armed")]))
    assert list(buffer.texts) == ["Preflight Fail", "Armed"]
