"""A fleet's folder: verdicts by vehicle, drifts over the dates, flights unlike the others."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from studies.fleet.files import read_about
from studies.fleet.pictures import drift_points, verdict_bars
from studies.fleet.store import read_flights
from studies.fleet.summary import Drift, FleetReport, outcome, summarise
from studies.fleet.words import sentences
from studies.results.kinds import FLEET
from studio.pages.figure import Picture
from studio.pages.numbers import unit_shown
from studio.pages.shown import Shown
from studio.pages.tables import Cell, PageTable

MONTH = 30.0  # days
NOTE = "Slopes of Theil and Sen, tests of Kendall, over all quantities of the fleet at once."


def show(path: Path) -> Shown:
    """The fleet as it stands. Raises RequestError for a folder without a line."""
    flights, about = read_flights(path), read_about(path)
    report = summarise(str(path) if about is None else about.folder, flights)
    logs = {} if about is None else {flight.log: Path(about.folder) / flight.log for flight in flights}
    share = None if about is None or len(flights) >= about.count else len(flights) / about.count
    return Shown(
        FLEET,
        f"The fleet in {report.folder}",
        sentences(report),
        pictures=_pictures(report),
        tables=[_vehicles(report), _drifts(report), _outliers(report), _flights(report)],
        logs={name: log for name, log in logs.items() if _is_there(log)},
        share=share,
        command=f"alula diagnose --fleet {report.folder} --out {path}",
    )


def _is_there(log: Path) -> bool:
    """Whether a log is at its path; a name that no file system takes is that of none."""
    try:
        return log.exists()
    except (OSError, ValueError):
        return False


def _pictures(report: FleetReport) -> dict[str, Picture]:
    pictures = {"Flights by verdict": verdict_bars(report)} if report.vehicles else {}
    points = drift_points(report)
    return pictures | ({"Drifts over the dates": points} if points else {})


def _vehicles(report: FleetReport) -> PageTable:
    headings = ("vehicle", "flights", *report.verdicts, "effects named, flights", "first", "last")
    rows: list[Sequence[Cell]] = [
        (
            one.label,
            one.flights,
            *(one.verdicts.get(name, 0) for name in report.verdicts),
            ", ".join(f"{name} {count}" for name, count in one.effects.items()),
            one.first[:10],
            one.last[:10],
        )
        for one in report.vehicles
    ]
    return PageTable("Vehicles", headings, rows)


def _drifts(report: FleetReport) -> PageTable:
    headings = ("vehicle", "quantity", "flights", "median", f"in {MONTH:g} days", "95 % interval", "unit", "drifts?")
    rows = [
        (
            one.vehicle,
            one.quantity,
            one.flights,
            one.median,
            MONTH * one.slope,
            f"{MONTH * one.low:.3g} to {MONTH * one.high:.3g}",
            unit_shown(one.unit),
            _words(one),
        )
        for one in report.drifts
    ]
    return PageTable("Drifts over the dates", headings, rows, NOTE)


def _words(drift: Drift) -> str:
    return f"{'yes' if drift.is_drift else 'not surely'} (chance {drift.probability:.2g})"


def _outliers(report: FleetReport) -> PageTable:
    headings = ("log", "vehicle", "quantity", "value", "median of the vehicle", "unit", "score")
    rows = [(o.log, o.vehicle, o.quantity, o.value, o.median, unit_shown(o.unit), o.score) for o in report.outliers]
    return PageTable("Flights unlike the others of their vehicle", headings, rows)


def _flights(report: FleetReport) -> PageTable:
    headings = ("log", "vehicle", "date", "s", "outcome", "effects", "in words")
    rows = [
        (
            one.log,
            one.vehicle,
            one.date[:16].replace("T", " "),
            one.duration,
            outcome(one),
            ", ".join(effect.key for effect in one.effects),
            one.error or one.sentence,
        )
        for one in report.flights
    ]
    return PageTable("Flights", headings, rows)
