"""`alula fly`: the daemon beside the flight controller."""

from __future__ import annotations

import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType
from typing import Annotated

import msgspec
import typer
from rich.console import Console
from rich.table import Table

from dynamics.errors import VehicleError
from runtime.daemon import Daemon, FlightReport
from runtime.flight_setup import FlightSetup, prepare_flight
from simulation.flight_check import read_check

REALTIME_PRIORITY = 50


def fly(
    reference: Annotated[
        str, typer.Option(help="NAME or NAME:speed=0.8,size=1.2,plane=yz,height=1,laps=3, or a CSV file of your own.")
    ],
    link: Annotated[str, typer.Option(help="Where the vehicle is: udpin:, udpout:, tcp:, tcpin: or serial:.")] = (
        "udpin:0.0.0.0:14540"
    ),
    vehicle: Annotated[str | None, typer.Option(help="Vehicle file (TOML), or the name of one that comes along.")] = (
        None
    ),
    bundle: Annotated[Path | None, typer.Option(help="Bundle of a learned model, instead of --vehicle.")] = None,
    duration: Annotated[
        float | None, typer.Option(min=1.0, help="Seconds of the reference; its own length if left out.")
    ] = None,
    height: Annotated[float, typer.Option(min=0.3, help="Height of take-off, m.")] = 1.5,
    rate: Annotated[float, typer.Option(min=20.0, max=500.0, help="Control rate, Hz.")] = 100.0,
    record: Annotated[Path | None, typer.Option(help="Folder for the recording (MCAP and tlog).")] = None,
    arm: Annotated[
        bool, typer.Option("--arm/--no-arm", help="Arm the vehicle, or wait for the pilot to do it.")
    ] = True,
    resume: Annotated[bool, typer.Option(help="Take control of a vehicle that is armed already.")] = False,
    realtime: Annotated[bool, typer.Option(help="Ask for SCHED_FIFO and locked memory.")] = False,
    processor: Annotated[int | None, typer.Option(min=0, help="Processor to keep the control thread on.")] = None,
    system: Annotated[int | None, typer.Option(min=1, max=255, help="Its system id; the first heard if left out.")] = (
        None
    ),
    timeout: Annotated[float, typer.Option(min=0.1, help="Seconds to wait for the vehicle.")] = 10.0,
    as_json: Annotated[bool, typer.Option("--json", help="Print the report as JSON, the news on stderr.")] = False,
) -> None:
    """Take off, track a reference, land. SIGINT or SIGTERM lands, a second one stops streaming at once."""
    setup = FlightSetup(
        link=link, vehicle=vehicle, bundle=bundle, reference=reference, duration=duration, height=height,
        rate=rate, record=record, arm=arm, resume=resume,
        priority=REALTIME_PRIORITY if realtime else None, processor=processor, system=system, timeout=timeout,
    )  # fmt: skip
    console = Console(stderr=as_json)
    flight = prepare_flight(setup)
    if flight.bundle is not None and (check := read_check(flight.bundle.folder)) is not None and check.warning:
        console.print(f"warning: {check.warning}", style="yellow", markup=False)
    daemon = Daemon(
        flight.request, flight.vehicle, flight.reference, lambda text: console.print(text, markup=False),
        bundle=flight.bundle,
    )  # fmt: skip
    with _interrupts(daemon.interrupt):
        report = daemon.fly()
    if as_json:
        sys.stdout.buffer.write(msgspec.json.format(msgspec.json.encode(report)) + b"\n")
        sys.stdout.flush()
    else:
        _print(report, console)
    if not report.landed:
        raise VehicleError(f"The flight did not end with a landing of ours: {report.outcome}.")
    if not report.completed:
        raise VehicleError(f"The flight was cut short and landed: {report.landing_reason}.")


@contextmanager
def _interrupts(tell: Callable[[str], None]) -> Iterator[None]:
    """SIGINT and SIGTERM tell instead of interrupting."""

    def handle(number: int, frame: FrameType | None) -> None:
        tell(signal.Signals(number).name)

    before = {number: signal.signal(number, handle) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _print(report: FlightReport, console: Console) -> None:
    table = Table(title="flight", title_justify="left", show_header=False)
    table.add_row("ended", report.outcome + (f" ({report.landing_reason})" if report.landing_reason else ""))
    tracking, timing = report.tracking, report.timing
    if tracking.samples:
        table.add_row("position error", f"{tracking.position_rmse:.3f} m RMS, {tracking.position_max:.3f} m at most")
        table.add_row("attitude error", f"{tracking.attitude_rmse:.3f} rad RMS")
        table.add_row("greatest speed", f"{tracking.speed_max:.2f} m/s")
    table.add_row("estimates", f"{report.estimate_rate:.0f} Hz")
    table.add_row("arrival to departure", _milliseconds(timing.latency))
    table.add_row("between setpoints", _milliseconds(timing.interval))
    missed = ", ".join(f"{count} by {cause}" for cause, count in timing.missed.items())
    table.add_row("late setpoints", f"of {timing.ticks}: {missed}; {timing.ticks_by_clock} ticks without an estimate")
    if report.events:
        table.add_row("events", ", ".join(f"{name} {count}x" for name, count in report.events.items()))
    table.add_row("thrust", f"{report.effectiveness:.3f} of the vehicle file's")
    table.add_row("recording", report.recording or "none, give --record DIR")
    console.print(table)


def _milliseconds(figures: dict[str, float]) -> str:
    return ", ".join(f"{name} {1e3 * value:.2f} ms" for name, value in figures.items())
