"""The daemon's states and the rules by which it takes and gives up control. Pure: facts and time in, transitions out.

The rules follow from PX4's behaviour (docs/px4.md): a mode counts when a HEARTBEAT shows it, not when a command is
acknowledged; setpoints have to be streamed before OFFBOARD is requested; and PX4 returns to OFFBOARD by itself as
soon as a stream resumes, so that nothing may be streamed unless engagement is requested.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

import msgspec

from runtime.flight.events import Fallback


class State(Enum):
    """The daemon's state towards the vehicle."""

    DISCONNECTED = "DISCONNECTED"
    STANDBY = "STANDBY"
    STREAMING = "STREAMING"
    ENGAGED = "ENGAGED"
    FALLBACK = "FALLBACK"


class AutopilotRequest(Enum):
    """Request to the autopilot."""

    OFFBOARD = "offboard"
    ARM = "arm"
    DISARM = "disarm"
    LAND = "land"


class Facts(msgspec.Struct, frozen=True):
    """The facts about vehicle and link at one instant.

    connected: whether heartbeats or estimates arrive.
    armed: as of the last HEARTBEAT.
    offboard: whether the mode is OFFBOARD.
    mode: of the last HEARTBEAT or CURRENT_MODE.
    refusal: why engaging is refused, empty when it is not.
    fallback: that the health checks require.
    reason: for the fallback.
    standstill: s for which this computer stood still lately, long enough for an autopilot's failsafe; 0 for none.
    """

    connected: bool
    armed: bool
    offboard: bool
    mode: str
    refusal: str = ""
    fallback: Fallback = Fallback.NONE
    reason: str = ""
    standstill: float = 0.0

    @property
    def mode_change(self) -> str:
        """Who has changed the mode, as far as it shows."""
        if self.standstill:
            return f"mode changed to {self.mode} after this computer stood still for {self.standstill:.1f} s"
        return f"mode changed to {self.mode}, the pilot or the autopilot took over"


@dataclass(frozen=True)
class Transition:
    """A change of state with its reason. time: s."""

    time: float
    before: State
    after: State
    reason: str

    def __str__(self) -> str:
        return f"{self.before.value} -> {self.after.value}: {self.reason}"


class EngagementSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """How control is taken; times in s.

    stream_time: of streaming before OFFBOARD is requested (PX4 documents more than 1 s).
    repeat: between requests.
    patience: until HEARTBEAT must show OFFBOARD and armed.
    pilot_patience: from OFFBOARD until the pilot must have armed, where that is left to the pilot; None: no limit.
    mode_certain: of OFFBOARD in HEARTBEAT, after which another mode is the pilot's choice.
    arm: whether to request arming, or leave it to the pilot.
    resume: whether control may be taken of a vehicle that is armed when it is first heard.
    """

    stream_time: float = 1.2
    repeat: float = 1.0
    patience: float = 8.0
    pilot_patience: float | None = None
    mode_certain: float = 1.0
    arm: bool = True
    resume: bool = False


