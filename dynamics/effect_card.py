"""What a user should know of an effect before flying for it: formula, usual size, what shows it, what looks alike."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterable, Mapping
from dataclasses import fields
from typing import Any

import msgspec

from dynamics.effect import Effect, Parameter
from dynamics.effects import CATALOGUE
from dynamics.vehicle import Vehicle


class ParameterCard(msgspec.Struct, frozen=True):
    """One number of an effect.

    unit: SI.
    usual, usual_deviation: its value before any flight of the vehicle, in the unit; None without a vehicle.
    lower, upper: physical bounds.
    neutral: the value at which the effect vanishes.
    """

    name: str
    unit: str
    meaning: str
    lower: float
    upper: float
    neutral: float
    usual: float | None = None
    usual_deviation: float | None = None


class EffectCard(msgspec.Struct, frozen=True):
    """One effect of the catalogue.

    summary: what it does, in a few words.
    formula: the equations of its hooks, one a line.
    source: where the formula comes from.
    parameters: its numbers.
    needs: groups of logged quantities, of each group at least one.
    shows_from: the motion that shows it well, such as "speed 4 m/s"; what no log contains, otherwise.
    fly: a flight that shows it.
    separate: a manoeuvre that separates it from others.
    confounded_with: effects with nearly the same signal in most flights.
    per_rotor: whether it acts on one rotor.
    of_sensors: whether it changes readings and not the motion.
    """

    name: str
    summary: str
    formula: tuple[str, ...]
    source: str
    parameters: tuple[ParameterCard, ...]
    needs: tuple[tuple[str, ...], ...]
    shows_from: str
    fly: str
    separate: str
    confounded_with: tuple[str, ...]
    per_rotor: bool
    of_sensors: bool


def effect_cards(
    vehicle: Vehicle | None = None, *, catalogue: Mapping[str, Effect] = CATALOGUE
) -> tuple[EffectCard, ...]:
    """A card for every effect of a catalogue, in its order. vehicle: for usual sizes."""
    return tuple(_card(effect, vehicle, catalogue.values()) for effect in catalogue.values())


def _card(effect: Effect, vehicle: Vehicle | None, others: Iterable[Effect]) -> EffectCard:
    excitation = effect.excitation
    alike = [*effect.confounded_with, *(o.name for o in others if effect.name in o.confounded_with)]
    shows_from, fly, separate = "", "", ""
    if excitation is not None:
        shows_from = excitation.unlogged and f"what no log contains: {excitation.unlogged}"
        if excitation.measure:
            unit = "" if excitation.unit == "1" else f" {excitation.unit}"
            shows_from = f"{excitation.measure.replace('_', ' ')} {excitation.enough:g}{unit}"
        fly, separate = excitation.flight, excitation.manoeuvre
    return EffectCard(
        name=effect.name,
        summary=effect.summary,
        formula=tuple(_formulas(effect)),
        source=effect.source,
        parameters=tuple(_parameter(p, vehicle) for p in effect.parameters),
        needs=excitation.channels if excitation is not None else (),
        shows_from=shows_from,
        fly=fly,
        separate=separate,
        confounded_with=tuple(dict.fromkeys(alike)),
        per_rotor=effect.per_rotor,
        of_sensors=not effect.moves_vehicle,
    )


def _parameter(parameter: Parameter, vehicle: Vehicle | None) -> ParameterCard:
    common = {f.name: getattr(parameter, f.name) for f in fields(parameter) if f.name != "prior"}
    if vehicle is None:
        return ParameterCard(**common)
    prior = parameter.prior(vehicle)
    return ParameterCard(**common, usual=float(prior.mean), usual_deviation=float(prior.std))


def _formulas(effect: Effect) -> Iterable[str]:
    """The docstrings' first paragraphs of the hooks that the effect's own module defines."""
    hooks: tuple[Callable[..., Any] | None, ...] = (
        *(effect.physics, effect.rotor_speed, effect.wind),
        *(effect.wrench, effect.derivative, effect.measurement),
    )
    for hook in hooks:
        text = "" if hook is None else inspect.getdoc(hook) or ""
        if text:
            yield " ".join(text.split("\n\n")[0].split())
