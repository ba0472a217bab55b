"""`alula vehicle`: vehicle files made of parts or of logs, compared with logs, and shown as a picture."""

from __future__ import annotations

import re
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.table import Table

import alula
from alula.cli.console import Console
from alula.cli.intake import note_skipped, vehicle_of_logs
from alula.cli.options import Effects, Logs, OneFlight, RecordedSystem, VehicleOption
from alula.cli.options import Mapping as MappingOption
from alula.cli.output import command, options, print_next
from dynamics.autopilot_frames import AUTOPILOTS, FRAMES
from dynamics.errors import DataError, RequestError
from dynamics.files import STANDARD_OUTPUT, write_answer, write_json
from dynamics.vehicle_file import find_vehicle, write_vehicle_text

if TYPE_CHECKING:
    from diagnosis.vehicle_check import VehicleCheck
    from dynamics.vehicle_draft import Draft

UNITS: Mapping[str, float] = {"": 1.0, "kg": 1.0, "g": 1e-3, "m": 1.0, "cm": 1e-2, "mm": 1e-3, "in": 0.0254}
QUESTIONS = {
    "mass": "Mass, ready to fly (kg; 850g)",
    "arm": "From the centre to a motor's axis (m; 225mm)",
    "propeller": "Diameter of a propeller (m; 10in)",
    "kv": "kV of the motors (rpm/V)",
    "cells": "Cells of the battery in series",
}
Json = Annotated[Path | None, typer.Option("--json", help="Write the answer as JSON; - for standard output.")]
Out = Annotated[Path | None, typer.Option(help="File to write; by default NAME.toml.")]
Mass = Annotated[str | None, typer.Option(help="Mass as flown, kg; or with its unit, 850g.")]
Arm = Annotated[str | None, typer.Option(help="From the centre to the outermost motor's axis, m; or 225mm.")]
Propeller = Annotated[str | None, typer.Option(help="Diameter of a propeller, m; or 10in.")]

commands = typer.Typer(no_args_is_help=True, context_settings={"help_option_names": ["-h", "--help"]})


@commands.callback()
def vehicle() -> None:
    """Make a vehicle file of parts or of logs, compare one with logs, show its layout, print its schema."""


@commands.command()
def new(
    name: Annotated[str, typer.Argument(help="Name of the vehicle.")] = "vehicle",
    mass: Mass = None,
    arm: Arm = None,
    propeller: Propeller = None,
    kv: Annotated[str | None, typer.Option(help="Of the motors, rpm/V.")] = None,
    cells: Annotated[str | None, typer.Option(help="Of the battery, in series.")] = None,
    frame: Annotated[str, typer.Option(help=f"{', '.join(FRAMES)}.")] = "quad_x",
    blades: Annotated[int, typer.Option(min=2, max=6, help="Of a propeller.")] = 2,
    out: Out = None,
    json: Json = None,
) -> None:
    """Make a vehicle file by rules of thumb, from what is written on the parts; asks for what is not given."""
    answers = {"mass": mass, "arm": arm, "propeller": propeller, "kv": kv, "cells": cells}
    numbers = {key: quantity(text, key) for key, text in _answered(answers).items()}
    if not numbers["cells"].is_integer():
        raise RequestError(f"--cells {numbers['cells']:g} is no whole number.")
    draft = alula.new_vehicle(
        name,
        mass=numbers["mass"],
        arm=numbers["arm"],
        propeller=numbers["propeller"],
        kv=numbers["kv"],
        cells=round(numbers["cells"]),
        frame=frame,
        blades=blades,
    )
    path = out or Path(f"{name}.toml")
    write_vehicle_text(draft.toml if draft.vehicle else "", path)
    _report(draft, path, json, ["vehicle", "show", path])


