"""A user's own effects: one Python file with an `EFFECT` in it, or several as `EFFECTS`."""

from __future__ import annotations

import runpy
import traceback
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from dynamics.effect import Effect
from dynamics.effects import CATALOGUE
from dynamics.errors import RequestError
from dynamics.model import ENVIRONMENT_DEFAULT, build_model
from dynamics.state import RIGID_BODY_STATES
from dynamics.vehicle import EffectUse, Vehicle

EXAMPLE = "See examples/my_effects.py."


def read_effects(path: str | Path) -> tuple[Effect, ...]:
    """The effects that a Python file defines. Raises RequestError when it cannot be run or defines none."""
    path = Path(path)
    if not path.is_file():
        raise RequestError(f"{path} is no file. Give a Python file that defines EFFECT. {EXAMPLE}")
    try:
        names = runpy.run_path(str(path))
    except Exception as error:  # a user's file may raise anything
        line = next(
            (f.lineno for f in reversed(traceback.extract_tb(error.__traceback__)) if f.filename == str(path)), 0
        )
        raise RequestError(f"{path}, line {line or '?'}: {type(error).__name__}: {error}. {EXAMPLE}") from None
    found = names.get("EFFECTS", names.get("EFFECT"))
    effects = tuple(found) if isinstance(found, Iterable) else (found,)
    if not effects or not all(isinstance(effect, Effect) for effect in effects):
        raise RequestError(f"{path} defines no EFFECT that is a dynamics.effect.Effect. {EXAMPLE}")
    return effects


def with_effects_of(files: Iterable[str | Path], vehicle: Vehicle) -> Mapping[str, Effect]:
    """The catalogue and the effects of further files, each tried on the vehicle once.

    Raises RequestError for a file that defines none, a name that is taken, or an effect that fails on the vehicle.
    """
    catalogue = dict(CATALOGUE)
    for path in files:
        for effect in read_effects(path):
            if effect.name in catalogue:
                raise RequestError(f"{path}: there is an effect {effect.name!r} already; give yours another name.")
            _try(effect, vehicle, path)
            catalogue[effect.name] = effect
    return catalogue


def _try(effect: Effect, vehicle: Vehicle, path: str | Path) -> None:
    """Evaluate an effect in hover at its usual values; whatever it does wrong becomes a RequestError."""
    use = EffectUse(effect.name, {}, 0 if effect.per_rotor else None)
    try:
        model = build_model(vehicle, effects=[use], catalogue={effect.name: effect})
        state = model.initial_state(_hover())
        result: Any = model.observe(state, vehicle.hover_speed, model.parameter_values, ENVIRONMENT_DEFAULT)[0]
    except Exception as error:
        raise RequestError(f"{path}: effect {effect.name!r} fails in hover: {type(error).__name__}: {error}") from None
    if not result.is_regular():
        raise RequestError(f"{path}: effect {effect.name!r} gives a force that is no number in hover: {result}.")


def _hover() -> Any:
    state = [0.0] * RIGID_BODY_STATES
    state[2], state[6] = 1.0, 1.0
    return state
