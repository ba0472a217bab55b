"""The named events of a flight and what each one leads to.

Each check returns the events that are present, with details; `EventMonitor` turns them into events raised and cleared,
and into the fallback that they require. The table below is the whole policy.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import Enum, IntEnum


class Fallback(IntEnum):
    """Setpoint in place of a fresh solution, in the order of escalation."""

    NONE = 0
    SHIFTED_SOLUTION = 1
    NOMINAL_MODEL = 2
    LEVEL_HOLD = 3
    STOP_STREAMING = 4


class Severity(IntEnum):
    """Severities of events, with MAVLink's numbers (MAV_SEVERITY)."""

    CRITICAL = 2
    ERROR = 3
    WARNING = 4
    NOTICE = 5
    INFO = 6


class Event(Enum):
    """Every event of a flight."""

    ESTIMATE_STALE = "estimate_stale"
    ESTIMATE_FROZEN = "estimate_frozen"
    ESTIMATE_JUMP = "estimate_jump"
    ESTIMATOR_RESET = "estimator_reset"
    ESTIMATOR_DEGRADED = "estimator_degraded"
    ESTIMATOR_REJECTS = "estimator_rejects"
    HEADING_WRONG = "heading_wrong"
    INPUT_NOT_FINITE = "input_not_finite"
    SOLVER_FAILED = "solver_failed"
    SOLVER_CUT = "solver_cut"
    DEADLINES_MISSED = "deadlines_missed"
    CLOCK_UNCERTAIN = "clock_uncertain"
    CLOCK_BACKWARDS = "clock_backwards"
    STAMPS_AHEAD = "stamps_ahead"
    LINK_LOST = "link_lost"
    SETPOINT_REFUSED = "setpoint_refused"
    OTHER_CONTROLLER = "other_controller"
    HOST_STALLED = "host_stalled"
    HOST_STARVED = "host_starved"
    LINK_JITTER = "link_jitter"
    LINK_UNSTEADY = "link_unsteady"
    DISARMED = "disarmed"
    MODE_CHANGED = "mode_changed"
    THRUST_LIMIT = "thrust_limit"
    THRUST_LOST = "thrust_lost"
    TAKEOFF_FAILED = "takeoff_failed"
    NOT_UPRIGHT = "not_upright"
    TIPPING = "tipping"
    IMPACT = "impact"
    GROUND_CONTACT = "ground_contact"
    OVERTURNED = "overturned"
    HELD = "held"
    TRACKING_LOST = "tracking_lost"
    CONTACT_LOST = "contact_lost"
    CRASHED = "crashed"
    GEOFENCE = "geofence"
    GEOFENCE_LEFT = "geofence_left"
    MODEL_UNHEALTHY = "model_unhealthy"
    MODEL_OSCILLATES = "model_oscillates"
    MODEL_OUTSIDE = "model_outside"
    MODEL_WAITING = "model_waiting"
    MODEL_CHANGED = "model_changed"
    ADAPTATION_REFUSED = "adaptation_refused"
    PUSHED = "pushed"
    ROTOR_WEAK = "rotor_weak"
    ROTOR_FAILING = "rotor_failing"
    RATES_LOW = "rates_low"
    BATTERY_LOW = "battery_low"
    RECORDER_OVERRUN = "recorder_overrun"
    DISK_FULL = "disk_full"
    REFERENCE_INFEASIBLE = "reference_infeasible"
    LAST_SETPOINT_REPLACED = "last_setpoint_replaced"
    LAST_SETPOINT_UNSAFE = "last_setpoint_unsafe"
    LAST_SETPOINT_UNCHECKED = "last_setpoint_unchecked"
    REALTIME_UNAVAILABLE = "realtime_unavailable"


@dataclass(frozen=True)
class Policy:
    """Consequence of an event.

    text: for a log, a STATUSTEXT or a screen.
    fallback: the mildest that may be flown while the event is active.
    onset: s of presence before it is raised.
    clear_after: s of absence before it clears; infinite: it clears only when control is taken again.
    refuses: whether engaging is refused while it is active.
    lands: whether the mission is cut short by a landing.
    sinks: whether that landing goes straight down, level and with the thrust that there is.
    probes: whether thrust is reduced in flight to find out if the ground carries the vehicle already.
    """

    text: str
    severity: Severity
    fallback: Fallback = Fallback.NONE
    onset: float = 0.0
    clear_after: float = 1.0
    refuses: bool = False
    lands: bool = False
    sinks: bool = False
    probes: bool = False


