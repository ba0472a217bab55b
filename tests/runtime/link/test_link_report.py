"""A link in order has no problem, and each fault is reported as one, as an error where no flight may start."""

from __future__ import annotations

from typing import Any

import msgspec
import pytest

from runtime.link.link_report import ClockCheck, StreamCheck, link_problems
from runtime.link.problem import Problem
from runtime.link.rates import SILENT, StreamRate
from runtime.link.telemetry import LinkEvent, VehicleStatus

STEADY = StreamRate(100.0, 0.01, 0.01, 0.01, 300)
CLOCK = ClockCheck(answered=True, settled=True, round_trip=0.002, offset=5.0, uncertainty=1e-4, drift=1e-5)
STATUS = VehicleStatus(system=1, component=1, autopilot="px4", kind="quadrotor", mode="HOLD", battery_voltage=16.2)
ODOMETRY = StreamCheck("ODOMETRY", 30.0, 100.0, "accepted", STEADY)
IMU = StreamCheck("HIGHRES_IMU", 50.0, 50.0, "accepted", SILENT)
HEALTHY: dict[str, Any] = {
    "streams": (ODOMETRY,),
    "clock": CLOCK,
    "status": STATUS,
    "parameters": {"COM_OF_LOSS_T": 1.0, "COM_OBL_RC_ACT": 4},
    "events": (LinkEvent(1.0, "vehicle_found", "info", "Vehicle 1."),),
    "has_estimate": True,
}


def test_a_link_in_order_has_no_problem() -> None:
    assert link_problems(**HEALTHY) == ()


@pytest.mark.parametrize(
    ("fault", "severity", "text"),
    [
        ({"has_estimate": False}, "error", "No state estimate arrived"),
        ({"streams": (msgspec.structs.replace(ODOMETRY, after=SILENT),)}, "error", "ODOMETRY comes at 0 Hz"),
        ({"streams": (ODOMETRY, IMU)}, "warning", "HIGHRES_IMU comes at 0 Hz"),
        ({"clock": msgspec.structs.replace(CLOCK, answered=False)}, "error", "TIMESYNC is not answered"),
        ({"clock": msgspec.structs.replace(CLOCK, settled=False)}, "error", "not settled"),
        ({"clock": msgspec.structs.replace(CLOCK, round_trip=0.05)}, "warning", "50 ms"),
        ({"status": msgspec.structs.replace(STATUS, autopilot="ardupilotmega")}, "error", "ardupilotmega"),
        ({"status": msgspec.structs.replace(STATUS, system_status="critical")}, "error", "the state critical"),
        ({"status": msgspec.structs.replace(STATUS, armed=True)}, "warning", "armed, in mode HOLD"),
        ({"status": msgspec.structs.replace(STATUS, battery_voltage=float("nan"))}, "warning", "No battery voltage"),
        ({"parameters": {"THR_MDL_FAC": "no_answer"}}, "warning", "THR_MDL_FAC"),
        ({"start": (Problem("error", "It lies on its side."),)}, "error", "on its side"),
        ({"events": (LinkEvent(1.0, "clock_jumped", "warning", "It jumped."),)}, "warning", "It jumped."),
        ({"events": (LinkEvent(1.0, "estimate_frame_refused", "warning", "Axes."),)}, "error", "Axes."),
    ],
)
def test_each_fault_is_one_problem_of_its_severity(fault: dict[str, Any], severity: str, text: str) -> None:
    (problem,) = link_problems(**{**HEALTHY, **fault})
    assert problem.severity == severity
    assert text in problem.text


def test_an_event_that_repeats_is_one_problem() -> None:
    jumps = tuple(LinkEvent(float(n), "clock_jumped", "warning", "It jumped.") for n in range(5))
    assert len(link_problems(**{**HEALTHY, "events": jumps})) == 1
