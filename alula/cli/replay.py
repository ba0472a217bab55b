"""`alula replay`: passes a recorded flight through the flight logic again, tick by tick."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer

from alula.cli.options import Effects
from alula.cli.output import print_next
from alula.workbench import workbench
from dynamics.errors import DataError
from dynamics.files import STANDARD_OUTPUT, write_answer
from runtime.flight_setup import recorded_flight
from runtime.record.recording import damage_named, newest_recording, read_recording
from runtime.replay import ReplayReport
from runtime.replay import replay as replay_recording


def replay(
    recording: Annotated[
        Path,
        typer.Argument(help="Recording (.mcap) of `alula fly --record`, or a folder for its newest one."),
    ],
    vehicle: Annotated[
        str | None, typer.Option(help="Fly it with this vehicle file instead of the recorded one.")
    ] = None,
    bundle: Annotated[
        Path | None, typer.Option(help="Fly it with this bundle instead of the recorded vehicle.")
    ] = None,
    effects: Effects = None,
    tolerance: Annotated[
        float | None,
        typer.Option(min=0.0, help="Fail when a setpoint differs by more, rad/s or share of thrust; 0: by one bit."),
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the report as JSON.")] = False,
    html: Annotated[
        Path | None,
        typer.Option(help="Write tracking, timing, health and what was followed as one page to this file."),
    ] = None,
) -> None:
    """Fly a recording again: same estimates in, setpoints compared with the recorded ones."""
    newest = newest_recording(recording)
    if newest != recording and not as_json:
        print(f"{newest}, the newest in {recording}")
    recording = newest
    read = read_recording(recording)
    with damage_named(recording):
        report = replay_recording(read, *recorded_flight(read, vehicle, bundle, effects or ()))
    if as_json:
        write_answer(report, STANDARD_OUTPUT)
    else:
        print("\n".join(report.lines))
        file = vehicle or (None if bundle is None else f"{bundle}/vehicle.toml")
        print_next(*(["inspect", recording] if file is None else ["diagnose", recording, "--vehicle", file]))
    if html is not None:
        with workbench("alula replay --html"):
            from studies.results.page import write_recording_page
        write_recording_page(recording, report, html)
        print(f"written: {html}", file=sys.stderr)
    if tolerance is not None:
        _require_agreement(report, tolerance)


def _require_agreement(report: ReplayReport, tolerance: float) -> None:
    worst = max(report.rate_difference, report.thrust_difference)
    if worst > tolerance or report.unmatched or not report.states_agree:
        raise DataError(
            f"the replay differs from the recording by {worst:.3g} (allowed: {tolerance:g}), {report.unmatched} "
            f"setpoints are on one side only, states {'agree' if report.states_agree else 'differ'}. Another "
            "processor or library version differs in the last bits; another vehicle or program differs by more."
        )
