"""`alula effects`: the catalogue, and what to know of one effect."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console
from rich.table import Table

import alula
from alula.cli.options import Effects
from dynamics.files import STANDARD_OUTPUT, write_json

if TYPE_CHECKING:
    from dynamics.effect_card import EffectCard, ParameterCard


def effects(
    names: Annotated[list[str] | None, typer.Argument(help="Effects; by default all, one line each.")] = None,
    vehicle: Annotated[
        str | None, typer.Option("--vehicle", help="Vehicle file, or the name of a bundled one: for usual sizes.")
    ] = None,
    effects: Effects = None,
    json: Annotated[Path | None, typer.Option(help="Write the cards as JSON; - for standard output.")] = None,
) -> None:
    """List the effects that Alula knows: formula, units, usual size, what to fly to see one, what looks like it."""
    cards = alula.describe_effects(names or (), vehicle, effect_files=effects or ())
    if json is not None:
        write_json(cards, json)
    if json == STANDARD_OUTPUT:
        return
    console = Console()
    if not names:
        _print_list(cards, console)
        return
    for card in cards:
        _print_card(card, console)


def _print_list(cards: tuple[EffectCard, ...], console: Console) -> None:
    table = Table("effect", "what it does", "parameters", box=None, pad_edge=False)
    for card in cards:
        table.add_row(card.name, card.summary, ", ".join(f"{p.name} {_unit(p)}".strip() for p in card.parameters))
    console.print(table)
    console.print("next: alula effects NAME --vehicle VEHICLE.toml", highlight=False)


def _print_card(card: EffectCard, console: Console) -> None:
    console.print(f"[bold]{card.name}[/bold]: {card.summary}", highlight=False)
    for line in card.formula:
        console.print(f"  {line}", highlight=False, markup=False)
    for parameter in card.parameters:
        console.print(f"  {_described(parameter)}", highlight=False, markup=False)
    lines = {
        "acts on": "one rotor" * card.per_rotor,
        "needs in the log": "; ".join(" or ".join(group) for group in card.needs),
        "shows well from": card.shows_from,
        "fly": card.fly,
        "to separate it": card.separate,
        "looks like": ", ".join(card.confounded_with),
        "source": card.source,
    }
    for heading, text in lines.items():
        if text:
            console.print(f"  {heading}: {text}", highlight=False, markup=False)
    console.print()


def _described(parameter: ParameterCard) -> str:
    """A parameter in one line."""
    usual = ""
    if parameter.usual is not None:
        usual = f"usually {parameter.usual:.3g} +- {parameter.usual_deviation:.2g}, "
    bounds = f"from {parameter.lower:g} to {parameter.upper:g}"
    name = f"{parameter.name} {_unit(parameter)}".strip()
    return f"{name}: {parameter.meaning}; {usual}{bounds}, none at {parameter.neutral:g}"


def _unit(parameter: ParameterCard) -> str:
    return "" if parameter.unit == "1" else f"({parameter.unit})"
