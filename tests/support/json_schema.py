"""JSON Schema, draft 7, as far as ours uses it; a keyword that it does not know is an error, never passed over."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from typing import Any

TYPES: dict[str, Callable[[Any], bool]] = {
    "object": lambda v: isinstance(v, dict),
    "array": lambda v: isinstance(v, list),
    "string": lambda v: isinstance(v, str),
    "boolean": lambda v: isinstance(v, bool),
    "integer": lambda v: isinstance(v, int) and not isinstance(v, bool),
    "number": lambda v: isinstance(v, (int, float)) and not isinstance(v, bool),
}
WORDS = ("title", "description", "default", "$schema", "definitions", "then")  # `then` goes with `if`


def faults(value: Any, schema: Any, root: Any, place: str = "$") -> Iterator[str]:
    """Where a value is not as a schema wants it."""
    if isinstance(schema, bool):
        if not schema:
            yield f"{place}: not allowed"
        return
    for keyword, required in schema.items():
        if keyword not in WORDS:
            yield from RULES[keyword](value, required, schema, root, place)


def holds(value: Any, schema: Any, root: Any) -> bool:
    """Whether a value is as a schema wants it."""
    return next(faults(value, schema, root), None) is None


def _reference(value: Any, required: str, schema: Any, root: Any, place: str) -> Iterator[str]:
    assert set(schema) == {"$ref"}, "draft 7 reads nothing beside $ref"
    target = root
    for name in required.removeprefix("#/").split("/"):
        target = target[name]
    yield from faults(value, target, root, place)


def _properties(value: Any, required: Any, _schema: Any, root: Any, place: str) -> Iterator[str]:
    if isinstance(value, dict):
        for name in value.keys() & required.keys():
            yield from faults(value[name], required[name], root, f"{place}.{name}")


def _additional(value: Any, required: Any, schema: Any, root: Any, place: str) -> Iterator[str]:
    if isinstance(value, dict):
        for name in value.keys() - schema.get("properties", {}).keys():
            yield from faults(value[name], required, root, f"{place}.{name}")


def _items(value: Any, required: Any, schema: Any, root: Any, place: str) -> Iterator[str]:
    if not isinstance(value, list):
        return
    for number, entry in enumerate(value):
        one = required
        if isinstance(required, list):
            one = required[number] if number < len(required) else schema.get("additionalItems", True)
        yield from faults(entry, one, root, f"{place}[{number}]")


def _condition(value: Any, required: Any, schema: Any, root: Any, place: str) -> Iterator[str]:
    if holds(value, required, root):
        yield from faults(value, schema["then"], root, place)


def _when(kind: str, test: Callable[[Any, Any], bool], words: str) -> Callable[..., Iterator[str]]:
    """A rule for values of one type."""

    def rule(value: Any, required: Any, _schema: Any, _root: Any, place: str) -> Iterator[str]:
        if (not kind or TYPES[kind](value)) and not test(value, required):
            yield f"{place}: {value!r} is not {words} {required!r}"

    return rule


def _any_of(value: Any, required: Any, _schema: Any, root: Any, place: str) -> Iterator[str]:
    if not any(holds(value, option, root) for option in required):
        yield f"{place}: none of the {len(required)} forms"


def _all_of(value: Any, required: Any, _schema: Any, root: Any, place: str) -> Iterator[str]:
    for part in required:
        yield from faults(value, part, root, place)


def _not(value: Any, required: Any, _schema: Any, root: Any, place: str) -> Iterator[str]:
    if holds(value, required, root):
        yield f"{place}: what must not be"


RULES: dict[str, Callable[..., Iterator[str]]] = {
    "$ref": _reference,
    "type": _when("", lambda v, w: TYPES[w](v), "of type"),
    "properties": _properties,
    "additionalProperties": _additional,
    "items": _items,
    "additionalItems": lambda *_: iter(()),  # read beside items
    "if": _condition,
    "anyOf": _any_of,
    "allOf": _all_of,
    "not": _not,
    "required": _when("object", lambda v, w: set(w) <= v.keys(), "an object with"),
    "const": _when("", lambda v, w: v == w, "equal to"),
    "enum": _when("", lambda v, w: v in w, "one of"),
    "minimum": _when("number", lambda v, w: v >= w, "at least"),
    "maximum": _when("number", lambda v, w: v <= w, "at most"),
    "exclusiveMinimum": _when("number", lambda v, w: v > w, "above"),
    "minItems": _when("array", lambda v, w: len(v) >= w, "as long as"),
    "maxItems": _when("array", lambda v, w: len(v) <= w, "as short as"),
    "pattern": _when("string", lambda v, w: re.search(w, v) is not None, "like"),
}
