"""PX4's commander: arming, modes, failsafe and automatic disarming, as rules over time.

Every method takes the simulated time in s; links, messages and the vehicle are elsewhere. `docs/px4.md` has the
measurements behind each rule.
"""

from __future__ import annotations

import math
import random
from collections import deque
from dataclasses import dataclass
from enum import IntEnum
from typing import Literal

from sitl_mock.autopilot.modes import ARMED, AUTO, CUSTOM, GUIDED, MANUAL_INPUT, STABILISED, Mode
from sitl_mock.autopilot.offboard import OffboardStream, Rule
from sitl_mock.autopilot.parameters import Parameters

FORCE = 21196
TextSeverity = Literal["critical", "info"]
SEVERITY_NUMBER: dict[TextSeverity, int] = {"critical": 2, "info": 6}  # MAV_SEVERITY


class Result(IntEnum):
    """MAV_RESULT."""

    ACCEPTED = 0
    TEMPORARILY_REJECTED = 1
    DENIED = 2
    UNSUPPORTED = 3
    FAILED = 4


class SystemStatus(IntEnum):
    """MAV_STATE: the values that PX4's heartbeat uses."""

    UNINITIALISED = 0
    STANDBY = 3
    ACTIVE = 4
    CRITICAL = 5
    TERMINATION = 8


# COM_OBL_RC_ACT without a pilot: a mode that needs sticks becomes a return
OFFBOARD_LOSS_MODE = {0: Mode.RTL, 1: Mode.RTL, 2: Mode.RTL, 3: Mode.RTL, 4: Mode.LAND, 5: Mode.HOLD}
TERMINATE, DISARM = 6, 7
NEED_POSITION = (Mode.HOLD, Mode.RTL, Mode.TAKEOFF)


@dataclass(frozen=True, slots=True)
class ForcedRejections:
    """Requests that a scenario makes the autopilot answer with TEMPORARILY_REJECTED whatever its state.

    arming: to arm.
    offboard: to enter OFFBOARD.
    """

    arming: bool = False
    offboard: bool = False