@commands.command("from-log")
def from_log(
    logs: Logs,
    name: Annotated[str, typer.Option(help="Name of the vehicle.")] = "vehicle",
    mass: Mass = None,
    arm: Arm = None,
    propeller: Propeller = None,
    speed_max: Annotated[
        float | None, typer.Option(min=1.0, help="Of a rotor at full signal, rad/s, for logs without rotor speeds.")
    ] = None,
    frame: Annotated[
        str | None, typer.Option(help=f"For logs that state no layout of rotors, with --arm: {', '.join(FRAMES)}.")
    ] = None,
    autopilot: Annotated[
        str | None,
        typer.Option(help=f"Whose motor numbers a --frame has, by default the logs': {', '.join(AUTOPILOTS)}."),
    ] = None,
    mapping: MappingOption = None,
    system: RecordedSystem = None,
    one_flight: OneFlight = False,
    out: Out = None,
    json: Json = None,
) -> None:
    """Make a vehicle file of logs: layout by the autopilot's parameters, constants from the flights, with intervals.

    Where no parameters state the layout, as in a CSV file: --frame quad_x --arm 0.225.
    Without --mass nothing is written: flights cannot show it, and everything else scales with it.
    """
    note_skipped(logs, mapping)
    made = alula.vehicle_from_logs(
        logs,
        name,
        mass=None if mass is None else quantity(mass, "mass"),
        arm=None if arm is None else quantity(arm, "arm"),
        propeller=None if propeller is None else quantity(propeller, "propeller"),
        speed_max=speed_max,
        frame=frame,
        autopilot=autopilot,
        mapping=mapping,
    )
    if not made.draft.is_complete:
        layout_options: list[tuple[str, object]] = [("--arm", arm), ("--frame", frame), ("--autopilot", autopilot)]
        layout_options += [("--system", system), ("--one-flight", one_flight)]
        words = ["vehicle", "from-log", *logs, "--name", name, "--mass", "KG", *options(layout_options)]
        _report(made.draft, None, json, words)
        return
    path = out or Path(f"{name}.toml")
    write_vehicle_text(made.draft.toml if made.draft.vehicle else "", path)
    shared = options([("--system", system), ("--one-flight", one_flight)])
    _report(made.draft, path, json, ["diagnose", *logs, "--vehicle", path, *shared])


@commands.command()
def check(
    logs: Logs,
    vehicle: VehicleOption = None,
    effects: Effects = None,
    mapping: MappingOption = None,
    system: RecordedSystem = None,
    one_flight: OneFlight = False,
    json: Json = None,
) -> None:
    """Compare a vehicle file with logs: layout, thrust, inertia, motor lag; what disagrees, and by how much."""
    vehicle = vehicle_of_logs(logs, vehicle, mapping)
    answer = alula.check_vehicle(logs, vehicle, effect_files=effects or (), mapping=mapping)
    if json is not None:
        write_answer(answer, json)
    if json != STANDARD_OUTPUT:
        _print_check(answer, logs, vehicle)
    if all(number.answer == "open" for number in answer.numbers):
        raise DataError(f"these logs say nothing of {vehicle}. Fly rolls, pitches and yaw steps, and log the motors.")


@commands.command()
def show(
    vehicle: Annotated[str, typer.Argument(help="Vehicle file (TOML), or the name of a bundled one.")],
    out: Annotated[Path | None, typer.Option(help="Picture to write: .png, .svg or .pdf; by default NAME.png.")] = None,
    effects: Effects = None,
    json: Json = None,
) -> None:
    """Show a vehicle's rotors: place, the autopilot's motor number, turning direction; as a table and a picture."""
    from alula.workbench import workbench
    from dynamics.rotor_places import rotor_names

    loaded = alula.load_vehicle(vehicle, effect_files=effects or ())
    with workbench("alula vehicle show"):
        from studio.pages.vehicle_picture import TURNING, draw_layout
    path = draw_layout(loaded, out or Path(f"{find_vehicle(vehicle).stem}.png"))
    rotors = [
        {"name": name, "position": list(position), "turns": TURNING[spin][1]}
        for name, position, spin in zip(rotor_names(loaded), loaded.rotors.position, loaded.rotors.spin, strict=True)
    ]
    if json is not None:
        write_answer({"vehicle": loaded.name, "rotors": rotors, "picture": str(path)}, json)
    if json == STANDARD_OUTPUT:
        return
    console = Console()
    table = Table("rotor", "turns, seen from above", "forward, left, up, m", box=None, pad_edge=False)
    for rotor, position in zip(rotors, loaded.rotors.position, strict=True):
        table.add_row(str(rotor["name"]), str(rotor["turns"]), ", ".join(f"{value:g}" for value in position))
    console.print(table)
    thrust = loaded.rotors.thrust_max / loaded.weight
    console.print(
        f"hover at {loaded.hover_speed:.4g} rad/s; full thrust is {thrust:.2f} times the weight", highlight=False
    )
    console.print(f"written: {path}", highlight=False)
    print_next("mock", "--vehicle", vehicle)


