"""The control thread: wait, observe, decide, send, prepare, hand the record over. Every decision is the Flyer's.

Nothing in the loop raises, logs, allocates without bound, or blocks, except for the wait that triggers the tick.
"""

from __future__ import annotations

import queue
import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from math import isnan, nan
from typing import Any

import msgspec
import numpy as np

from dynamics.state import ATTITUDE, POSITION, RATE, VELOCITY
from runtime import realtime
from runtime.flight.decision import Decision
from runtime.flight.engagement import AutopilotRequest, Transition
from runtime.flight.events import POLICIES, Event, EventChange
from runtime.flight.flyer import Flyer
from runtime.flight.tick_plan import leaves_tick
from runtime.flight.tracking import Tracking
from runtime.followed_record import followed_record
from runtime.link.estimate import StateEstimate
from runtime.link.rotors import RotorReading
from runtime.link.telemetry import VehicleStatus
from runtime.link.vehicle_link import VehicleLink
from runtime.record.recorder import Recorder
from runtime.record.records import (
    EventRecord,
    HorizonRecord,
    ObservationRecord,
    PhaseRecord,
    Record,
    ReferenceRecord,
    SetpointRecord,
    StateRecord,
    TextRecord,
    TickRecord,
)
from runtime.setpoint_stream import SetpointStream
from runtime.telemetry_buffer import LinkUpdate, TelemetryBuffer
from runtime.timing import Cause, Deadlines, Schedule, TickTimes
from runtime.urgent_tick import Sent, UrgentTick

HORIZON_EVERY = 10  # ticks between recorded horizons, and between records of what the model follows
STOP_PATIENCE = 0.6  # s in which the flight logic ends the stream after a request to stop
MAX_DEFECTS = 10  # consecutive ticks that raise, a defect of ours, after which the stream is stopped
LATE_SHARE = 0.2  # share of late ticks above which DEADLINES_MISSED is present
Notification = Transition | EventChange | str


@dataclass
class Requests:
    """Requests of the supervisor to the control thread: plain attributes, which only the supervisor's thread writes.

    engage: to take control; the one that the control thread writes as well, to clear it.
    leave: why to land, empty while no landing is requested.
    stop: to stop streaming at once, with the last setpoints that may be held.
    estimates_keep_up: whether estimates come about as often as ticks.
    slow_findings: events that the supervisor's slow checks found, with details.
    """

    engage: bool = False
    leave: str = ""
    stop: bool = False
    estimates_keep_up: bool = True
    slow_findings: Mapping[Event, str] = field(default_factory=dict)


