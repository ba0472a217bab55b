"""The control thread ticks by estimates or by the clock, and a defect degrades a flight before it ends the stream."""

from __future__ import annotations

import time
from typing import Any

import numpy as np
import pytest

from runtime.control_thread import MAX_DEFECTS, ControlThread, Requests
from runtime.flight.decision import Decision
from runtime.flight.engagement import AutopilotRequest, State
from runtime.flight.events import Event
from runtime.flight.phases import PHASES, Phase
from runtime.link.estimate import StateEstimate
from runtime.link.telemetry import LinkEvent, VehicleStatus
from runtime.record.records import ObservationRecord, Record, SetpointRecord, TextRecord, TickRecord
from runtime.telemetry_buffer import TelemetryBuffer
from tests.support.deadline import wait_until

pytestmark = pytest.mark.realtime

PERIOD = 0.01


class SilentLink:
    """A link to a vehicle that is heard but sends no estimate."""

    def __init__(self) -> None:
        self.status = VehicleStatus(system=1, component=1, mode="HOLD")
        self.setpoints: list[tuple[tuple[float, float, float], float]] = []

    def is_connected(self, now: float) -> bool:
        return True

    def wait_for_estimate(self, newer_than: StateEstimate | None, deadline: float) -> StateEstimate | None:
        time.sleep(max(0.0, deadline - time.monotonic()))
        return None

    def send_rate_setpoint(self, rate_body: tuple[float, float, float], thrust: float) -> bool:
        self.setpoints.append((rate_body, thrust))
        return True


class ScriptedFlyer:
    """Flight logic that always decides the same, or raises; over after a number of ticks."""

    horizon = None

    def __init__(self, decision: Decision, *, ticks: int = 1000, defects: int = 0) -> None:
        self.decision, self.ticks, self.defects = decision, ticks, defects
        self.observations: list[ObservationRecord] = []
        self.engagement: Any = type("Engagement", (), {"state": State.STANDBY})
        self.mission: Any = type("Mission", (), {"phase": Phase.GROUND, "policy": PHASES[Phase.GROUND]})
        quality = dict.fromkeys(("fit_ratio", "uncertainty", "network_share"), float("nan"))
        self.controllers: Any = type("Controllers", (), {"main": type("Main", (), quality), "adaptation": None})
        self.effectiveness: Any = type("Effectiveness", (), {"value": 1.0})

    @property
    def over(self) -> bool:
        return len(self.observations) >= self.ticks

    def step(self, observation: ObservationRecord, estimate: StateEstimate | None) -> Decision:
        self.observations.append(observation)
        if self.defects > 0:
            self.defects -= 1
            raise ZeroDivisionError("planted")
        return self.decision

    def prepare(self, time: float) -> None:
        pass

    def reference_now(self, time: float) -> None:
        return None


class ListRecorder:
    """A recorder into a list."""

    def __init__(self) -> None:
        self.records: list[Record] = []

    def put(self, record: Record, time_monotonic: float) -> None:
        self.records.append(record)


def control_thread(
    flyer: ScriptedFlyer, link: SilentLink, requests: Requests | None = None, recorder: ListRecorder | None = None
) -> ControlThread:
    buffer = TelemetryBuffer()
    buffer.event(LinkEvent(1.0, "estimate_jump", "warning", "by 3 m"))
    requests = requests or Requests()
    return ControlThread(link, buffer, flyer, requests, period=PERIOD, recorder=recorder)  # type: ignore[arg-type]


def hovering() -> Decision:
    rates = np.array([0.1, 0.2, 0.3])
    return Decision(rate_body=rates, thrust=0.5, held_thrust=0.5, requests=(AutopilotRequest.ARM,))


def test_without_estimates_the_clock_ticks_and_every_decision_is_sent() -> None:
    flyer, link = ScriptedFlyer(hovering(), ticks=20), SilentLink()
    control = control_thread(flyer, link)
    control.start()
    assert control.join(10.0)
    assert link.setpoints[:20] == [((0.1, 0.2, 0.3), 0.5)] * 20
    assert set(link.setpoints[20:]) == {((0.0, 0.0, 0.0), 0.5)}  # this logic never ends its stream
    assert control.deadlines.by_clock == 20
    assert control.autopilot_requests.qsize() == 21
    assert control.first_setpoint < time.monotonic()


def test_a_request_to_engage_reaches_exactly_one_tick_and_events_of_the_link_too() -> None:
    flyer = ScriptedFlyer(Decision(), ticks=5)
    control = control_thread(flyer, SilentLink(), Requests(engage=True, slow_findings={Event.RATES_LOW: "12 Hz"}))
    control.start()
    assert control.join(10.0)
    assert [observation.engage for observation in flyer.observations] == [True, False, False, False, False]
    assert ["estimate_jump" in observation.findings for observation in flyer.observations] == [True] + [False] * 4
    assert all("rates_low" in observation.findings for observation in flyer.observations)


def test_a_stop_ends_the_stream_at_once() -> None:
    flyer, link, requests = ScriptedFlyer(hovering()), SilentLink(), Requests()
    control = control_thread(flyer, link, requests)
    control.start()
    wait_until(lambda: link.setpoints)
    requests.stop = True
    assert control.join(10.0)
    assert len(link.setpoints) < 1000


