"""Overrides of a definition's or a recipe's values, and the errors for those that it does not allow."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from types import UnionType
from typing import Any, Literal, TypeVar, Union, get_args, get_origin, get_type_hints

import msgspec

from dynamics.errors import RequestError
from dynamics.spelling import unknown

Definition = TypeVar("Definition", bound=msgspec.Struct)


def overridden(struct: Definition, overrides: Mapping[str, Any]) -> Definition:
    """The struct with some values replaced.

    Raises RequestError for a value that its type does not allow, or that is not finite.
    """
    kind = type(struct)
    undefined = [name for name in overrides if name not in kind.__struct_fields__]
    if undefined:
        raise RequestError(
            f"there is no {undefined[0]} in a {kind.__name__}{unknown(undefined[0], kind.__struct_fields__)}"
        )
    for name, value in overrides.items():
        if isinstance(value, float) and not math.isfinite(value):
            raise RequestError(f"{name} = {value}: required is a finite number.")
    try:
        return msgspec.convert({**msgspec.to_builtins(struct), **overrides}, kind)
    except msgspec.ValidationError as error:
        what, _, where = str(error).partition(" - at `$.")
        name = where.rstrip("`").split("[")[0]
        choices = choices_of(kind, name)
        required = f"required is one of {choices}" if choices else what[:1].lower() + what[1:]
        raise RequestError(f"{name} = {overrides.get(name)}: {required}.") from error


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
