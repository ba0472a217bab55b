"""Effects of a user's own: what the Python files that a vehicle has define, once for each content."""

from __future__ import annotations

import traceback
from collections.abc import Iterable, Mapping
from functools import lru_cache

from dynamics.effect import Effect
from dynamics.effect_source import EXAMPLE, EffectFile
from dynamics.effects import CATALOGUE
from dynamics.errors import RequestError
from dynamics.trust import require_approved, run_effect_file
from dynamics.vehicle import Vehicle


def effects_of(file: EffectFile) -> tuple[Effect, ...]:
    """The effects that an approved file defines.

    Raises RequestError when the user has not approved it, and, with the line, when it cannot be run, defines none, or
    one that contradicts itself.
    """
    require_approved([file])
    return _effects_in(file)


def catalogue_of(vehicle: Vehicle, catalogue: Mapping[str, Effect] = CATALOGUE) -> Mapping[str, Effect]:
    """A catalogue and the effects of the files that a vehicle names. Raises RequestError for a file without any."""
    if not vehicle.effect_files:
        return catalogue
    own = {effect.name: effect for file in vehicle.effect_files for effect in effects_of(file)}
    return {**own, **catalogue}


def line_of(error: Exception, file: EffectFile) -> int | None:
    """The innermost line of a file in an error's traceback."""
    frames = traceback.extract_tb(error.__traceback__)
    return next((frame.lineno for frame in reversed(frames) if frame.filename == file.path), None)


@lru_cache(maxsize=64)
def _effects_in(file: EffectFile) -> tuple[Effect, ...]:
    """The effects of a file with some content, the same objects each time."""
    try:
        names = run_effect_file(file)
    except Exception as error:  # a user's file may raise anything
        line = error.lineno if isinstance(error, SyntaxError) else line_of(error, file)
        message = f"{file.path}, line {line or '?'}: {type(error).__name__}: {str(error).rstrip('.')}."
        alone = " An effect file stands alone: no file beside it is imported." * isinstance(error, ModuleNotFoundError)
        raise RequestError(f"{message}{alone} {EXAMPLE}") from None
    defined = names.get("EFFECTS", names.get("EFFECT"))
    effects = tuple(defined) if isinstance(defined, Iterable) else (defined,)
    if not effects or not all(isinstance(effect, Effect) for effect in effects):
        raise RequestError(f"{file.path} defines no EFFECT that is a dynamics.effect.Effect. {EXAMPLE}")
    return effects
