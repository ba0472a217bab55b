"""Report of an addition, as `alula add --json` writes it."""

from __future__ import annotations

import msgspec

from diagnosis.addition import Addition
from diagnosis.estimation.refusal import Refused
from diagnosis.models.open_loop import HorizonError
from diagnosis.report import ChannelError, ParameterValue


class BeforeAfter(msgspec.Struct, frozen=True):
    """A number on the held-out flights without the effect and with it."""

    before: float
    after: float


class OpenLoop(msgspec.Struct, frozen=True):
    """Prediction errors on held-out flights without the effect and with it; empty where the logs hold no pose."""

    before: tuple[HorizonError, ...]
    after: tuple[HorizonError, ...]


class AdditionReport(msgspec.Struct, frozen=True):
    """Document that `alula add --json` writes.

    effect: the first that was added, by its name in the model, the rotor in brackets.
    effects: all of them.
    parameters: of all effects that were fitted.
    channels: RMS on held-out flights and floor.
    chi_square: reduced, on held-out flights; 1 where the residuals are noise.
    open_loop: prediction errors.
    refused: effects that were selected and not added, each with its reason.
    notes: to the user.
    vehicle: the file that was written.
    """

    effect: str
    effects: tuple[str, ...]
    parameters: dict[str, dict[str, ParameterValue]]
    channels: dict[str, ChannelError]
    chi_square: BeforeAfter = msgspec.field(name="misfit")
    open_loop: OpenLoop
    refused: tuple[Refused, ...]
    notes: tuple[str, ...]
    vehicle: str = ""


def report(added: Addition) -> AdditionReport:
    """An addition as a program reads it, but for the name of the file."""
    parameters: dict[str, dict[str, ParameterValue]] = {}
    for (key, name), estimate in added.estimates.items():
        parameters.setdefault(key, {})[name] = ParameterValue(estimate.value, estimate.std, estimate.unit)
    return AdditionReport(
        effect=added.keys[0],
        effects=added.keys,
        parameters=parameters,
        channels=dict(added.channels),
        chi_square=BeforeAfter(*added.chi_square),
        open_loop=OpenLoop(*added.open_loop),
        refused=added.refused,
        notes=added.notes,
    )
