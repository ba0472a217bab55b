"""The page of `alula diagnose --fleet --html`."""

from __future__ import annotations

from studies.fleet.pictures import drift_points, verdict_bars
from studies.fleet.summary import FleetReport, outcome
from studies.fleet.words import sentences
from studio.pages.page import render
from studio.pages.provenance import origin

MONTH = 30.0  # days
MAX_DRIFTS, MAX_UNSURE = 40, 8  # rows of their table
MAX_FLIGHTS = 2000  # rows of the table: a page stays under 5 MB


def fleet_page(report: FleetReport) -> str:
    """The page of a fleet."""
    unsure = [drift for drift in report.drifts if not drift.is_drift][:MAX_UNSURE]
    return render(
        "fleet.html",
        title=f"The fleet in {report.folder}",
        origin=origin({}),
        report=report,
        lines=sentences(report),
        bars=verdict_bars(report) if report.vehicles else None,
        points=drift_points(report),
        drifts=[drift for drift in report.drifts if drift.is_drift][:MAX_DRIFTS] + unsure,
        month=MONTH,
        outcome=outcome,
        rows=report.flights[:MAX_FLIGHTS],
        hidden=max(0, len(report.flights) - MAX_FLIGHTS),
    )