def test_a_few_defects_are_survived_and_named() -> None:
    flyer, link = ScriptedFlyer(hovering(), ticks=MAX_DEFECTS + 5, defects=MAX_DEFECTS - 1), SilentLink()
    control = control_thread(flyer, link)
    control.start()
    assert control.join(10.0)
    assert link.setpoints[:6] == [((0.1, 0.2, 0.3), 0.5)] * 6
    assert ((0.1, 0.2, 0.3), 0.5) not in link.setpoints[6:]
    assert "planted" in control.defect


class DyingLink(SilentLink):
    """A link whose wait for estimates fails after some ticks, outside of what a tick survives."""

    def wait_for_estimate(self, newer_than: StateEstimate | None, deadline: float) -> StateEstimate | None:
        if len(self.setpoints) >= 10:
            raise MemoryError("planted")
        return super().wait_for_estimate(newer_than, deadline)


class FailingFlyer(ScriptedFlyer):
    """Flight logic that decides the same for some ticks and raises in every one after them."""

    def step(self, observation: ObservationRecord, estimate: StateEstimate | None) -> Decision:
        decision = super().step(observation, estimate)
        if len(self.observations) > 10:
            raise ZeroDivisionError("planted")
        return decision


def turning() -> Decision:
    return Decision(rate_body=np.array([0.0, 4.5, 0.0]), thrust=0.3, held_thrust=0.55)


@pytest.mark.parametrize("cause", ["dies", "raises", "stop"])
def test_whatever_ends_the_thread_the_last_setpoint_can_be_held(cause: str) -> None:
    link = DyingLink() if cause == "dies" else SilentLink()
    flyer = FailingFlyer(turning()) if cause == "raises" else ScriptedFlyer(turning())
    requests, recorder = Requests(), ListRecorder()
    control = control_thread(flyer, link, requests, recorder)
    control.start()
    wait_until(lambda: len(link.setpoints) >= 10)
    requests.stop = cause == "stop"
    assert control.join(10.0)
    assert link.setpoints[-3:] == [((0.0, 0.0, 0.0), 0.55)] * 3
    assert control.autopilot_requests.get_nowait() is AutopilotRequest.LAND
    recorded = [record for record in recorder.records if isinstance(record, SetpointRecord)]
    assert recorded[-1].thrust == 0.55
    assert cause == "stop" or "planted" in control.defect


def test_a_stream_that_the_flight_logic_has_ended_is_not_ended_again() -> None:
    class Ending(ScriptedFlyer):
        def step(self, observation: ObservationRecord, estimate: StateEstimate | None) -> Decision:
            decision = super().step(observation, estimate)
            return decision if len(self.observations) < 10 else Decision()

    flyer, link = Ending(turning(), ticks=20), SilentLink()
    control = control_thread(flyer, link)
    control.start()
    assert control.join(10.0)
    assert link.setpoints == [((0.0, 4.5, 0.0), 0.3)] * 9
    assert control.autopilot_requests.empty()


def test_defects_without_end_stop_the_stream_with_a_notification() -> None:
    flyer, link = ScriptedFlyer(hovering(), defects=1000), SilentLink()
    control = control_thread(flyer, link)
    control.start()
    assert control.join(10.0)
    assert link.setpoints == []
    assert len(flyer.observations) == MAX_DEFECTS
    assert "stopped streaming" in str(control.notifications.get_nowait())


@pytest.mark.parametrize("decision", [Decision(), hovering()])
def test_only_setpoints_that_were_sent_are_late(decision: Decision) -> None:
    flyer = ScriptedFlyer(decision, ticks=5)
    control = control_thread(flyer, SilentLink())
    control.start()
    assert control.join(10.0)
    assert control.deadlines.ticks == (5 if decision.rate_body is not None else 0)


def test_every_tick_is_recorded_with_its_setpoint() -> None:
    flyer, recorder = ScriptedFlyer(hovering(), ticks=10), ListRecorder()
    control = control_thread(flyer, SilentLink(), recorder=recorder)
    control.start()
    assert control.join(10.0)
    ticks = [record for record in recorder.records if isinstance(record, TickRecord)]
    assert [tick.tick for tick in ticks] == list(range(10))
    assert {tick.trigger for tick in ticks} == {"clock"}
    setpoints = [record for record in recorder.records if isinstance(record, SetpointRecord)]
    assert [record.time for record in setpoints[:10]] == [tick.time for tick in ticks]
    assert [record.thrust for record in setpoints[:10]] == [0.5] * 10


def test_a_defect_is_recorded_once_and_its_tick_counts() -> None:
    flyer, recorder = ScriptedFlyer(hovering(), ticks=10, defects=1), ListRecorder()
    control = control_thread(flyer, SilentLink(), recorder=recorder)
    control.start()
    assert control.join(10.0)
    texts = [record.text for record in recorder.records if isinstance(record, TextRecord)]
    assert texts == ["tick 0 failed: ZeroDivisionError('planted')"]
    assert [observation.tick for observation in flyer.observations] == list(range(10))
    assert [record.tick for record in recorder.records if isinstance(record, TickRecord)] == list(range(1, 10))
