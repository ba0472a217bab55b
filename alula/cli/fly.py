"""`alula fly`: real-time MPC beside the flight controller."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer
from rich.table import Table

import alula
from alula.api.reference_file import planned_reference
from alula.cli.console import Console
from alula.cli.options import LINK, Effects, LinkOption, Roaming, Signing, System
from alula.cli.output import options, print_next
from alula.cli.planning import planning_progress
from dynamics.errors import RequestError, VehicleError
from dynamics.files import STANDARD_OUTPUT, write_answer
from dynamics.references import is_identification
from runtime.record.parts import parts_of

if TYPE_CHECKING:
    from runtime.flight_request import FlightReport

REALTIME_PRIORITY = 50


def fly(
    reference: Annotated[
        str,
        typer.Option(
            help="NAME or NAME:speed=0.8,size=1.2,plane=yz,height=1,laps=3, or a CSV file of your own, or "
            "identify[:duration=60,box=4x4x2.5,speed=5,for=drag+lag] for a flight planned to show the most."
        ),
    ],
    link: LinkOption = LINK,
    for_effects: Annotated[
        str | None,
        typer.Option(
            "--for", help="With --reference identify: the effects to show, as drag,inertia,lag.", metavar="EFFECTS"
        ),
    ] = None,
    vehicle: Annotated[str | None, typer.Option(help="Vehicle file (TOML), or the name of a bundled one.")] = None,
    effects: Effects = None,
    bundle: Annotated[Path | None, typer.Option(help="Bundle of a learned model, instead of --vehicle.")] = None,
    duration: Annotated[
        float | None, typer.Option(min=1.0, help="Seconds of the reference; by default its own length.")
    ] = None,
    height: Annotated[float, typer.Option(min=0.3, help="Height of take-off, m.")] = 1.5,
    origin: Annotated[
        Literal["takeoff", "estimate"],
        typer.Option(help="What the reference's coordinates count from: where it stands, or the estimate's zero."),
    ] = "takeoff",
    rate: Annotated[
        float | None, typer.Option(min=20.0, max=500.0, help="Control rate, Hz; the vehicle file's, 100, if left out.")
    ] = None,
    settings: Annotated[
        list[str] | None,
        typer.Option(
            "--set", help="A setting of the vehicle file's [controller], as controller.horizon=0.8; repeatable."
        ),
    ] = None,
    adapt: Annotated[
        Literal["off", "shadow", "on"],
        typer.Option(help="Let the model follow in flight: a disturbance, wind and drag; shadow estimates them only."),
    ] = "off",
    follow: Annotated[
        list[str] | None,
        typer.Option(
            help="With --adapt: an effect whose parameters follow; repeatable. Wind, rotor_drag and parasitic_drag, "
            "where the workbench is installed; none for the disturbance alone."
        ),
    ] = None,
    network: Annotated[
        Literal["off", "shadow", "on"] | None,
        typer.Option(
            help="With --adapt: let the last layer of a learned model follow, too; shadow estimates the change only "
            "(default for bundles that support it)."
        ),
    ] = None,
    record: Annotated[Path | None, typer.Option(help="Folder for the recording (MCAP and tlog).")] = None,
    record_limit: Annotated[
        float | None,
        typer.Option(
            help="With --record: MB for the recording, at least 5. It is written in parts of a fifth of that, "
            "of which the oldest goes; by default all of the flight stays, 9 MB a minute at 100 Hz.",
            metavar="MB",
        ),
    ] = None,
    last_setpoint: Annotated[
        Literal["auto", "replace", "off"],
        typer.Option(
            help="Replace setpoints after which the vehicle would leave its box or hit the ground if this process "
            "died; auto: unless the flight is planned with such setpoints."
        ),
    ] = "auto",
    arm: Annotated[
        bool, typer.Option("--arm/--no-arm", help="Arm the vehicle, or wait for the pilot to arm it.")
    ] = True,
    resume: Annotated[bool, typer.Option(help="Take control of a vehicle that is armed already.")] = False,
    realtime: Annotated[
        bool,
        typer.Option(help="SCHED_FIFO and locked memory where the system permits them; what it refuses is reported."),
    ] = True,
    processor: Annotated[int | None, typer.Option(min=0, help="Processor to keep the control thread on.")] = None,
    system: System = None,
    roaming: Roaming = False,
    signing_key: Signing = None,
    timeout: Annotated[
        float | None,
        typer.Option(
            min=0.1,
            help="Seconds to wait for the vehicle, 10 by default; with --no-arm also for the pilot to arm, by default "
            "as long as it takes.",
        ),
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the report as JSON, notifications on stderr.")] = False,
) -> None:
    """Take off, track a reference, land. SIGINT or SIGTERM lands, a second one stops streaming at once."""
    console = Console(stderr=as_json)
    if for_effects is not None:
        reference = _for(reference, for_effects)
    if is_identification(reference):
        with planning_progress(console) as progress:
            planned = planned_reference(
                reference,
                vehicle if bundle is None else bundle,
                effect_files=effects or (),
                duration=duration,
                folder=record,
                progress=progress,
            )
        reference = planned.file
        _announce(console, planned.text)
    report = alula.fly(
        reference,
        vehicle=vehicle,
        bundle=bundle,
        effect_files=effects or (),
        link=link,
        duration=duration,
        height=height,
        origin=origin,
        rate=rate,
        settings=settings or (),
        adapt=adapt,
        follow=None if follow is None else [name for name in follow if name != "none"],
        network=network,
        record=record,
        record_limit=None if record_limit is None else round(1e6 * record_limit),
        last_setpoint=last_setpoint,
        arm=arm,
        resume=resume,
        processor=processor,
        system=system,
        roaming=roaming,
        signing_key=signing_key,
        priority=REALTIME_PRIORITY if realtime else None,
        timeout=timeout,
        announce=partial(_announce, console),
    )
    if as_json:
        write_answer(report, STANDARD_OUTPUT)
    else:
        _print(report, console)
        print_next(*_following(report, vehicle, bundle, record, [reference, link, signing_key]))
    if not report.landed:
        raise VehicleError(f"The flight did not end with a landing: {report.outcome}.")
    if not report.completed:
        raise VehicleError(f"The flight was cut short and landed: {report.landing_reason}.")


def _for(reference: str, effects: str) -> str:
    """The reference with the effects that it is to show. Raises RequestError unless the reference is `identify`."""
    if not is_identification(reference):
        raise RequestError(
            f"--for {effects} belongs to --reference identify: manoeuvre {reference} cannot be planned for effects."
        )
    words = "+".join(filter(None, effects.replace(",", "+").split("+")))
    return f"{reference}{',' if ':' in reference else ':'}for={words}"


def _following(
    report: FlightReport, vehicle: str | None, bundle: Path | None, record: Path | None, flown: list[object]
) -> list[object]:
    """Next command: diagnose the recording, or fly once more and record."""
    if record is not None and report.recording:
        parts = parts_of(Path(report.recording)).values() or [report.recording]
        return ["diagnose", *parts, "--vehicle", vehicle or f"{bundle}/vehicle.toml"]
    again = options(
        [
            ("--vehicle", vehicle),
            ("--bundle", bundle),
            ("--reference", flown[0]),
            ("--link", flown[1]),
            ("--signing-key", flown[2]),
        ]
    )
    return ["fly", *again, "--record", "recordings"]


def _announce(console: Console, text: str) -> None:
    console.print(text, style="yellow" if text.startswith("warning: ") else None, markup=False)


def _print(report: FlightReport, console: Console) -> None:
    table = Table(title="flight", title_justify="left", show_header=False)
    table.add_row("ended", report.outcome + (f" ({report.landing_reason})" if report.landing_reason else ""))
    tracking, timing = report.tracking, report.timing
    if tracking.samples:
        table.add_row("position error", f"{tracking.position_rmse:.3f} m RMS, {tracking.position_max:.3f} m at most")
        table.add_row("attitude error", f"{tracking.attitude_rmse:.3f} rad RMS")
        table.add_row("maximum speed", f"{tracking.speed_max:.2f} m/s")
    table.add_row("estimates", f"{report.estimate_rate:.0f} Hz")
    table.add_row("arrival to departure", _milliseconds(timing.latency))
    table.add_row("between setpoints", _milliseconds(timing.interval))
    missed = ", ".join(f"{count} by {cause}" for cause, count in timing.missed.items())
    table.add_row("late setpoints", f"of {timing.ticks}: {missed}; {timing.ticks_by_clock} ticks without an estimate")
    table.add_row("scheduling", report.scheduling)
    if report.followed is not None:
        for name, value in report.followed.parameters.items():
            table.add_row(name, f"{value.value:.3g} +- {value.std:.2g} (in the model {value.before:.3g})")
        disturbance = ", ".join(f"{part:.2f}" for part in report.followed.disturbance[:3])
        table.add_row("disturbance", f"{disturbance} m/s^2 at the end")
        if report.followed.network_change:
            change = ", ".join(f"{part:.2f}" for part in report.followed.network_change)
            errors = "{:.2f} with, {:.2f} m/s^2 without".format(*report.followed.network_errors)
            table.add_row("last layer", f"changed by {change} m/s^2 RMS; forecast errors {errors}")
    if report.events:
        table.add_row("events", ", ".join(f"{name} {count}x" for name, count in report.events.items()))
    table.add_row("thrust", f"{report.effectiveness:.3f} of the vehicle file's")
    table.add_row("recording", report.recording or "none, give --record DIR")
    console.print(table)


def _milliseconds(figures: dict[str, float]) -> str:
    return ", ".join(f"{name} {1e3 * value:.2f} ms" for name, value in figures.items())
