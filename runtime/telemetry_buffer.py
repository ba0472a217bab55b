"""The telemetry buffer: everything that the link receives between two ticks, for the control thread and the recorder.

The link's thread fills it through `callbacks`, the control thread empties it by `take`. No thread waits for another,
because only immutable objects pass from one to the other.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping
from math import isfinite, nan

import msgspec
import numpy as np

from dynamics.arrays import Floats
from runtime.flight.events import Event
from runtime.link.estimate import ResetStep, StateEstimate
from runtime.link.link import Direction, LinkCallbacks
from runtime.link.peer import Reaction
from runtime.link.rates import arrival_rate
from runtime.link.rotors import RotorReader, RotorReading
from runtime.link.setpoint_echo import SetpointEcho
from runtime.link.telemetry import BatterySample, ImuSample, LinkEvent, MotorOutputs, RotorSpeeds, Telemetry
from runtime.record.recorder import Recorder
from runtime.record.records import (
    BatteryRecord,
    EstimateRecord,
    ImuRecord,
    MotorRecord,
    Record,
    RotorRecord,
    TextRecord,
)

# events of the link that are events of the flight; all others are published and have no consequence
LINK_EVENTS: Mapping[str, Event] = {
    "estimate_not_finite": Event.INPUT_NOT_FINITE,
    "estimate_out_of_range": Event.INPUT_NOT_FINITE,
    "estimate_frame_refused": Event.INPUT_NOT_FINITE,
    "estimate_time_backwards": Event.CLOCK_BACKWARDS,
    "clock_ran_backwards": Event.CLOCK_BACKWARDS,
    "estimate_stamp_ahead": Event.STAMPS_AHEAD,
    "clock_jumped": Event.CLOCK_UNCERTAIN,
    "estimate_jump": Event.ESTIMATE_JUMP,
    "estimate_moved": Event.ESTIMATOR_RESET,
    "estimator_reset": Event.ESTIMATOR_RESET,
    "battery_low": Event.BATTERY_LOW,
}
TICK_EVENTS = frozenset((*LINK_EVENTS, "mode_changed", "disarmed", "landed_state", "link_lost", "vehicle_silent"))
SEVERITIES = {"info": 6, "warning": 4, "error": 3}
NO_SHIFT = np.zeros(3)
NO_FORCE = np.full(3, nan)
RATE_WINDOW = 0.4  # s over which the rate of estimates is measured
MIN_ARRIVALS = 5  # within that window
LOW_CHARGE = 0.1  # remaining charge, 0..1, below which BATTERY_LOW is raised


def _no_one() -> None:
    """Nobody waits for changes."""


class LinkUpdate(msgspec.Struct, frozen=True):
    """Messages since the last tick.

    events: with their details.
    reset: whether an estimator was reset, which moved its frame.
    reset_position: (3,) m, by which it moved.
    reset_yaw: rad, by which it turned.
    specific_force_body: (3,) m/s^2, the newest; NaN when there is no new one.
    rotors: their newest speeds; None when there are no new ones.
    battery_voltage: the newest, V; NaN when there is no new one.
    """

    events: dict[Event, str]
    reset: bool
    reset_position: Floats
    reset_yaw: float
    specific_force_body: Floats
    rotors: RotorReading | None = None
    battery_voltage: float = nan


class TelemetryBuffer:
    """Filled by the link's thread, emptied by the control thread and the supervisor.

    texts: the vehicle's STATUSTEXTs, for the supervisor.
    notifications: events of the link, for the supervisor.
    echo: of setpoints, for the control thread.
    rotor_reader: of the messages about motors; None where nobody needs their speeds.
    on_change: called by the link's thread for what no tick may leave out: an event of the flight, a reset, a mode.
    """

    def __init__(self, recorder: Recorder | None = None) -> None:
        self._arrivals: deque[float] = deque(maxlen=512)
        self._recorder = recorder
        self._events: deque[LinkEvent] = deque(maxlen=256)
        self._resets: deque[tuple[Floats, float]] = deque(maxlen=64)
        self._force = NO_FORCE
        self._rotors: RotorReading | None = None
        self._voltage = nan
        self.echo = SetpointEcho()
        self.on_change: Callable[[], None] = _no_one
        self.rotor_reader: RotorReader | None = None
        self.texts: deque[str] = deque(maxlen=64)
        self.notifications: deque[LinkEvent] = deque(maxlen=256)

    @property
    def callbacks(self) -> LinkCallbacks:
        """Callbacks for the link."""
        return LinkCallbacks(frame=self.frame, reset=self.reset, reaction=self.reaction, event=self.event)

    def frame(self, direction: Direction, time: float, data: bytes) -> None:
        """A raw frame of either direction."""
        if self._recorder is not None:
            self._recorder.put_frame(data, time)

    def event(self, event: LinkEvent) -> None:
        """An event of the link."""
        self._events.append(event)
        if event.name in TICK_EVENTS:
            self.on_change()
        self.notifications.append(event)
        self._put(TextRecord(event.time, "link", SEVERITIES[event.severity], f"{event.name}: {event.text}"), event.time)

    def reset(self, step: ResetStep) -> None:
        """An estimator reset; called before the estimate that it moved."""
        self.on_change()
        self._resets.append((step.position_world, step.yaw))

    def reaction(self, reaction: Reaction) -> None:
        """The consequences of one message."""
        if reaction.estimate is not None:
            self._estimate(reaction.estimate)
        if reaction.telemetry is not None:
            self._telemetry(reaction.telemetry)
        if reaction.setpoint is not None:
            self.echo.report(reaction.setpoint)
        for text in reaction.texts:
            self.texts.append(text.text)
            self._put(TextRecord(text.received, "vehicle", text.severity, text.text), text.received)

    def estimate_rate(self, now: float) -> float:
        """Estimates per second over the last RATE_WINDOW seconds; 0 while there are too few to tell."""
        times = [arrival for arrival in tuple(self._arrivals) if arrival > now - RATE_WINDOW]
        return arrival_rate(times, now) if len(times) >= MIN_ARRIVALS else 0.0

    @property
    def must_be_read(self) -> bool:
        """Whether there are events of the flight, or resets of the estimator, that nobody has taken."""
        return bool(self._resets) or any(event.name in LINK_EVENTS for event in tuple(self._events))

    def take_samples(self) -> LinkUpdate:
        """Messages received since the last call, without events and resets, which the next `take` has."""
        force, self._force = self._force, NO_FORCE
        rotors, self._rotors = self._rotors, None
        voltage, self._voltage = self._voltage, nan
        return LinkUpdate({}, False, NO_SHIFT, 0.0, force, rotors, voltage)

    def take(self) -> LinkUpdate:
        """Messages received since the last call."""
        events: dict[Event, str] = {}
        while self._events:
            event = self._events.popleft()
            if event.name in LINK_EVENTS:
                events[LINK_EVENTS[event.name]] = event.text
        reset, position, yaw = bool(self._resets), NO_SHIFT, 0.0
        while self._resets:
            shift, turn = self._resets.popleft()
            position, yaw = position + shift, yaw + turn
        return msgspec.structs.replace(
            self.take_samples(), events=events, reset=reset, reset_position=position, reset_yaw=yaw
        )

    def _estimate(self, estimate: StateEstimate) -> None:
        self._arrivals.append(estimate.received)
        record = EstimateRecord(
            estimate.time,
            estimate.received,
            estimate.position_world,
            estimate.velocity_world,
            estimate.attitude,
            estimate.rate_body,
            estimate.reset_counter,
        )
        self._put(record, estimate.received)

    def _telemetry(self, sample: Telemetry) -> None:
        match sample:
            case ImuSample():
                force, rate = np.array(sample.specific_force_body), np.array(sample.rate_body)
                if isfinite(force.sum()):
                    self._force = force
                self._put(ImuRecord(sample.time, force, rate), sample.received)
            case RotorSpeeds():
                self._read_rotors(sample)
                self._put(RotorRecord(sample.time, sample.first, np.array(sample.speed)), sample.received)
            case MotorOutputs(source="SERVO_OUTPUT_RAW"):
                self._read_rotors(sample)
                self._put(MotorRecord(sample.time, np.array(sample.value)), sample.received)
            case BatterySample():
                charge = (sample.voltage, sample.current, sample.remaining)
                self._voltage = sample.voltage
                self._put(BatteryRecord(sample.received, *charge), sample.received)
                if sample.remaining < LOW_CHARGE:
                    self.on_change()
                    self._events.append(
                        LinkEvent(sample.received, "battery_low", "error", f"{sample.remaining:.0%} left")
                    )
            case _:
                pass

    def _read_rotors(self, sample: RotorSpeeds | MotorOutputs) -> None:
        if self.rotor_reader is None or (reading := self.rotor_reader.read(sample)) is None:
            return
        waiting = self._rotors
        if waiting is None or reading.measured or not waiting.measured:
            self._rotors = reading

    def _put(self, record: Record, time: float) -> None:
        if self._recorder is not None:
            self._recorder.put(record, time)
