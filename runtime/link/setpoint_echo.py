"""Setpoints that are not ours: what the autopilot says it follows, or what another sends on this link.

PX4 reports the body rates that it follows in ATTITUDE_TARGET. Who else sends setpoints is obeyed like us, so that the
report then is none of those that were sent lately.
"""

from __future__ import annotations

from collections import deque

import msgspec

REPORTS = ("ATTITUDE_TARGET",)
SETPOINTS = ("SET_ATTITUDE_TARGET", "SET_POSITION_TARGET_LOCAL_NED", "SET_POSITION_TARGET_GLOBAL_INT")
MEMORY = 1.0  # s of setpoints that a report may still be of
RATE_TOLERANCE = 0.02  # rad/s
THRUST_TOLERANCE = 0.01
THRUST_AGREES = 5  # reports in a row whose thrust is ours, after which another one is not
MIN_FOREIGN, FOREIGN_WINDOW = 3, 1.5  # reports of other setpoints, within so many s

Vector = tuple[float, float, float]


class SetpointReport(msgspec.Struct, frozen=True):
    """Body rates, FLU, rad/s, and thrust, 0..1, that somebody commands. sender: None for the autopilot's report."""

    received: float
    rate_body: Vector
    thrust: float
    sender: tuple[int, int] | None = None
    message: str = "ATTITUDE_TARGET"


class SetpointEcho:
    """Compares reports with what was sent. The link's thread calls `report`, the control thread everything else."""

    def __init__(self) -> None:
        self._reports: deque[SetpointReport] = deque(maxlen=256)
        self._sent: deque[tuple[float, Vector, float]] = deque(maxlen=512)
        self._foreign: deque[tuple[float, str]] = deque(maxlen=256)
        self._agreeing = 0

    def report(self, report: SetpointReport) -> None:
        """Take a report."""
        self._reports.append(report)

    def sent(self, time: float, rate_body: Vector, thrust: float) -> None:
        """Take a setpoint that was sent. time: s."""
        self._sent.append((time, rate_body, thrust))

    def finding(self, now: float, *, judged: bool) -> str:
        """Whose setpoints act, where they are not ours; else empty. judged: whether the autopilot is to follow ours."""
        reports = [self._reports.popleft() for _ in range(len(self._reports))]
        if not judged or not self._sent:
            self._foreign.clear()
            return ""
        for report in reports:
            if text := self._judge(report):
                self._foreign.append((report.received, text))
        while self._foreign and self._foreign[0][0] < now - FOREIGN_WINDOW:
            self._foreign.popleft()
        return self._foreign[-1][1] if len(self._foreign) >= MIN_FOREIGN else ""

    def _judge(self, report: SetpointReport) -> str:
        while len(self._sent) > 1 and self._sent[0][0] < report.received - MEMORY:
            self._sent.popleft()
        alike = [thrust for _, rate, thrust in self._sent if _is_close(rate, report.rate_body)]
        same_thrust = any(abs(thrust - report.thrust) < THRUST_TOLERANCE for thrust in alike)
        if report.sender is not None:
            system, component = report.sender
            return "" if same_thrust else f"{report.message} of system {system}, component {component} is on this link"
        if alike and (same_thrust or self._agreeing < THRUST_AGREES):
            self._agreeing = self._agreeing + 1 if same_thrust else 0
            return ""
        rates = ", ".join(f"{rate:.2f}" for rate in report.rate_body)
        return (
            f"the autopilot follows body rates of {rates} rad/s and a thrust of {report.thrust:.2f}, which were not "
            "sent by this program; stop the other one"
        )


def _is_close(first: Vector, second: Vector) -> bool:
    return all(abs(a - b) < RATE_TOLERANCE for a, b in zip(first, second, strict=True))