class Engagement:
    """The state machine.

    state: the present one.
    refusal: why control was given up or not taken, empty otherwise.
    """

    def __init__(self, settings: EngagementSettings) -> None:
        self.state = State.DISCONNECTED
        self.refusal = ""
        self._settings = settings
        self._requested = self._arming = False
        self._initially_armed: bool | None = None
        self._entered = 0.0
        self._awaiting_since: float | None = None
        self._last_request = -float("inf")
        self._requests: tuple[AutopilotRequest, ...] = ()

    @property
    def streaming(self) -> bool:
        """Whether setpoints may be sent at all."""
        return self.state in (State.STREAMING, State.ENGAGED, State.FALLBACK)

    @property
    def flying(self) -> bool:
        """Whether the vehicle follows our setpoints."""
        return self.state in (State.ENGAGED, State.FALLBACK)

    @property
    def requested(self) -> bool:
        """Whether engagement is requested, and was neither refused nor ended since."""
        return self._requested

    @property
    def initially_armed(self) -> bool:
        """Whether the vehicle was armed when it was first heard."""
        return bool(self._initially_armed)

    @property
    def awaits_pilot(self) -> bool:
        """Whether all that lacks is that the pilot arms."""
        return self.state is State.STREAMING and self._awaiting_since is not None

    @property
    def requests(self) -> tuple[AutopilotRequest, ...]:
        """Requests of the last update to the autopilot."""
        return self._requests

    def engage(self) -> None:
        """Request engagement; holds until control is given up for whatever reason."""
        self._requested = True
        self.refusal = ""

    def release(self, reason: str, time: float) -> tuple[Transition, ...]:
        """Give control up on purpose: stop streaming, or withdraw the request; the first reason stands. time: s."""
        if not (self.streaming or self._requested):
            return ()
        self._requested = False
        self.refusal = reason
        return (self._enter(State.STANDBY, reason, time),) if self.streaming else ()

    def update(self, facts: Facts, time: float) -> tuple[Transition, ...]:
        """Apply the rules to the facts. Returns the transitions, in order."""
        self._requests = ()
        if facts.connected and self._initially_armed is None:
            self._initially_armed = facts.armed
        step = self._rules(facts, time)
        if step is None:
            return ()
        after, reason = step
        refused = self.state is State.STREAMING and after is State.STANDBY and bool(facts.refusal)
        # what was to be armed is armed again by another request alone: somebody may stand beside it
        refused = refused and not self._arming
        return (self._enter(after, reason, time, keep_request=refused),)

    def _enter(self, after: State, reason: str, time: float, *, keep_request: bool = False) -> Transition:
        """Change the state. keep_request: engagement stays requested, because control was never taken."""
        transition = Transition(time, self.state, after, reason)
        if after in (State.STANDBY, State.DISCONNECTED) and self.streaming:
            # control was given up, on purpose or not: only another request may take it back
            self._requested = self._requested and keep_request
            self.refusal = reason
        if after is State.STREAMING:
            self.refusal, self._arming = "", False
        self.state = after
        self._entered = time
        self._awaiting_since = None
        self._last_request = -float("inf")
        return transition

    def _rules(self, facts: Facts, time: float) -> tuple[State, str] | None:
        if not facts.connected:
            return None if self.state is State.DISCONNECTED else (State.DISCONNECTED, facts.reason or "link lost")
        rule = {
            State.DISCONNECTED: self._disconnected,
            State.STANDBY: self._standby,
            State.STREAMING: self._streaming,
            State.ENGAGED: self._engaged,
            State.FALLBACK: self._engaged,
        }[self.state]
        return rule(facts, time)

    def _disconnected(self, facts: Facts, time: float) -> tuple[State, str]:
        armed = "armed" if facts.armed else "disarmed"
        return State.STANDBY, f"vehicle heard, {armed} in {facts.mode}"

    def _standby(self, facts: Facts, time: float) -> tuple[State, str] | None:
        if not self._requested:
            return None
        if self._initially_armed and not self._settings.resume:
            self._requested = False
            self.refusal = (
                f"the vehicle was already armed when it was first heard (mode {facts.mode}); control stays with the "
                "pilot or program that has it. Land and disarm it, or give --resume"
            )
            return None
        if facts.refusal:
            self.refusal = facts.refusal
            return None
        return State.STREAMING, "engagement requested"

    def _streaming(self, facts: Facts, time: float) -> tuple[State, str] | None:
        if facts.refusal:
            return State.STANDBY, facts.refusal
        if facts.fallback >= Fallback.LEVEL_HOLD:
            return State.STANDBY, facts.reason or facts.fallback.name.lower()
        streaming_time = time - self._entered
        if facts.offboard and facts.armed and streaming_time >= self._settings.stream_time:
            return State.ENGAGED, "HEARTBEAT shows OFFBOARD and armed"
        waited = streaming_time - self._settings.stream_time
        if waited >= 0 and not self._settings.arm and (facts.offboard or self.awaits_pilot):
            return self._await_pilot(facts, time)
        if waited > self._settings.patience:
            missing = "OFFBOARD" if not facts.offboard else "arming"
            return State.STANDBY, f"HEARTBEAT did not show {missing} within {self._settings.patience:g} s"
        if waited >= 0 and time - self._last_request >= self._settings.repeat:
            self._last_request = time
            if not facts.offboard:
                self._requests = (AutopilotRequest.OFFBOARD,)
            else:
                self._arming = True
                self._requests = (AutopilotRequest.ARM,)
        return None

    def _await_pilot(self, facts: Facts, time: float) -> tuple[State, str] | None:
        """Wait in OFFBOARD until the pilot arms. OFFBOARD is not requested again: the mode is the pilot's as well."""
        if self._awaiting_since is None:
            self._awaiting_since = time
        waited, patience = time - self._awaiting_since, self._settings.pilot_patience
        if not facts.offboard:
            if waited >= self._settings.mode_certain:
                return State.STANDBY, f"mode changed to {facts.mode} before the pilot armed"
            self._awaiting_since = None  # a mode that was accepted and refused at once: it is requested again
        elif patience is not None and waited > patience:
            return State.STANDBY, f"the pilot did not arm within {patience:g} s"
        return None

    def _engaged(self, facts: Facts, time: float) -> tuple[State, str] | None:
        if not facts.armed:
            return State.STANDBY, "vehicle disarmed"
        if not facts.offboard:
            return State.STANDBY, facts.mode_change
        if facts.fallback is Fallback.STOP_STREAMING:
            return State.STANDBY, f"stopped streaming, the autopilot's failsafe acts: {facts.reason}"
        if self.state is State.ENGAGED and facts.fallback > Fallback.NONE:
            return State.FALLBACK, f"{facts.fallback.name.lower()}: {facts.reason}"
        if self.state is State.FALLBACK and facts.fallback is Fallback.NONE:
            return State.ENGAGED, "healthy again"
        return None
