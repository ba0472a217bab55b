"""Findings about a fleet, in sentences."""

from __future__ import annotations

from collections import Counter

from studies.fleet.summary import FleetReport

SHOWN = 3  # effects that a sentence names
OUTCOMES = {
    "explained": "the model explains {}",
    "effect": "it misses a named effect in {}",
    "ambiguous": "it misses one of several that the flight cannot tell apart in {}",
    "unknown": "it misses something that no effect of the catalogue explains in {}",
}


def sentences(report: FleetReport) -> tuple[str, ...]:
    """The verdicts, the effects, drifts and outliers, and what was left out; a sentence each."""
    total, counts = sum(report.verdicts.values()), report.verdicts
    diagnosed = total - counts.get("refused", 0) - counts.get("failed", 0)
    vehicles = len(report.vehicles)
    outcomes = "; ".join(text.format(f"{counts[name]:,}") for name, text in OUTCOMES.items() if counts.get(name))
    lines = [f"{_number(diagnosed, 'flight')} of {_number(vehicles, 'vehicle')}{': ' if outcomes else ''}{outcomes}."]
    effects = Counter(effect.key for flight in report.flights for effect in flight.effects)
    if effects:
        named = ", ".join(f"{name} in {_number(count, 'flight')}" for name, count in effects.most_common(SHOWN))
        lines.append(f"Most often missing: {named}.")
    drifting = [drift for drift in report.drifts if drift.is_drift]
    if drifting:
        number = _number(len(drifting), "drift")
        of = _number(len({drift.vehicle for drift in drifting}), "vehicle")
        lines.append(f"{number} over the dates, of {of}: first of all {drifting[0].quantity} of {drifting[0].vehicle}.")
    if report.outliers:
        logs = {outlier.log for outlier in report.outliers}
        lines.append(
            f"{_number(len(logs), 'flight')} unlike the others of the vehicle: first of all {report.outliers[0].log}."
        )
    without = total - diagnosed
    if without:
        lines.append(f"{_number(without, 'log')} without a diagnosis: each line has the reason.")
    if report.copies:
        lines.append(f"{_number(len(report.copies), 'log')} with the content of another one, not counted.")
    if report.undated:
        lines.append(
            f"{_number(report.undated, 'flight')} without a date in log or name, not in the drifts. Write the date "
            "into the names."
        )
    return tuple(lines)


def _number(count: int, one: str) -> str:
    return f"{count:,} {one}{'' if count == 1 else 's'}"