NEVER = math.inf

POLICIES: Mapping[Event, Policy] = {
    Event.ESTIMATE_STALE: Policy(
        "no fresh estimate", Severity.WARNING, Fallback.SHIFTED_SOLUTION, clear_after=0.05, refuses=True
    ),
    Event.ESTIMATE_FROZEN: Policy(
        "the estimate is frozen", Severity.ERROR, Fallback.SHIFTED_SOLUTION, clear_after=0.05, refuses=True
    ),
    Event.ESTIMATE_JUMP: Policy(
        "the estimate jumped", Severity.WARNING, Fallback.SHIFTED_SOLUTION, clear_after=0.1, refuses=True
    ),
    Event.ESTIMATOR_RESET: Policy("the estimator was reset, the reference follows it", Severity.NOTICE),
    Event.ESTIMATOR_DEGRADED: Policy(
        "the estimator does not vouch for its estimate", Severity.ERROR, onset=0.5, clear_after=NEVER, lands=True
    ),
    Event.ESTIMATOR_REJECTS: Policy("the estimator rejects measurements", Severity.WARNING, onset=1.0),
    Event.HEADING_WRONG: Policy(
        "the estimated heading does not fit the motion, it is corrected", Severity.ERROR, clear_after=NEVER, lands=True
    ),
    Event.INPUT_NOT_FINITE: Policy(
        "the estimate is unusable", Severity.ERROR, Fallback.SHIFTED_SOLUTION, clear_after=0.05, refuses=True
    ),
    Event.SOLVER_FAILED: Policy("the solver failed", Severity.ERROR, Fallback.SHIFTED_SOLUTION, clear_after=0.05),
    Event.SOLVER_CUT: Policy("the solver was cut short, inputs keep their limits", Severity.NOTICE),
    Event.DEADLINES_MISSED: Policy("ticks are late", Severity.WARNING, Fallback.NOMINAL_MODEL, onset=0.5),
    Event.CLOCK_UNCERTAIN: Policy("the vehicle's clock is uncertain", Severity.WARNING, clear_after=0.1, refuses=True),
    Event.CLOCK_BACKWARDS: Policy(
        "the vehicle's clock ran backwards", Severity.ERROR, Fallback.SHIFTED_SOLUTION, clear_after=0.1, refuses=True
    ),
    # the link says so once a second
    Event.STAMPS_AHEAD: Policy("estimates are stamped in the future", Severity.ERROR, clear_after=1.5, refuses=True),
    Event.LINK_LOST: Policy(
        "nothing arrives from the vehicle", Severity.CRITICAL, Fallback.STOP_STREAMING, refuses=True
    ),
    Event.SETPOINT_REFUSED: Policy(
        "the vehicle does not act on setpoints", Severity.CRITICAL, Fallback.STOP_STREAMING, clear_after=NEVER
    ),
    # present from the first sign on: a mode that somebody changed shows in a HEARTBEAT within a second
    Event.OTHER_CONTROLLER: Policy(
        "another controller commands the vehicle", Severity.CRITICAL, Fallback.STOP_STREAMING, 1.1, clear_after=NEVER
    ),
    Event.HOST_STALLED: Policy("this computer did not run the control loop", Severity.WARNING),
    Event.HOST_STARVED: Policy(
        "this computer is too busy to control the vehicle",
        Severity.CRITICAL,
        Fallback.STOP_STREAMING,
        clear_after=NEVER,
    ),
    Event.LINK_JITTER: Policy("the link delivers irregularly", Severity.WARNING, onset=0.2),
    Event.LINK_UNSTEADY: Policy(
        "the link delivers too irregularly to control the vehicle",
        Severity.CRITICAL,
        Fallback.STOP_STREAMING,
        clear_after=NEVER,
    ),
    Event.DISARMED: Policy("the vehicle disarmed", Severity.CRITICAL),
    Event.MODE_CHANGED: Policy("the vehicle left OFFBOARD", Severity.CRITICAL),
    Event.THRUST_LIMIT: Policy("thrust is at its limit", Severity.WARNING, onset=1.0),
    Event.THRUST_LOST: Policy(
        "too little thrust is left to fly on", Severity.CRITICAL, clear_after=NEVER, lands=True, sinks=True
    ),
    Event.TAKEOFF_FAILED: Policy(
        "no lift-off at the greatest take-off thrust", Severity.CRITICAL, clear_after=NEVER, lands=True
    ),
    Event.NOT_UPRIGHT: Policy("the vehicle does not stand upright", Severity.ERROR, clear_after=0.5, refuses=True),
    Event.TIPPING: Policy("the vehicle tips over at take-off", Severity.CRITICAL, clear_after=NEVER, lands=True),
    Event.IMPACT: Policy("the vehicle hit something", Severity.CRITICAL, lands=True, probes=True),
    Event.GROUND_CONTACT: Policy(
        "the ground carries the vehicle in flight", Severity.CRITICAL, lands=True, probes=True
    ),
    Event.OVERTURNED: Policy("the vehicle is overturned", Severity.CRITICAL, lands=True, probes=True),
    Event.HELD: Policy("thrust does not move the vehicle", Severity.CRITICAL, clear_after=NEVER, lands=True),
    Event.TRACKING_LOST: Policy("the vehicle left its reference", Severity.CRITICAL, clear_after=NEVER, lands=True),
    Event.CONTACT_LOST: Policy("the ground does not carry the vehicle, it is caught", Severity.NOTICE),
    Event.CRASHED: Policy("the vehicle crashed, its motors are stopped", Severity.CRITICAL, clear_after=NEVER),
    Event.GEOFENCE: Policy("at the edge of the allowed box", Severity.ERROR, clear_after=NEVER, lands=True),
    Event.GEOFENCE_LEFT: Policy(
        "outside the allowed box", Severity.CRITICAL, Fallback.STOP_STREAMING, clear_after=NEVER, refuses=True
    ),
    Event.MODEL_UNHEALTHY: Policy(
        "the learned model no longer fits", Severity.ERROR, Fallback.NOMINAL_MODEL, onset=0.5, clear_after=NEVER
    ),
    Event.MODEL_OSCILLATES: Policy(
        "the learned model makes the vehicle oscillate", Severity.ERROR, Fallback.NOMINAL_MODEL, clear_after=NEVER
    ),
    Event.MODEL_OUTSIDE: Policy(
        "outside of the learned model's training range", Severity.WARNING, Fallback.NOMINAL_MODEL, clear_after=0.5
    ),
    Event.MODEL_WAITING: Policy(
        "the learned model waits for its history", Severity.NOTICE, Fallback.NOMINAL_MODEL, clear_after=0.0
    ),
    Event.MODEL_CHANGED: Policy("the vehicle is not as in its file", Severity.NOTICE, onset=1.0, clear_after=5.0),
    Event.ADAPTATION_REFUSED: Policy(
        "what was estimated in flight forecasts worse than the vehicle file, which flies", Severity.WARNING, onset=0.5
    ),
    Event.PUSHED: Policy(
        "something pushes the vehicle by more than it can hold",
        Severity.CRITICAL,
        onset=1.0,
        clear_after=NEVER,
        lands=True,
    ),
    Event.ROTOR_WEAK: Policy("look at propeller and load", Severity.WARNING, clear_after=NEVER),
    Event.ROTOR_FAILING: Policy(
        "a rotor has lost too much thrust to fly on", Severity.CRITICAL, clear_after=NEVER, refuses=True, lands=True
    ),
    Event.RATES_LOW: Policy("streams are too slow", Severity.WARNING, clear_after=0.1, refuses=True),
    Event.BATTERY_LOW: Policy("the battery is low", Severity.ERROR, clear_after=NEVER, refuses=True, lands=True),
    Event.RECORDER_OVERRUN: Policy("the recorder fell behind", Severity.WARNING),
    Event.DISK_FULL: Policy("recording ended, the flight continues", Severity.ERROR, clear_after=NEVER),
    Event.REFERENCE_INFEASIBLE: Policy(
        "the vehicle cannot fly the reference", Severity.ERROR, clear_after=NEVER, refuses=True
    ),
    Event.LAST_SETPOINT_REPLACED: Policy("a setpoint that must not be the last one was replaced", Severity.NOTICE),
    Event.LAST_SETPOINT_UNSAFE: Policy("no setpoint may be the last one", Severity.WARNING),
    Event.LAST_SETPOINT_UNCHECKED: Policy(
        "setpoints that must not be the last ones are not replaced", Severity.NOTICE, clear_after=NEVER
    ),
    Event.REALTIME_UNAVAILABLE: Policy("flying without real-time scheduling", Severity.NOTICE, clear_after=NEVER),
}


