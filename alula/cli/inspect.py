"""`alula inspect`: whether a log is good enough, and for what."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.box import SIMPLE_HEAD
from rich.table import Table

import alula
from alula.api.inputs import log_paths
from alula.cli.console import Console
from alula.cli.escaping import printable
from alula.cli.health import print_health, with_health
from alula.cli.intake import note_skipped
from alula.cli.options import Effects, Mapping, OneFlight, Pose, RecordedSystem
from alula.cli.output import options, print_next
from dynamics.errors import AlulaError, DataError
from dynamics.files import STANDARD_OUTPUT, write_answer
from studio.pages.provenance import origin

if TYPE_CHECKING:
    from flights import Log
    from flights.health import Health
    from flights.quality import Inspection
    from studio.pages.inspected import Section

AUTOPILOTS = ("PX4 ULog", "ArduPilot DataFlash log")  # formats whose logs state the layout of rotors
MINOR = (
    "armed",
    "landed",
    "reset_counter",
    "position_reset_counter",
    "velocity_reset_counter",
    "attitude_reset_counter",
)
ONE_FLIGHT = "--one-flight"  # in a note of a log that is a part of a flight
POSES = {
    "motion_capture": "from motion capture",
    "estimator": "from an estimator that used the accelerometer, so that their agreement proves nothing",
}
COLOURS = {
    "good": "green",
    "limited": "yellow",
    "unusable": "red",
    "yes": "green",
    "weakly": "yellow",
    "no": "dim",
    "error": "red",
    "warning": "yellow",
    "note": "dim",
}


def inspect(
    log: Annotated[list[Path], typer.Argument(help="Logs of any known format, or folders of them.", metavar="LOG...")],
    mapping: Mapping = None,
    system: RecordedSystem = None,
    pose: Pose = None,
    one_flight: OneFlight = False,
    effects: Effects = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the verdicts as JSON.")] = False,
    html: Annotated[Path | None, typer.Option(help="Write a page with plots, which needs no network.")] = None,
    repair: Annotated[
        Path | None,
        typer.Option(help="Write a mapping file that repairs columns that are not what they declare; inspect by it."),
    ] = None,
    everything: Annotated[bool, typer.Option("--all", help="Show every channel and measure.")] = False,
) -> None:
    """Check logs: what broke in the flight, rates, gaps, clocks, frozen channels, excitation, what it identifies."""
    inspections: list[Inspection] = []
    answers: list[Health] = []
    sections: list[Section] = []
    refused: list[AlulaError] = []
    note_skipped(log, mapping)
    paths = log_paths(log, mapping)
    mapping = mapping if repair is None else _repaired(paths, mapping, repair)
    for files in [paths] if one_flight else [[path] for path in paths]:
        try:
            streams = _read(files, mapping, pose)
            answers.append(alula.assess_health(streams))
            inspections.append(alula.inspect(streams, effect_files=effects or ()))
            if html is not None:
                sections.append(_section(inspections[-1], streams))
        except AlulaError as error:
            if len(answers) > len(inspections):  # read, but nothing in it to inspect: what it tells comes first
                print_health(answers.pop(), Console(), everything=everything, muted=as_json)
            if len(paths) == 1 or one_flight:
                raise
            refused.append(error)
    if as_json:
        write_answer(with_health(inspections, answers), STANDARD_OUTPUT)
    else:
        console = Console()
        for inspection, health in zip(inspections, answers, strict=True):
            console.rule(inspection.path, align="left")
            print_health(health, console, everything=everything)
            _print(inspection, console, everything=everything)
    if html is not None:
        from studio.pages.inspected import inspection_page
        from studio.pages.page import write_page

        hashes = {inspection.path: inspection.sha256 for inspection in inspections}
        write_page(inspection_page(sections, origin=origin(hashes)), html)
        print(f"written: {html}", file=sys.stderr)
    _end(inspections, refused)
    if not as_json:
        states_layout = any(inspection.format in AUTOPILOTS for inspection in inspections)
        print_next(
            *(
                ["vehicle", "from-log", *log, *options([("--system", system), ("--one-flight", one_flight)])]
                if states_layout
                else ["vehicle", "new"]
            )
        )


def _read(files: list[Path], mapping: Path | None, pose: str | None) -> Log:
    """The streams of a log, or of several files of one flight."""
    if len(files) == 1:
        return alula.read_log(files[0], mapping=mapping, pose=pose)
    from flights.one_flight import read_one_flight

    return read_one_flight(files, mapping=mapping, pose=pose)


def _repaired(paths: list[Path], mapping: Path | None, repair: Path) -> Path | None:
    """The mapping to read logs by: a new file with the repairs of the first, or the given one where it needs none."""
    from flights.hypotheses.mapping_file import write_repairs
    from flights.reading import found_hypotheses

    hypotheses = [one for one in found_hypotheses(paths[0], mapping=mapping) if one.repairs]
    if not hypotheses:
        print(
            f"nothing to repair: the columns of {printable(str(paths[0]))} agree, or move too little", file=sys.stderr
        )
        return mapping
    write_repairs(hypotheses, repair, log=paths[0], mapping=mapping)
    print(f"written: {repair}; give it as --mapping to the other commands", file=sys.stderr)
    return repair


def _section(inspection: Inspection, streams: Log) -> Section:
    from studio.pages.inspected import section

    return section(inspection, alula.Flight.from_log(streams))


def _end(inspections: list[Inspection], refused: list[AlulaError]) -> None:
    """Raise the error of the worst log, if there is one."""
    for error in refused:
        print(printable(f"alula: {error}"), file=sys.stderr)
    if refused:
        raise type(refused[0])(f"{len(refused)} of {len(inspections) + len(refused)} logs could not be read.")
    unusable = [inspection for inspection in inspections if inspection.verdict == "unusable"]
    if unusable:
        raise DataError("; ".join(f"{inspection.path}: {inspection.sentence}" for inspection in unusable))


def _print(inspection: Inspection, console: Console, *, everything: bool) -> None:
    from flights.log import DAMAGE

    colour = COLOURS[inspection.verdict]
    console.print(f"[bold {colour}]{inspection.sentence}[/]", highlight=False)
    console.print(
        f"{inspection.format}, {inspection.duration:.1f} s, {inspection.free_flight:.1f} s of free flight in "
        f"{len(inspection.segments)} segments",
        highlight=False,
    )
    for repair in inspection.repairs:
        if repair.name in DAMAGE:
            console.print(f"[{COLOURS['warning']}]damaged[/]: {repair.detail}", highlight=False)
    if inspection.pose_source != "unknown":
        console.print(f"pose: {POSES[inspection.pose_source]}", highlight=False)
    for item in inspection.exclusions:
        console.print(f"left out: {item}", style="dim", highlight=False)
    _print_channels(inspection, console, everything=everything)
    for delay in sorted(inspection.delays, key=lambda delay: delay.is_response):
        doubt = "" if delay.is_known else ": too uncertain to use"
        console.print(f"{'response' if delay.is_response else 'clock'}: {delay}{doubt}", highlight=False)
    for finding in inspection.findings:
        if finding.name != "clock_offset":  # shown with the clocks
            advice = f"; {finding.advice}" if finding.advice else ""
            console.print(
                f"[{COLOURS[finding.severity]}]{finding.severity}[/]: {finding.text}{advice}", highlight=False
            )
    for text in inspection.inferences:
        console.print(f"understood: {text}", style="dim", highlight=False, markup=False)
    for unused in inspection.unused:
        is_named = any(str(unused) in finding.text for finding in inspection.findings)
        if (unused.is_candidate or everything) and not is_named:
            console.print(f"also logged: {unused}", style="dim", highlight=False, markup=False)
    _print_effects(inspection, console)
    if everything:
        _print_excitation(inspection, console)
    notes = [note for note in inspection.notes if note not in inspection.inferences]
    lines = (*notes, *map(str, inspection.repairs))
    for text in lines if everything else [text for text in lines if ONE_FLIGHT in text]:
        console.print(f"note: {text}", style="dim", highlight=False, markup=False)


def _print_channels(inspection: Inspection, console: Console, *, everything: bool) -> None:
    table = Table(title="channels", title_justify="left", box=SIMPLE_HEAD, padding=(0, 1, 0, 0))  # fits 80 columns
    table.add_column("quantity", no_wrap=True)
    for heading in ("Hz", "new Hz", "jitter ms", "gaps", "gap s"):
        table.add_column(heading, justify="right", no_wrap=True)
    table.add_column("noise", justify="right")
    for channel in inspection.channels:
        if not everything and (channel.quantity in MINOR or "setpoint" in channel.quantity):
            continue
        noise = f"{channel.noise:.2g} {channel.unit}".removesuffix(" 1")
        table.add_row(
            channel.quantity,
            f"{channel.rate:.1f}",
            f"{channel.renewed:.1f}",
            f"{1e3 * channel.jitter:.1f}",
            str(channel.gaps),
            f"{channel.longest_gap:.2f}",
            noise,
        )
    console.print(table)


def _print_effects(inspection: Inspection, console: Console) -> None:
    table = Table("effect", "identifiable", "why", title="what this log can identify", title_justify="left")
    for effect in inspection.effects:
        why = f"{effect.why}; looks like {effect.ambiguous_with}" if effect.ambiguous_with else effect.why
        table.add_row(effect.name, f"[{COLOURS[effect.answer]}]{effect.answer}[/]", why)
    console.print(table)


def _print_excitation(inspection: Inspection, console: Console) -> None:
    table = Table("measure", title="excitation in free flight", title_justify="left")
    table.add_column("value", justify="right")
    for measure in inspection.excitation:
        table.add_row(measure.name.replace("_", " "), f"{measure.value:.3g} {measure.unit}".removesuffix(" 1"))
    console.print(table)