class Commander:
    """Arming and mode state with PX4's transition rules."""

    def __init__(self, parameters: Parameters, *, rule: Rule = "measured", seed: int = 0):
        self.offboard = OffboardStream(rule)
        self.armed = False
        self.intended = Mode.HOLD
        self.mode = Mode.HOLD
        self.failsafe = False
        self.terminated = False
        self.landed = True
        self.has_position = True
        self.upright = True
        self.forced_rejections = ForcedRejections()
        self.texts: deque[tuple[TextSeverity, str]] = deque(maxlen=32)
        self._parameters = parameters
        self._random = random.Random(seed)
        self._after_disarming = Mode.HOLD
        self._taken_off = False
        self._armed_at = math.inf
        self._landed_at = -math.inf
        self._switch_at = math.inf

    # commands

    def arm(self, time: float, *, force: bool = False) -> Result:
        """Arm, if PX4 would."""
        if self.armed:
            return Result.ACCEPTED
        if self.forced_rejections.arming or self.terminated or not (force or self.may_arm(time)):
            self.texts.append(("critical", "Arming denied: Resolve system health failures first"))
            return Result.TEMPORARILY_REJECTED
        self.armed = True
        self._armed_at = time
        self._taken_off = False
        self.texts.append(("info", "Armed by external command"))
        return Result.ACCEPTED

    def may_arm(self, time: float) -> bool:
        """Whether the preflight checks pass in the present mode."""
        if self.mode.needs_pilot or self.mode.prevents_arming or not self.upright:
            return False
        return self.mode is not Mode.OFFBOARD or self.offboard.may_begin(time, self._loss_time)

    def disarm(self, time: float, *, force: bool = False) -> Result:
        """Disarm; in the air only by force."""
        if not self.armed:
            return Result.ACCEPTED
        if not self.landed and not force:
            self.texts.append(("critical", "Disarming denied: not landed"))
            return Result.TEMPORARILY_REJECTED
        self._disarm("Disarmed by external command")
        return Result.ACCEPTED

    def set_mode(self, time: float, mode: Mode | None) -> Result:
        """Change the intended mode: while disarmed to any, while armed to one that can run."""
        if mode is None:
            self.texts.append(("critical", "Unsupported mode"))
            return Result.TEMPORARILY_REJECTED
        if mode is Mode.OFFBOARD and self.forced_rejections.offboard:
            return Result.TEMPORARILY_REJECTED
        if self.armed and mode is not self.mode and not self._can_run(time, mode):
            return Result.TEMPORARILY_REJECTED
        self.intended = mode
        self.failsafe = False
        self._switch_at = math.inf
        self.mode = mode
        if not mode.prevents_arming:
            self._after_disarming = mode
        return Result.ACCEPTED

    def terminate(self) -> None:
        """Stop the rotors for good."""
        self.terminated = True
        self.texts.append(("critical", "Flight termination active"))

    def reboot(self) -> None:
        """Begin again as after a boot: disarmed, in HOLD."""
        if self.armed:
            self._disarm("Rebooted")
        self.mode = self.intended = self._after_disarming = Mode.HOLD
        self.terminated = self._taken_off = False

    # time

    def update(self, time: float, *, landed: bool) -> None:
        """Apply the automatic transitions: offboard loss and return, disarming."""
        if landed and not self.landed:
            self._landed_at = time
            self.texts.append(("info", "Landing detected"))
        elif self.landed and not landed and self.armed:
            self._taken_off = True
            self.texts.append(("info", "Takeoff detected"))
        self.landed = landed
        if self.armed:
            self._watch_offboard(time)
            self._disarm_when_due(time)
        elif self.failsafe:
            self.failsafe = False
            self.mode = self.intended

    def finish_takeoff(self) -> None:
        """Switch to HOLD at the take-off height."""
        self.mode = self.intended = self._after_disarming = Mode.HOLD

    def lose_position(self) -> None:
        """The estimator has no position any more: a mode that needs one becomes a landing."""
        self.has_position = False
        if self.armed and self.mode in NEED_POSITION:
            self.failsafe = True
            self.mode = self.intended = Mode.LAND
            self.texts.append(("critical", "Failsafe activated: no position estimate, landing"))

    def _watch_offboard(self, time: float) -> None:
        if self.intended is not Mode.OFFBOARD or self.terminated:
            return
        alive = self.offboard.is_alive(time, self._loss_time)
        if alive == (not self.failsafe):
            self._switch_at = math.inf
        elif not alive:
            if math.isinf(self._switch_at):
                lost = self.offboard.last + self._loss_time
                self._switch_at = max(time, lost + self._random.uniform(0.022, 0.114))
            elif time >= self._switch_at:
                self._lose_offboard()
        elif math.isinf(self._switch_at):
            self._switch_at = self.offboard.last + self._random.uniform(0.005, 0.017)
        elif time >= self._switch_at:
            self._switch_at = math.inf
            self.failsafe = False
            self.mode = Mode.OFFBOARD

    def _lose_offboard(self) -> None:
        self._switch_at = math.inf
        action = int(self._parameters["COM_OBL_RC_ACT"])
        if action == DISARM:
            self._disarm("Disarmed by failsafe")
            return
        self.failsafe = True
        if action == TERMINATE:
            self.terminate()
        else:
            self.mode = OFFBOARD_LOSS_MODE.get(action, Mode.RTL) if self.has_position else Mode.LAND
            self.texts.append(("critical", f"Failsafe activated: no offboard setpoints, entering {self.mode.name}"))

    def _disarm_when_due(self, time: float) -> None:
        after_landing, before_flight = self._parameters["COM_DISARM_LAND"], self._parameters["COM_DISARM_PRFLT"]
        if self._taken_off:
            if self.landed and after_landing > 0 and time - self._landed_at >= after_landing:
                self._disarm("Disarmed by landing")
        elif before_flight > 0 and time - self._armed_at >= before_flight:
            self._disarm("Disarmed by auto preflight disarming")

    def _disarm(self, text: str) -> None:
        self.armed = False
        self.failsafe = False
        self._switch_at = math.inf
        self.mode = self.intended = self._after_disarming
        self.texts.append(("info", text))

    def _can_run(self, time: float, mode: Mode) -> bool:
        if mode is Mode.OFFBOARD:
            return self.offboard.may_begin(time, self._loss_time)
        return not mode.needs_pilot and mode is not Mode.MISSION and (self.has_position or mode is Mode.LAND)

    @property
    def _loss_time(self) -> float:
        return max(0.0, self._parameters["COM_OF_LOSS_T"])

    # content of the heartbeat

    def system_status(self, time: float) -> SystemStatus:
        """MAV_STATE of the vehicle."""
        if self.terminated:
            return SystemStatus.TERMINATION
        if self.armed:
            return SystemStatus.CRITICAL if self.failsafe else SystemStatus.ACTIVE
        return SystemStatus.STANDBY if self.may_arm(time) else SystemStatus.UNINITIALISED

    def base_mode(self) -> int:
        """HEARTBEAT's base_mode; as PX4's, it shows auto, guided and stabilised by what the controllers do."""
        flags = CUSTOM | (ARMED if self.armed else 0)
        if self.mode is Mode.OFFBOARD:
            return flags | (STABILISED if self.offboard.count else 0)
        if self.mode.needs_pilot:
            return flags | MANUAL_INPUT | STABILISED
        return flags | AUTO | GUIDED | STABILISED