class ControlThread:
    """Runs a Flyer on a link until the flight is over or a stop is requested.

    deadlines: latencies and late setpoints.
    tracking: errors while the reference is tracked.
    autopilot_requests: for the request worker.
    notifications: for the supervisor.
    first_setpoint: when it was sent, s, monotonic; NaN before.
    defect: the last exception of a tick, empty when there was none.
    ticks: done so far.
    answered: of them, those whose setpoint left by `alula_tick`.
    urgent: these ticks, None where all are Python's.
    stream: of setpoints, for the supervisor's watch.
    """

    def __init__(
        self,
        link: VehicleLink,
        telemetry: TelemetryBuffer,
        flyer: Flyer,
        requests: Requests,
        *,
        period: float,
        priority: int | None = None,
        processor: int | None = None,
        recorder: Recorder | None = None,
        clock: Callable[[], float] = time.monotonic,
        urgent: UrgentTick | None = None,
    ) -> None:
        """period: s. priority: of SCHED_FIFO, None for none. processor: that the thread stays on, None for any.

        clock: s; of a flight in simulated time its own.
        """
        self._clock, self._simulated = clock, clock is not time.monotonic
        # computing takes no simulated time; a system call each time would also give the processor away
        self._processor_time = clock if self._simulated else time.thread_time
        self.deadlines = Deadlines(period)
        self.tracking = Tracking()
        self.autopilot_requests: queue.SimpleQueue[AutopilotRequest] = queue.SimpleQueue()
        self.notifications: queue.SimpleQueue[Notification] = queue.SimpleQueue()
        self.first_setpoint = nan
        self.defect = ""
        self._link, self._telemetry, self._flyer, self._requests = link, telemetry, flyer, requests
        self._period, self._priority, self._processor = period, priority, processor
        self._recorder = recorder
        self._estimate: StateEstimate | None = None
        self._free = self._busy_before = self._busy_at_departure = 0.0
        self.ticks = self.answered = self._defects = 0
        self.urgent = urgent
        self._planned_findings: dict[Event, str] = {}
        self._planned_status = VehicleStatus()
        self._failed = False
        self._preparation = 0.0
        self._recorded_phase = flyer.mission.phase
        self._stop_since = float("inf")
        self.stream = SetpointStream(link, self._put, clock)
        self._thread = threading.Thread(target=self._run, name="control", daemon=True)

    def start(self) -> None:
        """Start to tick."""
        self._thread.start()

    def join(self, timeout: float) -> bool:
        """Wait for the end. timeout: s. Returns whether the thread has ended, or never started."""
        if self._thread.ident is None:
            return True
        self._thread.join(timeout)
        return not self._thread.is_alive()

    def _run(self) -> None:
        if self._priority is not None:
            for refusal in realtime.schedule_thread(self._priority, self._processor):
                self.notifications.put(f"{POLICIES[Event.REALTIME_UNAVAILABLE].text}: {refusal}")
        try:
            self._run_ticks()
        except Exception as error:  # a defect outside of the ticks ends the flight in order as well
            self.defect, self._failed = f"the control loop failed: {error!r}", True
        finally:
            self._leave()

    def _run_ticks(self) -> None:
        if self.urgent is not None and self.urgent.start():
            self._telemetry.on_change = self.stream.on_hold = self.urgent.disarm
        start = self._free = self._clock()
        schedule = Schedule(self._period, start=start)
        while not self._flyer.over and not self._stopped_for_good():
            schedule.estimates_keep_up = self._requests.estimates_keep_up
            due, by_clock = self._await(schedule)
            sent = None if self.urgent is None else self.urgent.claim()
            woken, busy = self._clock(), self._processor_time()
            if sent is not None:
                due, woken, by_clock, self._estimate = sent.estimate.received, sent.now, False, sent.estimate
            schedule.ticked(due, woken, by_clock=by_clock)
            try:
                self._fly(due, by_clock, woken, busy, sent)
                self._arm(schedule)
                self._defects = 0
            except Exception as error:  # a defect of ours must degrade the flight, not end it
                self._defects += 1
                self.defect = f"tick {self.ticks} failed: {error!r}"
                self._put(TextRecord(woken, "daemon", 3, self.defect), woken)
                if self._defects >= MAX_DEFECTS:
                    return
            self._tick_over()

    def tick(self, estimate: StateEstimate | None, now: float, *, by_clock: bool) -> None:
        """One tick of a flight in simulated time, in the caller's thread, where `start` is not called.

        estimate: the newest. now: s, simulated. A defect raises.
        """
        self._estimate = estimate
        self._fly(now, by_clock, now, now)
        self._tick_over()

    def _tick_over(self) -> None:
        self.ticks += 1
        self._busy_before = self._processor_time() - self._busy_at_departure
        self._free = self._clock()

    def _stopped_for_good(self) -> bool:
        """Whether a stop was requested so long ago that the flight logic has not ended the stream by itself."""
        if not self._requests.stop:
            return False
        self._stop_since = min(self._stop_since, self._clock())
        return self._clock() - self._stop_since > STOP_PATIENCE

    def _leave(self) -> None:
        """End a stream that the flight logic did not end: by a setpoint that may be held, and a mode that lands."""
        if self.urgent is not None:
            self.urgent.disarm()
        if self.stream.close():
            self.autopilot_requests.put(AutopilotRequest.LAND)
        if self._defects >= MAX_DEFECTS or self._failed:
            self.notifications.put(f"stopped streaming, LAND is requested: {self.defect}")

    def _await(self, schedule: Schedule) -> tuple[float, bool]:
        """Wait for what triggers the next tick. Returns when that was and whether it was the clock."""
        latest = schedule.latest
        while True:
            newest = self._link.wait_for_estimate(self._estimate, latest)
            if newest is None:
                return latest, True
            self._estimate = newest
            if schedule.is_due(newest.received):
                return newest.received, False

    def _arm(self, schedule: Schedule) -> None:
        """Let the next estimate be answered in C where the flight logic, and what is observed, leave no doubt how."""
        if self.urgent is None or (plan := self._flyer.plan()) is None or self._requests.stop or self._requests.engage:
            return
        now = self._clock()
        if self._telemetry.must_be_read or (self._requests.leave and not self._flyer.mission.landing_reason):
            return
        status, self._planned_findings = self._link.status, self._findings(now)
        if not (status.armed and status.mode == "OFFBOARD" and leaves_tick(self._planned_findings)):
            return
        self._planned_status = status
        self.urgent.arm(plan, schedule.earliest)
        newest = self._link.status
        reported = newest.armed, newest.mode, newest.landed
        if self._telemetry.must_be_read or reported != (status.armed, status.mode, status.landed):  # after the look
            self.urgent.disarm()

    def _fly(self, due: float, by_clock: bool, woken: float, busy_at_start: float, sent: Sent | None = None) -> None:
        observation = self._observe(woken, answered=sent is not None)
        estimate = self._estimate
        if sent is None:
            decision = self._flyer.step(observation, estimate)
            self.stream.send(decision)
        else:
            decision = self._take_sent(observation, sent)
        if decision.rate_body is not None:
            x, y, z = decision.rate_body.tolist()
            self._telemetry.echo.sent(self.stream.newest, (x, y, z), decision.thrust)
        if decision.rate_body is not None and isnan(self.first_setpoint):
            self.first_setpoint = self.stream.newest
        departed, self._busy_at_departure = self._clock(), self._processor_time()
        busy = self._busy_at_departure - busy_at_start
        if sent is not None:
            departed, busy, self._busy_at_departure = sent.departed, sent.busy, busy_at_start
        times = TickTimes(due, woken, departed, self._free, busy, self._busy_before, by_clock)
        cause = self.deadlines.add(times) if decision.rate_body is not None else Cause.NONE
        self._flyer.prepare(observation.time)
        self._preparation = self._clock() - departed
        self._publish(decision)
        self._record(observation, estimate, decision, times, cause)

    def _take_sent(self, observation: ObservationRecord, sent: Sent) -> Decision:
        """The flight logic's decision of a tick whose setpoint has left; that is compared with it, and counts."""
        self.answered += 1
        decision = self._flyer.step(observation, sent.estimate, sent.answer)
        if not sent.equals(decision):  # a defect of ours: what has left is what the flight goes on with
            left, decided = (sent.rate_body, sent.thrust), (decision.rate_body, decision.thrust)
            self.defect = f"tick {self.ticks}: the setpoint {left} left, the flight logic decided {decided}"
            self._put(TextRecord(observation.time, "daemon", 3, self.defect), observation.time)
            decision.rate_body, decision.thrust = sent.rate_body, sent.thrust
            decision.collective_thrust = sent.collective_thrust
        self.stream.take(decision, sent.departed)
        return decision

    def _findings(self, now: float) -> dict[Event, str]:
        """The events that this computer finds, beside those of the link's messages."""
        status, findings = self._link.status, dict(self._requests.slow_findings)
        if not self._link.is_connected(now):
            findings[Event.LINK_LOST] = f"for {now - status.last_heard:.1f} s"
        if self.deadlines.recent_share > LATE_SHARE:
            findings[Event.DEADLINES_MISSED] = f"{self.deadlines.recent_share:.0%} of the last hundred"
        follows = status.armed and status.mode == "OFFBOARD" and self.stream.open
        if other := self._telemetry.echo.finding(now, judged=follows):
            findings[Event.OTHER_CONTROLLER] = other
        return findings

    def _observe(self, now: float, *, answered: bool) -> ObservationRecord:
        """All that is known now; of a tick that was answered, what was known when it was armed, and new samples."""
        if answered:
            status, update, findings = self._planned_status, self._telemetry.take_samples(), self._planned_findings
            return self._observation(now, status, update, findings, answered=True)
        status, update = self._link.status, self._telemetry.take()
        findings = {**update.events, **self._findings(now)}
        observation = self._observation(now, status, update, findings, engage=self._requests.engage)
        self._requests.engage = False
        return observation

    def _observation(
        self,
        now: float,
        status: VehicleStatus,
        update: LinkUpdate,
        findings: Mapping[Event, str],
        *,
        engage: bool = False,
        answered: bool = False,
    ) -> ObservationRecord:
        return ObservationRecord(
            tick=self.ticks,
            time=now,
            estimate_arrival=self._estimate.received if self._estimate is not None else nan,
            connected=answered or self._link.is_connected(now),
            armed=status.armed,
            offboard=status.mode == "OFFBOARD",
            mode=status.mode,
            landed=status.landed == "on_ground",
            findings=_as_text(findings),
            reset=update.reset,
            reset_position=update.reset_position,
            reset_yaw=update.reset_yaw,
            specific_force_z=float(update.specific_force_body[2]),
            specific_force_xy=update.specific_force_body[:2],
            engage=engage,
            leave="" if answered and not self._flyer.mission.landing_reason else self._requests.leave,
            stop=not answered and self._requests.stop,
            answered=answered,
            battery_voltage=update.battery_voltage,
            **_rotor_fields(update.rotors),
        )

    def _publish(self, decision: Decision) -> None:
        for request in decision.requests:
            self.autopilot_requests.put(request)
        for transition in decision.transitions:
            self.notifications.put(transition)
        for change in decision.event_changes:
            self.notifications.put(change)

    def _record(
        self,
        observation: ObservationRecord,
        estimate: StateEstimate | None,
        decision: Decision,
        times: TickTimes,
        cause: Cause,
    ) -> None:
        flyer, now = self._flyer, observation.time
        reference = flyer.reference_now(estimate.time) if estimate is not None else None
        if reference is not None and estimate is not None:
            self.tracking.add(flyer.mission.policy, estimate, reference)
        if self._recorder is None:
            return
        self._put(observation, now)
        self._put(self._tick_record(observation, estimate, decision, times, cause), now)
        if reference is not None and estimate is not None:
            parts = (reference[POSITION], reference[VELOCITY], reference[ATTITUDE], reference[RATE])
            self._put(ReferenceRecord(estimate.time, *parts), now)
        if decision.rate_body is not None:
            numbers = (decision.collective_thrust, decision.thrust, flyer.effectiveness.value)
            self._put(SetpointRecord(now, decision.rate_body, *numbers), now)
        if flyer.horizon is not None and self.ticks % HORIZON_EVERY == 0:
            states, inputs = flyer.horizon
            x, y, z = states[:, 0].copy(), states[:, 1].copy(), states[:, 2].copy()
            self._put(HorizonRecord(now, x, y, z, np.mean(inputs, axis=1)), now)
            if (followed := followed_record(flyer, now)) is not None:
                self._put(followed, now)
        self._record_changes(decision, now)

    def _record_changes(self, decision: Decision, now: float) -> None:
        for step in decision.transitions:
            self._put(StateRecord(step.time, step.before.value, step.after.value, step.reason), now)
        for change in decision.event_changes:
            severity = int(POLICIES[change.event].severity)
            self._put(EventRecord(change.time, change.event.value, change.active, severity, change.text), now)
        phase = self._flyer.mission.phase
        if phase is not self._recorded_phase:
            self._recorded_phase = phase
            self._put(PhaseRecord(now, phase.value, self._flyer.mission.describe()), now)

    def _tick_record(
        self,
        observation: ObservationRecord,
        estimate: StateEstimate | None,
        decision: Decision,
        times: TickTimes,
        cause: Cause,
    ) -> TickRecord:
        return TickRecord(
            tick=observation.tick,
            time=observation.time,
            trigger="clock" if times.by_clock else "estimate",
            estimate_time=estimate.time if estimate is not None else nan,
            estimate_age=observation.time - estimate.time if estimate is not None else nan,
            state=self._flyer.engagement.state.value,
            phase=self._flyer.mission.phase.value,
            fallback=decision.fallback.name.lower(),
            solver_status=decision.solver_status,
            feedback_seconds=0.0 if self._simulated else decision.feedback_seconds,
            preparation_seconds=self._preparation,
            departure_seconds=times.departed - times.due if decision.rate_body is not None else nan,
            late_cause=cause.value,
            model_ratio=self._flyer.controllers.main.fit_ratio,
            model_uncertainty=self._flyer.controllers.main.uncertainty,
            network_share=self._flyer.controllers.main.network_share,
        )

    def _put(self, record: Record, now: float) -> None:
        if self._recorder is not None:
            self._recorder.put(record, now)


def _as_text(findings: Mapping[Event, str]) -> str:
    if not findings:
        return ""
    return msgspec.json.encode({event.value: text for event, text in findings.items()}).decode()


def _rotor_fields(reading: RotorReading | None) -> dict[str, Any]:
    if reading is None:
        return {}
    return {"rotor_time": reading.time, "rotor_speed": reading.speed, "rotors_measured": reading.measured}
