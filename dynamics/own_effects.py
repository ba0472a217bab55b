"""Effects of a user's own: read from the Python files that a vehicle names, once for each content."""

from __future__ import annotations

import runpy
import traceback
from collections.abc import Iterable, Mapping
from functools import lru_cache
from pathlib import Path

from dynamics import symbolic
from dynamics.effect import Effect
from dynamics.effects import CATALOGUE
from dynamics.errors import RequestError
from dynamics.vehicle import Vehicle

EXAMPLE = "See examples/my_effects.py."


def read_effects(path: str | Path) -> tuple[Effect, ...]:
    """The effects that a Python file defines.

    Raises RequestError, with the line, when the file cannot be run, defines none, or one that contradicts itself.
    """
    path = Path(path)
    try:
        content = path.read_bytes()
    except OSError:
        raise RequestError(f"{path} is no file. Give a Python file that defines EFFECT. {EXAMPLE}") from None
    return _effects_in(str(path), content)


def catalogue_of(vehicle: Vehicle, catalogue: Mapping[str, Effect] = CATALOGUE) -> Mapping[str, Effect]:
    """A catalogue and the effects of the files that a vehicle names. Raises RequestError for a file without any."""
    if not vehicle.effect_files:
        return catalogue
    own = {effect.name: effect for path in vehicle.effect_files for effect in read_effects(path)}
    return {**own, **catalogue}


def line_of(error: Exception, path: Path) -> int | None:
    """The innermost line of a file in an error's traceback."""
    frames = traceback.extract_tb(error.__traceback__)
    return next((frame.lineno for frame in reversed(frames) if frame.filename == str(path)), None)


@lru_cache(maxsize=64)
def _effects_in(path: str, _: bytes) -> tuple[Effect, ...]:
    """The effects of a file with some content, the same objects each time."""
    try:
        with symbolic.importable():
            names = runpy.run_path(path)
    except Exception as error:  # a user's file may raise anything
        where = f"line {line_of(error, Path(path)) or '?'}"
        raise RequestError(f"{path}, {where}: {type(error).__name__}: {str(error).rstrip('.')}. {EXAMPLE}") from None
    defined = names.get("EFFECTS", names.get("EFFECT"))
    effects = tuple(defined) if isinstance(defined, Iterable) else (defined,)
    if not effects or not all(isinstance(effect, Effect) for effect in effects):
        raise RequestError(f"{path} defines no EFFECT that is a dynamics.effect.Effect. {EXAMPLE}")
    return effects
