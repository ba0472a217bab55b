"""Card of an effect for who flies for it: formula, usual size, what shows it, what looks alike."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, fields
from typing import Any

from dynamics.effect import Effect, Parameter, Prior
from dynamics.effects import CATALOGUE
from dynamics.vehicle import Vehicle


@dataclass(frozen=True, eq=False)
class EffectCard:
    """An effect beside the others of its catalogue and a vehicle.

    effect: its name, summary, parameters and source.
    vehicle: for usual sizes; None for none.
    confounded_with: effects with nearly the same signal in most flights, by what either of the two states.
    """

    effect: Effect
    vehicle: Vehicle | None
    confounded_with: tuple[str, ...]

    @property
    def formula(self) -> tuple[str, ...]:
        """The equations of its hooks, one a line: the first paragraphs of their docstrings."""
        return tuple(_formulas(self.effect))

    @property
    def needs(self) -> tuple[tuple[str, ...], ...]:
        """Groups of logged quantities, of each group at least one."""
        return self.effect.excitation.channels if self.effect.excitation else ()

    @property
    def fly(self) -> str:
        """A flight that shows it."""
        return self.effect.excitation.flight if self.effect.excitation else ""

    @property
    def separate(self) -> str:
        """A manoeuvre that separates it from others."""
        return self.effect.excitation.manoeuvre if self.effect.excitation else ""

    @property
    def shows_from(self) -> str:
        """The motion that shows it well, such as "speed 4 m/s"; what no log contains, otherwise."""
        excitation = self.effect.excitation
        if excitation is None:
            return ""
        if not excitation.measure:
            return f"what no log contains: {excitation.unlogged}"
        unit = "" if excitation.unit == "1" else f" {excitation.unit}"
        return f"{excitation.measure.replace('_', ' ')} {excitation.enough:g}{unit}"

    def usual(self, parameter: Parameter) -> Prior | None:
        """A parameter's value before any flight of the vehicle; None without a vehicle."""
        return None if self.vehicle is None else parameter.prior(self.vehicle)

    @property
    def as_json(self) -> dict[str, Any]:
        """As `alula effects --json` writes it."""
        return {
            "name": self.effect.name,
            "summary": self.effect.summary,
            "formula": self.formula,
            "source": self.effect.source,
            "parameters": [self._parameter(parameter) for parameter in self.effect.parameters],
            "needs": self.needs,
            "shows_from": self.shows_from,
            "fly": self.fly,
            "separate": self.separate,
            "confounded_with": self.confounded_with,
            "per_rotor": self.effect.per_rotor,
            "of_sensors": not self.effect.moves_vehicle,
        }

    def _parameter(self, parameter: Parameter) -> dict[str, Any]:
        usual = self.usual(parameter)
        values = {field.name: getattr(parameter, field.name) for field in fields(parameter) if field.name != "prior"}
        return values | {"usual": usual and float(usual.mean), "usual_deviation": usual and float(usual.std)}


def effect_cards(
    vehicle: Vehicle | None = None, *, catalogue: Mapping[str, Effect] = CATALOGUE
) -> tuple[EffectCard, ...]:
    """A card for every effect of a catalogue, in its order. vehicle: for usual sizes."""
    return tuple(EffectCard(effect, vehicle, _alike(effect, catalogue)) for effect in catalogue.values())


def _alike(effect: Effect, catalogue: Mapping[str, Effect]) -> tuple[str, ...]:
    others = (other.name for other in catalogue.values() if effect.name in other.confounded_with)
    return tuple(dict.fromkeys((*effect.confounded_with, *others)))


def _formulas(effect: Effect) -> Iterator[str]:
    hooks: tuple[Callable[..., Any] | None, ...] = (
        *(effect.physics, effect.rotor_speed, effect.wind),
        *(effect.wrench, effect.derivative, effect.measurement),
    )
    for hook in hooks:
        text = "" if hook is None else inspect.getdoc(hook) or ""
        if text:
            yield " ".join(text.split("\n\n")[0].split())
