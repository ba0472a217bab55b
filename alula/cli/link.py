"""`alula link`: checks a link without flying."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import msgspec
import typer
from rich.box import SIMPLE_HEAD
from rich.table import Table

from alula.cli.console import Console
from alula.cli.options import LINK, Effects, LinkOption, System, Timeout
from alula.cli.output import options, print_next
from dynamics.errors import VehicleError
from dynamics.files import STANDARD_OUTPUT, write_json
from dynamics.vehicle_file import parse_vehicle
from runtime.flight.composition import vehicle_facts
from runtime.flight_setup import exported_bundle, flown_vehicle_text, hovering_vehicle
from runtime.link.connection import parse_endpoint
from runtime.link.link_check import check_link
from runtime.link.link_report import LinkReport
from runtime.link.rates import WINDOW
from runtime.link.start_conditions import VehicleFacts


def link(
    link: LinkOption = LINK,
    rate: Annotated[float, typer.Option(min=1.0, help="Requested rate of ODOMETRY, Hz.")] = 100.0,
    timeout: Timeout = 10.0,
    system: System = None,
    vehicle: Annotated[
        str | None, typer.Option(help="Vehicle file that will fly: the autopilot's parameters are compared with it.")
    ] = None,
    bundle: Annotated[
        Path | None, typer.Option(help="Bundle that will fly, instead of --vehicle; its model needs no CasADi.")
    ] = None,
    effects: Effects = None,
    window: Annotated[float, typer.Option(min=0.2, max=WINDOW, help="Seconds of each of two measurements.")] = WINDOW,
    request_mode: Annotated[
        bool,
        typer.Option(
            "--request-mode", help="Request a disarmed vehicle's present mode once more, to count the acknowledgements."
        ),
    ] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print the report as JSON.")] = False,
) -> None:
    """Check a link without flying: rates, latency, clock offset, frames, mode, parameters.

    Message rates are requested for some seconds and reset to their defaults; nothing else of the vehicle is changed.
    """
    streams = {"ODOMETRY": rate, "HIGHRES_IMU": 50.0, "ATTITUDE_QUATERNION": 50.0}
    report = check_link(
        parse_endpoint(link),
        timeout=timeout,
        target_system=system,
        streams=streams,
        window=window,
        request_mode=request_mode,
        vehicle=_facts(vehicle, bundle, effects or ()),
    )
    if as_json:
        write_json(_as_plain(report), STANDARD_OUTPUT)
    else:
        _print(report, Console())
        print_next(*_following(report, link, vehicle, bundle))
    if not report.is_ready:
        raise VehicleError(f"A flight over {report.endpoint} would not be engaged; the reasons are in the report.")


def _following(report: LinkReport, link: str, vehicle: str | None, bundle: Path | None) -> list[object]:
    """What to run next: fly, check again when the reasons are gone, or make a vehicle file."""
    flown = options([("--vehicle", vehicle), ("--bundle", bundle)])
    if not report.is_ready:
        return ["link", "--link", link, *flown]
    if not flown:
        return ["vehicle", "new"]
    return ["fly", "--link", link, *flown, "--reference", "hover", "--record", "recordings"]


def _facts(vehicle: str | None, bundle: Path | None, effects: Sequence[Path]) -> VehicleFacts | None:
    """Of the vehicle or bundle that will fly, None for neither."""
    if vehicle is None and bundle is None:
        return None
    flown = parse_vehicle(flown_vehicle_text(vehicle, bundle, effects))
    exported = exported_bundle(bundle)
    return vehicle_facts(hovering_vehicle(flown, None if exported is None else exported.manifest))


def _as_plain(report: LinkReport) -> dict[str, object]:
    return {**msgspec.to_builtins(report), "is_ready": report.is_ready}


def _print(report: LinkReport, console: Console) -> None:
    vehicle, clock = report.vehicle, report.clock
    facts = Table(title=report.endpoint, title_justify="left", show_header=False)
    facts.add_row("vehicle", f"system {vehicle.system}, component {vehicle.component}, {vehicle.kind}")
    facts.add_row("autopilot", f"{vehicle.autopilot}, {vehicle.system_status}")
    facts.add_row("mode", f"{vehicle.mode}, {'armed' if vehicle.armed else 'disarmed'}, {vehicle.landed}")
    facts.add_row("also here", ", ".join(f"{address} ({kind})" for address, kind in report.others.items()) or "nobody")
    facts.add_row("round trip", f"{clock.round_trip * 1e3:.2f} ms")
    facts.add_row("clock offset", f"{clock.offset:.4f} s, uncertain by {clock.uncertainty * 1e3:.2f} ms")
    facts.add_row("clock drift", f"{clock.drift * 1e3:+.3f} ms/s")
    facts.add_row(
        "estimate", f"{report.estimate_source or 'none'}, frames {' and '.join(report.odometry_frames or ())}"
    )
    if report.position_world is not None:
        facts.add_row("position", "  ".join(f"{value:.2f}" for value in report.position_world) + " m, east north up")
    if report.attitude is not None:
        text = (
            f"{report.attitude.specific_force:.2f} m/s^2, {report.attitude.tilt_error_degrees:.1f} degrees off vertical"
        )
        facts.add_row("gravity", text)
    facts.add_row("battery", f"{vehicle.battery_voltage:.2f} V")
    count = report.acknowledgements_of_mode
    facts.add_row("mode request", f"{count} acknowledgements" if count else "none was made or acknowledged")
    facts.add_row("frames", f"{report.frames}, unknown {report.unknown_frames}, skipped {report.skipped_bytes} bytes")
    console.print(facts)
    console.print(_streams(report))
    parameters = Table("parameter", "value")
    for name, value in report.parameters.items():
        parameters.add_row(name, value if isinstance(value, str) else f"{value:g}")
    console.print(parameters)
    for problem in report.problems:
        console.print(f"[{'red' if problem.severity == 'error' else 'yellow'}]{problem.severity}[/]: {problem.text}")
    if report.is_ready:
        console.print("[green]ready[/]: no reason against engaging a flight")


def _streams(report: LinkReport) -> Table:
    table = Table("message", box=SIMPLE_HEAD, padding=(0, 1, 0, 0))  # fits 80 columns; a long answer wraps
    for heading in ("before, Hz", "requested", "answer", "after, Hz", "p1, ms", "median", "p99"):
        table.add_column(heading, justify="right", no_wrap=heading != "answer", overflow="fold")
    table.columns[0].no_wrap = True
    for stream in report.streams:
        after = stream.after
        intervals = [f"{value * 1e3:.1f}" for value in (after.p1, after.median, after.p99)]
        row = [f"{stream.before:.1f}", f"{stream.requested:.0f}", stream.answer, f"{after.rate:.1f}", *intervals]
        table.add_row(stream.name, *row)
    return table
