"""Effects by diagnosis: what `alula diagnose` names on the training flights becomes the base of a learned model."""

from __future__ import annotations

import datetime
from collections.abc import Mapping, Sequence
from pathlib import Path

import msgspec

from diagnosis.completion import complete
from diagnosis.data.dataset import read_dataset
from dynamics.effect import Effect
from dynamics.effects import CATALOGUE, motor_lag
from dynamics.errors import DataError
from dynamics.own_effects import catalogue_of
from dynamics.vehicle import EffectUse, Vehicle
from training.config import ModelConfig
from training.effects_fit import named_effects

DIAGNOSED = "diagnosed"  # in place of an effect's name
MAX_FLIGHTS = 16  # more of them take time and change no value by its interval


def with_diagnosed_effects(
    config: ModelConfig,
    vehicle: Vehicle,
    logs: Sequence[Path],
    *,
    mapping: Path | None = None,
    catalogue: Mapping[str, Effect] = CATALOGUE,
) -> tuple[Vehicle, str]:
    """The vehicle with the effects that are missing from its model on the logs, and a note that names them.

    Faults of sensors move no vehicle and are left out. Where the model reads commanded rotor speeds, a lag of the
    rotors is among the effects: measured speeds, which diagnosis prefers, cannot show it.

    Raises DataError when the flights cannot answer, or nothing is missing that a model could have as its base.
    """
    catalogue = catalogue_of(vehicle, catalogue)
    used = _spread(logs, MAX_FLIGHTS)
    today = datetime.datetime.now(tz=datetime.UTC).date().isoformat()
    completion = complete(read_dataset(used, vehicle, mapping=mapping), vehicle, catalogue, date=today)
    uses = tuple(use for use in completion.vehicle.effects if catalogue[use.name].measurement is None)
    identified = msgspec.structs.replace(vehicle, effects=uses)
    has_lag = any(catalogue[use.name].rotor_speed is not None for use in uses)
    if config.motors != "measured" and not has_lag:
        identified = named_effects(identified, [EffectUse(motor_lag.EFFECT.name)], catalogue)
    if not identified.effects:
        raise DataError(
            f"{DIAGNOSED}: nothing is missing from the model on these flights (verdict: "
            f"{completion.first.diagnosis.verdict}), so there is no effect to build on. res_tcn is the residual on the "
            "nominal model."
        )
    named = ", ".join(use.label for use in identified.effects)
    return (
        identified,
        f"effects by diagnosis of {len(used)} flights ({completion.last.diagnosis.verdict} then): {named}",
    )


def _spread(logs: Sequence[Path], count: int) -> list[Path]:
    """At most `count` of the logs, evenly spread over them."""
    if len(logs) <= count:
        return list(logs)
    return [logs[round(i * (len(logs) - 1) / (count - 1))] for i in range(count)]