def event_text(event: Event, detail: str) -> str:
    """An event in one line. detail: what the check measured."""
    return f"{POLICIES[event].text}: {detail}" if detail else POLICIES[event].text


@dataclass(frozen=True)
class EventChange:
    """An event raised or cleared.

    time: s.
    active: whether it was raised.
    detail: what the check measured.
    """

    time: float
    event: Event
    active: bool
    detail: str

    @property
    def text(self) -> str:
        """One line for a log, a STATUSTEXT or a screen."""
        return event_text(self.event, self.detail)


class EventMonitor:
    """Which events are active, from those present at each tick. Pure: time is an argument.

    counts: how often each was raised.
    """

    def __init__(self) -> None:
        self._present_since: dict[Event, float] = {}
        self._last_present: dict[Event, float] = {}
        self._active: dict[Event, str] = {}
        self.counts: dict[Event, int] = dict.fromkeys(Event, 0)

    @property
    def active(self) -> Mapping[Event, str]:
        """Active events, each with its detail when it was raised."""
        return self._active

    @property
    def fallback(self) -> Fallback:
        """The strongest fallback that an active event requires."""
        if not self._active:
            return Fallback.NONE
        return max(POLICIES[event].fallback for event in self._active)

    @property
    def reason(self) -> str:
        """Why a fallback is required, empty when none is."""
        return self._text_of(lambda policy: policy.fallback == self.fallback) if self.fallback else ""

    @property
    def refusal(self) -> str:
        """Why engaging is refused, empty when it is not."""
        return self._text_of(lambda policy: policy.refuses or policy.fallback == Fallback.STOP_STREAMING)

    @property
    def landing_reason(self) -> str:
        """Why the mission has to end with a landing, empty when it does not."""
        return self._text_of(lambda policy: policy.lands)

    @property
    def sinks(self) -> bool:
        """Whether an active event requires to land straight down."""
        return any(POLICIES[event].sinks for event in self._active)

    def update(self, present: Mapping[Event, str], time: float) -> tuple[EventChange, ...]:
        """Take the events present at one tick, with details. Returns what was raised and cleared."""
        if not present and not self._active and not self._present_since:
            return ()  # the usual case in flight, kept cheap
        raised = []
        for event, detail in present.items():
            self._last_present[event] = time
            since = self._present_since.setdefault(event, time)
            if event not in self._active and time - since >= POLICIES[event].onset:
                self._active[event] = detail
                self.counts[event] += 1
                raised.append(EventChange(time, event, True, detail))
        for event in [event for event in self._present_since if event not in present]:
            del self._present_since[event]
        return (*raised, *self._clear(present, time))

    def _clear(self, present: Mapping[Event, str], time: float) -> tuple[EventChange, ...]:
        absent = [event for event in self._active if event not in present]
        expired = [event for event in absent if time - self._last_present[event] >= POLICIES[event].clear_after]
        return tuple(EventChange(time, event, False, self._active.pop(event)) for event in expired)

    def rearm(self, time: float) -> tuple[EventChange, ...]:
        """Clear what stays raised until control is taken again; what is still present is raised by the next update."""
        latched = [event for event in self._active if POLICIES[event].clear_after == NEVER]
        return tuple(EventChange(time, event, False, self._active.pop(event)) for event in latched)

    def _text_of(self, condition: Callable[[Policy], bool]) -> str:
        for event, detail in self._active.items():
            if condition(POLICIES[event]):
                return event_text(event, detail)
        return ""
