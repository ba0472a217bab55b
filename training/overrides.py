"""A definition or a recipe with other values, and what is wrong with those that it does not allow."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from types import UnionType
from typing import Any, Literal, TypeVar, Union, get_args, get_origin, get_type_hints

import msgspec

from dynamics.errors import RequestError

Definition = TypeVar("Definition", bound=msgspec.Struct)


def changed(struct: Definition, changes: Mapping[str, Any]) -> Definition:
    """The struct with other values. Raises RequestError for one that its type does not allow, or that is not finite."""
    kind = type(struct)
    unknown = [name for name in changes if name not in kind.__struct_fields__]
    if unknown:
        raise RequestError(
            f"there is no {unknown[0]} in a {kind.__name__}. Known: {', '.join(kind.__struct_fields__)}."
        )
    for name, value in changes.items():
        if isinstance(value, float) and not math.isfinite(value):
            raise RequestError(f"{name} = {value}: wanted a finite number.")
    try:
        return msgspec.convert({**msgspec.to_builtins(struct), **changes}, kind)
    except msgspec.ValidationError as error:
        what, _, where = str(error).partition(" - at `$.")
        name = where.rstrip("`").split("[")[0]
        choices = choices_of(kind, name)
        wanted = f"wanted one of {choices}" if choices else what[:1].lower() + what[1:]
        raise RequestError(f"{name} = {changes.get(name)}: {wanted}.") from error


def choices_of(kind: type[msgspec.Struct], name: str) -> str:
    """The words that a field of a struct allows, with commas between them; empty where it takes other values."""
    return ", ".join(_choices(get_type_hints(kind).get(name)))


def _choices(annotation: Any) -> Iterator[str]:
    """The words that a type allows, none for any other type."""
    if get_origin(annotation) is Literal:
        yield from map(str, get_args(annotation))
    elif get_origin(annotation) in (Union, UnionType):
        for option in get_args(annotation):
            yield from _choices(option)
