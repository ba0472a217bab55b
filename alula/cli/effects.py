"""`alula effects`: the catalogue, and what to know of one effect."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.table import Table

import alula
from alula.cli.console import Console
from alula.cli.options import Effects
from alula.cli.output import print_next
from dynamics.files import STANDARD_OUTPUT, write_answer
from dynamics.vehicle import EffectUse
from dynamics.vehicle_file import effect_text

if TYPE_CHECKING:
    from dynamics.effect import Parameter, Prior
    from dynamics.effect_card import EffectCard


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
        write_answer([card.as_json for card in cards], json)
    if json == STANDARD_OUTPUT:
        return
    console = Console()
    if not names:
        _print_list(cards, console)
        return
    for card in cards:
        _print_card(card, console)
    print_next("mock", "--vehicle", vehicle or "arpl_250g", "--effect", _hidden(cards[-1]))


def _print_list(cards: tuple[EffectCard, ...], console: Console) -> None:
    table = Table("effect", "what it does", "parameters", box=None, pad_edge=False)
    for card in cards:
        effect = card.effect
        table.add_row(effect.name, effect.summary, ", ".join(f"{p.name} {_unit(p)}".strip() for p in effect.parameters))
    console.print(table)
    print_next("effects", cards[0].effect.name, "--vehicle", "arpl_250g")


def _hidden(card: EffectCard) -> str:
    """An effect as the mock hides it: of its usual size where the vehicle is known."""
    usual = {p.name: prior.mean for p in card.effect.parameters if (prior := card.usual(p)) is not None}
    values = {name: float(f"{value:.3g}") for name, value in usual.items()}
    return effect_text(EffectUse(card.effect.name, values, 0 if card.effect.per_rotor else None))


def _print_card(card: EffectCard, console: Console) -> None:
    console.print(f"[bold]{card.effect.name}[/bold]: {card.effect.summary}", highlight=False)
    for line in card.formula:
        console.print(f"  {line}", highlight=False, markup=False)
    for parameter in card.effect.parameters:
        console.print(f"  {_described(parameter, card.usual(parameter))}", highlight=False, markup=False)
    lines = {
        "acts on": "one rotor" * card.effect.per_rotor,
        "needs in the log": "; ".join(" or ".join(group) for group in card.needs),
        "shows well from": card.shows_from,
        "fly": card.fly,
        "to separate it": card.separate,
        "looks like": ", ".join(card.confounded_with),
        "source": card.effect.source,
    }
    for heading, text in lines.items():
        if text:
            console.print(f"  {heading}: {text}", highlight=False, markup=False)
    console.print()


def _described(parameter: Parameter, prior: Prior | None) -> str:
    """A parameter in one line."""
    usual = "" if prior is None else f"usually {prior.mean:.3g} +- {prior.std:.2g}, "
    bounds = f"from {parameter.lower:g} to {parameter.upper:g}"
    name = f"{parameter.name} {_unit(parameter)}".strip()
    return f"{name}: {parameter.meaning}; {usual}{bounds}, none at {parameter.neutral:g}"


def _unit(parameter: Parameter) -> str:
    return "" if parameter.unit == "1" else f"({parameter.unit})"
