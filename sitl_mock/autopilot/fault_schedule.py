"""Timed faults of a scenario: what goes wrong, when, and for how long."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING, Literal

import msgspec
import numpy as np

from dynamics.errors import RequestError

if TYPE_CHECKING:
    from sitl_mock.autopilot.autopilot import Autopilot

FaultKind = Literal[
    "estimator_reset",
    "estimate_nan",
    "estimate_freeze",
    "estimate_stop",
    "clock_jump",
    "link_down",
    "packet_loss",
    "packet_duplication",
    "packet_reorder",
    "message_flood",
    "refuse_arming",
    "refuse_offboard",
]
Start = Literal["start", "arming", "takeoff"]


class Fault(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """One fault.

    at: s after the mock's start, the arming or the take-off, as `after` says. duration: s, for good when left out;
    a reset and a clock jump happen at once. shift: m, ENU, and yaw: rad, of an estimator reset. seconds: of a clock
    jump, negative for backwards. probability: per frame, of loss, duplication or reorder. rate: frames/s of a flood.
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

    def __post_init__(self) -> None:
        if not (math.isfinite(self.at) and self.at >= 0.0 and self.duration > 0.0):
            raise RequestError(
                f"fault {self.kind}: at = {self.at}, duration = {self.duration}: wanted seconds, at >= 0, duration > 0"
            )
        if not 0.0 <= self.probability <= 1.0:
            raise RequestError(f"fault {self.kind}: probability = {self.probability}: wanted 0 to 1")


class FaultSchedule:
    """Begins and ends faults as simulated time passes."""

    def __init__(self, faults: tuple[Fault, ...]):
        self._waiting = list(faults)
        self._running: list[tuple[float, Fault]] = []
        self._origin: dict[Start, float] = {"start": 0.0}

    def apply(self, time: float, autopilot: Autopilot) -> None:
        """Begin what is due and end what is over at a simulated time, s."""
        if not self._waiting and not self._running:
            return
        if autopilot.commander.armed:
            self._origin.setdefault("arming", time)
        if not autopilot.commander.landed:
            self._origin.setdefault("takeoff", time)
        for end, fault in [entry for entry in self._running if entry[0] <= time]:
            self._running.remove((end, fault))
            ACTIONS[fault.kind](autopilot, fault, False)
        for fault in [fault for fault in self._waiting if self._begins(fault) <= time]:
            self._waiting.remove(fault)
            ACTIONS[fault.kind](autopilot, fault, True)
            if math.isfinite(fault.duration):
                self._running.append((time + fault.duration, fault))

    def _begins(self, fault: Fault) -> float:
        return self._origin.get(fault.after, math.inf) + fault.at


def _reset(autopilot: Autopilot, fault: Fault, begins: bool) -> None:
    if begins:
        autopilot.estimate_fault.reset(np.array(fault.shift), fault.yaw)


def _invalid(autopilot: Autopilot, _: Fault, begins: bool) -> None:
    autopilot.estimate_fault.invalid = begins


def _frozen(autopilot: Autopilot, _: Fault, begins: bool) -> None:
    autopilot.estimate_fault.frozen = begins


def _stopped(autopilot: Autopilot, _: Fault, begins: bool) -> None:
    autopilot.estimate_fault.stopped = begins


def _clock_jump(autopilot: Autopilot, fault: Fault, begins: bool) -> None:
    if begins:
        autopilot.clock.jump(fault.seconds)


def _link_down(autopilot: Autopilot, _: Fault, begins: bool) -> None:
    for link in autopilot.links:
        link.fault.down = begins


def _loss(autopilot: Autopilot, fault: Fault, begins: bool) -> None:
    for link in autopilot.links:
        link.fault.loss = fault.probability if begins else 0.0


def _duplication(autopilot: Autopilot, fault: Fault, begins: bool) -> None:
    for link in autopilot.links:
        link.fault.duplication = fault.probability if begins else 0.0


def _reorder(autopilot: Autopilot, fault: Fault, begins: bool) -> None:
    for link in autopilot.links:
        link.fault.reorder = fault.probability if begins else 0.0


def _flood(autopilot: Autopilot, fault: Fault, begins: bool) -> None:
    for link in autopilot.links:
        link.fault.flood = fault.rate if begins else 0.0


def _refuse_arming(autopilot: Autopilot, _: Fault, begins: bool) -> None:
    autopilot.commander.refuses = replace(autopilot.commander.refuses, arming=begins)


def _refuse_offboard(autopilot: Autopilot, _: Fault, begins: bool) -> None:
    autopilot.commander.refuses = replace(autopilot.commander.refuses, offboard=begins)


ACTIONS: dict[FaultKind, Callable[[Autopilot, Fault, bool], None]] = {
    "estimator_reset": _reset,
    "estimate_nan": _invalid,
    "estimate_freeze": _frozen,
    "estimate_stop": _stopped,
    "clock_jump": _clock_jump,
    "link_down": _link_down,
    "packet_loss": _loss,
    "packet_duplication": _duplication,
    "packet_reorder": _reorder,
    "message_flood": _flood,
    "refuse_arming": _refuse_arming,
    "refuse_offboard": _refuse_offboard,
}
