"""Effects of a user's own in tests: read and approved by being given, as `--effects FILE` does it."""

from collections.abc import Mapping, Sequence
from pathlib import Path

from dynamics.effect import Effect
from dynamics.effect_file import with_effects_of
from dynamics.effect_source import read_effect_file
from dynamics.own_effects import effects_of
from dynamics.trust import approve_given
from dynamics.vehicle import Vehicle


def given_effects(path: Path) -> tuple[Effect, ...]:
    """The effects of a file."""
    approve_given([path])
    return effects_of(read_effect_file(path))


def given_catalogue(paths: Sequence[Path], vehicle: Vehicle) -> Mapping[str, Effect]:
    """The catalogue and the effects of files, tried on a vehicle."""
    approve_given(paths)
    return with_effects_of(map(read_effect_file, paths), vehicle)