@commands.command()
def schema(
    out: Annotated[Path, typer.Option(help="File to write; - for standard output.")] = STANDARD_OUTPUT,
) -> None:
    """Print the JSON Schema of the vehicle file, by which editors complete keys and show units and bounds."""
    from dynamics.vehicle_schema import vehicle_schema

    write_json(vehicle_schema(), out)  # whose keys are those of JSON Schema


def quantity(text: str, name: str) -> float:
    """A number in SI units from a text such as "0.85", "850g" or "10in". Raises RequestError for anything else."""
    match = re.fullmatch(r"\s*([-+0-9.eE]+?)\s*([a-z]*)\s*", text)
    units = {"mass": ("", "kg", "g"), "arm": ("", "m", "cm", "mm", "in"), "propeller": ("", "m", "cm", "mm", "in")}
    allowed = units.get(name, ("",))
    try:
        number = float(match.group(1)) if match is not None and match.group(2) in allowed else None
    except ValueError:
        number = None
    if match is None or number is None:
        units_allowed = " or ".join(filter(None, allowed))
        raise RequestError(f"--{name} {text!r} is no number" + (f" with {units_allowed}." if units_allowed else "."))
    return number * UNITS[match.group(2)]


def _answered(answers: Mapping[str, str | None]) -> dict[str, str]:
    """Options, and answers to questions for those missing. Raises RequestError where nobody can be asked."""
    missing = [f"--{name}" for name, text in answers.items() if text is None]
    if missing and not sys.stdin.isatty():
        raise RequestError(f"{', '.join(missing)} missing: give them, or run this in a terminal, which asks for them.")
    return {name: typer.prompt(QUESTIONS[name]) if text is None else text for name, text in answers.items()}


def _report(draft: Draft, path: Path | None, json: Path | None, following: list[object]) -> None:
    if json is not None:
        write_answer({"path": None if path is None else str(path), "draft": draft, "next": command(*following)}, json)
    if json == STANDARD_OUTPUT:
        return
    console = Console()
    for entry in draft.entries:
        value = "open" if entry.value is None else _shown(entry.value)
        parts = (entry.key.partition(".")[2], "=", value, entry.interval, entry.unit)
        console.print(" ".join(filter(None, parts)), highlight=False, markup=False)
        console.print(f"  {entry.described}", highlight=False, markup=False, style="dim")
    for text in draft.open:
        console.print(f"cannot be told: {text}", highlight=False, markup=False)
    for note in draft.notes:
        console.print(f"note: {note}", highlight=False, markup=False)
    if path is not None:
        console.print(f"written: {path}", highlight=False, markup=False)
    print_next(*following)


def _shown(value: object) -> str:
    if isinstance(value, (list, tuple)):
        return "[" + ", ".join(_shown(item) for item in value) + "]"
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def _print_check(answer: VehicleCheck, logs: list[Path], vehicle: str) -> None:
    console = Console()
    colours = {"agrees": "green", "disagrees": "red", "open": "yellow"}
    for number in answer.numbers:
        console.print(f"[{colours[number.answer]}]{number.answer}[/]: ", end="")
        console.print(f"{number.name}: {number.text}", highlight=False, markup=False)
    for note in answer.notes:
        console.print(f"note: {note}", highlight=False, markup=False)
    wrong = sum(number.answer == "disagrees" for number in answer.numbers)
    console.print(
        f"{wrong} of {len(answer.numbers)} numbers disagree" if wrong else "nothing disagrees", highlight=False
    )
    if wrong:
        print_next("vehicle", "from-log", *logs, "--mass", "KG", "--arm", "M")
    else:
        print_next("diagnose", *logs, "--vehicle", vehicle)
