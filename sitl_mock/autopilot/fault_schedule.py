"""Timed faults of a scenario: what goes wrong, when, and for how long."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal

import msgspec
import numpy as np

from dynamics.errors import RequestError
from sitl_mock.autopilot.commander import Commander
from sitl_mock.vehicle.clock import VehicleClock
from sitl_mock.vehicle.vehicle_interface import ControlSetpoint, Vehicle
from sitl_mock.wire.estimate_fault import EstimateFault
from sitl_mock.wire.link import Link

FaultKind = Literal[
    "estimator_reset",
    "estimate_nan",
    "estimate_freeze",
    "estimate_stop",
    "estimate_move",
    "estimate_drift",
    "stamps_ahead",
    "reboot",
    "clock_jump",
    "link_down",
    "packet_loss",
    "packet_duplication",
    "packet_reorder",
    "message_flood",
    "link_jitter",
    "other_controller",
    "refuse_arming",
    "refuse_offboard",
    "gnss_loss",
    "gnss_glitch",
    "held",
    "knock",
    "effect",
]
COMMAND_PERIOD = 0.016  # s between setpoints of another controller, whose beat is not ours
TOUCHED = 0.1  # share of the weight that the ground carries when the vehicle has touched down
Start = Literal["start", "arming", "takeoff", "touchdown"]


class Fault(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """One fault of a scenario.

    kind: what goes wrong.
    at: when it begins, s after the event that `after` names.
    after: the mock's start, the arming, the take-off or the first contact with the ground after flight.
    duration: s, without end by default; an estimator reset and a clock jump happen at once.
    shift: of an estimator reset, or of an estimate that moves or drifts without one, ENU, m.
    yaw: of these, about up, rad.
    seconds: of a clock jump, negative for backwards; the longest delay of a frame by link_jitter; of stamps_ahead.
    probability: of a frame's loss, duplication or delay.
    rate: of a message flood, frames per second.
    setpoint: body rates, FLU, rad/s, and thrust, 0..1, that another controller sends 60 times a second.
    rates: FLU, rad/s, that a knock adds to the body rates at once.
    values: of an effect, by name: {"weak_rotor[2].loss" = 0.15}; the scenario has the effect from its start.
    """

    kind: FaultKind
    at: float
    after: Start = "start"
    duration: float = math.inf
    shift: tuple[float, float, float] = (0.0, 0.0, 0.0)
    yaw: float = 0.0
    seconds: float = -1.0
    probability: float = 0.2
    rate: float = 10_000.0
    setpoint: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.5)
    rates: tuple[float, float, float] = (0.0, 0.0, 0.0)
    values: dict[str, float] = {}

    def __post_init__(self) -> None:
        if not (math.isfinite(self.at) and self.at >= 0.0 and self.duration > 0.0):
            raise RequestError(
                f"fault {self.kind}: at = {self.at}, duration = {self.duration}: wanted seconds, at >= 0, duration > 0"
            )
        if self.kind == "estimate_drift" and math.isinf(self.duration):
            raise RequestError("fault estimate_drift: wanted the duration in which the estimate drifts, s")
        if not 0.0 <= self.probability <= 1.0:
            raise RequestError(f"fault {self.kind}: probability = {self.probability}: wanted 0 to 1")


@dataclass(frozen=True, slots=True)
class FaultTargets:
    """The parts of an autopilot that faults act on."""

    commander: Commander
    estimate: EstimateFault
    clock: VehicleClock
    links: list[Link]
    vehicle: Vehicle


class FaultSchedule:
    """Begins and ends faults as simulated time passes."""

    def __init__(self, faults: tuple[Fault, ...], targets: FaultTargets):
        self._targets = targets
        self._waiting = list(faults)
        self._running: list[tuple[float, Fault]] = []
        self._origin: dict[Start, float] = {"start": 0.0}
        self._flown = False
        self._next_command = 0.0
        self._applied = 0.0

    def apply(self, time: float) -> None:
        """Begin what is due and end what is over at a simulated time, s."""
        if not self._waiting and not self._running:
            return
        if self._targets.commander.armed:
            self._origin.setdefault("arming", time)
        if not self._targets.commander.landed:
            self._origin.setdefault("takeoff", time)
        self._note_touchdown(time)
        for end, fault in [entry for entry in self._running if entry[0] <= time]:
            self._running.remove((end, fault))
            ACTIONS[fault.kind](self._targets, fault, False)
        self._command(time)
        self._drift(time - self._applied)
        self._applied = time
        for fault in [fault for fault in self._waiting if self._begins(fault) <= time]:
            self._waiting.remove(fault)
            ACTIONS[fault.kind](self._targets, fault, True)
            if math.isfinite(fault.duration) or fault.kind == "other_controller":
                self._running.append((time + fault.duration, fault))

    def _command(self, time: float) -> None:
        """Let another controller send its setpoint, where one does."""
        for _, fault in self._running:
            if fault.kind == "other_controller" and time >= self._next_command:
                self._next_command = time + COMMAND_PERIOD
                *rates, thrust = fault.setpoint
                setpoint = ControlSetpoint("rates", rate_body=np.array(rates), thrust=thrust)
                self._targets.commander.offboard.feed(time, setpoint)

    def _drift(self, elapsed: float) -> None:
        """Move the estimate on, where it drifts. elapsed: s."""
        for _, fault in self._running:
            if fault.kind == "estimate_drift":
                share = elapsed / fault.duration
                self._targets.estimate.move(share * np.array(fault.shift), share * fault.yaw)

    def _note_touchdown(self, time: float) -> None:
        force = self._targets.vehicle.ground_force
        if "takeoff" in self._origin and force == 0.0:
            self._flown = True
        elif self._flown and force > TOUCHED:
            self._origin.setdefault("touchdown", time)

    def _begins(self, fault: Fault) -> float:
        return self._origin.get(fault.after, math.inf) + fault.at


def _reset(targets: FaultTargets, fault: Fault, begins: bool) -> None:
    if begins:
        targets.estimate.reset(np.array(fault.shift), fault.yaw)


def _invalid(targets: FaultTargets, _: Fault, begins: bool) -> None:
    targets.estimate.invalid = begins


def _frozen(targets: FaultTargets, _: Fault, begins: bool) -> None:
    targets.estimate.frozen = begins


def _stopped(targets: FaultTargets, _: Fault, begins: bool) -> None:
    targets.estimate.stopped = begins


def _moved(targets: FaultTargets, fault: Fault, begins: bool) -> None:
    sign = 1.0 if begins else -1.0
    targets.estimate.move(sign * np.array(fault.shift), sign * fault.yaw)


def _drifts(targets: FaultTargets, _: Fault, begins: bool) -> None:
    """It moves while it runs: see FaultSchedule."""


def _stamp_early(targets: FaultTargets, fault: Fault, begins: bool) -> None:
    targets.estimate.lead = abs(fault.seconds) if begins else 0.0


def _reboot(targets: FaultTargets, fault: Fault, begins: bool) -> None:
    """The motors stop and nothing passes; at the end the vehicle is disarmed, its clock and parameters as at a boot."""
    _link_down(targets, fault, begins)
    if begins:
        targets.commander.reboot()
        targets.clock.restart(targets.vehicle.time)


def _clock_jump(targets: FaultTargets, fault: Fault, begins: bool) -> None:
    if begins:
        targets.clock.jump(fault.seconds)


def _link_down(targets: FaultTargets, _: Fault, begins: bool) -> None:
    for link in targets.links:
        link.fault.down = begins


def _loss(targets: FaultTargets, fault: Fault, begins: bool) -> None:
    for link in targets.links:
        link.fault.loss = fault.probability if begins else 0.0


def _duplication(targets: FaultTargets, fault: Fault, begins: bool) -> None:
    for link in targets.links:
        link.fault.duplication = fault.probability if begins else 0.0


def _reorder(targets: FaultTargets, fault: Fault, begins: bool) -> None:
    for link in targets.links:
        link.fault.reorder = fault.probability if begins else 0.0


def _flood(targets: FaultTargets, fault: Fault, begins: bool) -> None:
    for link in targets.links:
        link.fault.flood = fault.rate if begins else 0.0


def _jitter(targets: FaultTargets, fault: Fault, begins: bool) -> None:
    for link in targets.links:
        link.fault.jitter = abs(fault.seconds) if begins else 0.0


def _other_controller(targets: FaultTargets, _: Fault, begins: bool) -> None:
    """It sends while it runs: see FaultSchedule."""


def _refuse_arming(targets: FaultTargets, _: Fault, begins: bool) -> None:
    commander = targets.commander
    commander.forced_rejections = replace(commander.forced_rejections, arming=begins)


def _refuse_offboard(targets: FaultTargets, _: Fault, begins: bool) -> None:
    commander = targets.commander
    commander.forced_rejections = replace(commander.forced_rejections, offboard=begins)


def _gnss_loss(targets: FaultTargets, _: Fault, begins: bool) -> None:
    targets.vehicle.use_gnss(not begins)


def _gnss_glitch(targets: FaultTargets, _: Fault, begins: bool) -> None:
    targets.estimate.gnss_glitch = begins


def _held(targets: FaultTargets, _: Fault, begins: bool) -> None:
    targets.vehicle.hold(begins)


def _knock(targets: FaultTargets, fault: Fault, begins: bool) -> None:
    if begins:
        targets.vehicle.knock(np.array(fault.rates))


def _effect(targets: FaultTargets, fault: Fault, begins: bool) -> None:
    if begins:
        targets.vehicle.change(fault.values)


ACTIONS: dict[FaultKind, Callable[[FaultTargets, Fault, bool], None]] = {
    "estimator_reset": _reset,
    "estimate_nan": _invalid,
    "estimate_freeze": _frozen,
    "estimate_stop": _stopped,
    "estimate_move": _moved,
    "estimate_drift": _drifts,
    "stamps_ahead": _stamp_early,
    "reboot": _reboot,
    "clock_jump": _clock_jump,
    "link_down": _link_down,
    "packet_loss": _loss,
    "packet_duplication": _duplication,
    "packet_reorder": _reorder,
    "message_flood": _flood,
    "link_jitter": _jitter,
    "other_controller": _other_controller,
    "refuse_arming": _refuse_arming,
    "refuse_offboard": _refuse_offboard,
    "gnss_loss": _gnss_loss,
    "gnss_glitch": _gnss_glitch,
    "held": _held,
    "knock": _knock,
    "effect": _effect,
}
