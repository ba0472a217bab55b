"""`alula link`: checks a link without flying."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import msgspec
import typer
from rich.box import SIMPLE_HEAD
from rich.table import Table

from alula.cli.console import Console
from alula.cli.options import LINK, Effects, LinkOption, Signing, System, Timeout
from alula.cli.output import options, print_next
from dynamics.errors import VehicleError
from dynamics.files import STANDARD_OUTPUT, write_json
from dynamics.signing_key import read_signing_key, write_signing_key
from dynamics.vehicle_file import parse_vehicle
from runtime.flight.composition import vehicle_facts
from runtime.flight_setup import exported_bundle, flown_vehicle_text, hovering_vehicle
from runtime.link.connection import Endpoint, parse_endpoint
from runtime.link.link_check import check_link, set_up_signing
from runtime.link.link_report import LinkReport
from runtime.link.rates import WINDOW
from runtime.link.signing import SigningReport
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
    signing_key: Signing = None,
    setup_signing: Annotated[
        Path | None,
        typer.Option(
            help="Give the autopilot the key of this file, over a serial line or within this machine alone; it signs "
            "with it from then on. --signing-key is the key that it has now, if it has one.",
            metavar="FILE",
        ),
    ] = None,
    new_signing_key: Annotated[
        Path | None,
        typer.Option(help="Write a new random key to this file, readable by you alone, and end.", metavar="FILE"),
    ] = None,
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
    if new_signing_key is not None:
        write_signing_key(new_signing_key)
        print(f"written: {new_signing_key}, a new key that only you can read", file=sys.stderr)
        print_next("link", "--link", "serial:/dev/ttyACM0", "--setup-signing", new_signing_key)
        return
    if setup_signing is not None:
        signing_key = _set_up(setup_signing, signing_key, parse_endpoint(link), timeout, system)
    streams = {"ODOMETRY": rate, "HIGHRES_IMU": 50.0, "ATTITUDE_QUATERNION": 50.0}
    report = check_link(
        parse_endpoint(link),
        timeout=timeout,
        target_system=system,
        streams=streams,
        window=window,
        request_mode=request_mode,
        vehicle=_facts(vehicle, bundle, effects or ()),
        signing_key=None if signing_key is None else read_signing_key(signing_key),
    )
    if as_json:
        write_json(_as_plain(report), STANDARD_OUTPUT)
    else:
        _print(report, Console())
        print_next(*_following(report, link, vehicle, bundle, signing_key))
    if not report.is_ready:
        raise VehicleError(f"A flight over {report.endpoint} would not be engaged; the reasons are in the report.")


def _set_up(key: Path, present: Path | None, endpoint: Endpoint, timeout: float, system: int | None) -> Path:
    """Give the autopilot a key. Returns its file: that of the link from then on."""
    status = set_up_signing(
        endpoint,
        read_signing_key(key),
        present=None if present is None else read_signing_key(present),
        timeout=timeout,
        target_system=system,
    )
    print(f"vehicle {status.system} signs with the key of {key} now", file=sys.stderr)
    return key


def _following(
    report: LinkReport, link: str, vehicle: str | None, bundle: Path | None, signing_key: Path | None
) -> list[object]:
    """Next command: fly, check again when the reasons are gone, or make a vehicle file."""
    flown = options([("--vehicle", vehicle), ("--bundle", bundle)])
    key = options([("--signing-key", signing_key)])
    if not report.is_ready:
        return ["link", "--link", link, *flown, *key]
    if not flown:
        return ["vehicle", "new"]
    return ["fly", "--link", link, *flown, *key, "--reference", "hover", "--record", "recordings"]


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
    facts.add_row("signing", _signing(report.signing))
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


def _signing(signing: SigningReport) -> str:
    """Whether the autopilot signs, and how many frames were accepted and refused."""
    signs = {None: "no autopilot was heard", True: "the autopilot signs", False: "the autopilot does not sign"}
    if not signing.required:
        return f"{signs[signing.autopilot_signs]}; nothing is verified without --signing-key"
    refused = f"{signing.unsigned} unsigned, {signing.wrong_key} wrong key, "
    refused += f"{signing.replayed + signing.outdated} replayed"
    return f"{signs[signing.autopilot_signs]}; {signing.signed} frames signed; refused: {refused}"


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
