"""Validation errors in the words of the file's author: the field by its name, what it holds, what belongs there.

msgspec writes types of Python and JSON paths ("Object missing required field `mass` - at `$.body`").
"""

from __future__ import annotations

import re

_PLACE = re.compile(r"^(?P<what>.*?)(?: - at `(?:key(?P<key>(?:\[\.\.\.\])?)` in `)?\$(?P<path>[^`]*)`)?$", re.DOTALL)
_MISSING = re.compile(r"Object missing required field `(.+)`")
_UNKNOWN = re.compile(r"Object contains unknown field `(.+)`")
_TYPE = re.compile(r"Expected `([^`]+)`(.*)", re.DOTALL)
_GOT = re.compile(r"^(?P<limit>.*?)(?:, got `?(?P<given>[^`]*)`?)?$", re.DOTALL)
_ENUM = re.compile(r"Invalid enum value (.+)", re.DOTALL)
_WORDS = {
    "int": "a whole number", "float": "a number", "str": "a text", "bool": "true or false", "null": "nothing",
    "array": "a list", "object": "a table", "bytes": "base64 text",
}  # fmt: skip


def described(error: Exception) -> str:
    """The text of a validation error without its full stop; of any other error its own text."""
    text = str(error).rstrip(".")
    parts = _PLACE.match(text)
    if parts is None:
        return text
    what, place = parts["what"], _field(parts["path"] or "")
    if parts["key"] is not None:
        place = f"a key of {place or 'the table'}"
    if missing := _MISSING.fullmatch(what):
        return f"{missing[1]!r} is missing{f' in [{place}]' if place else ''}"
    if unknown := _UNKNOWN.fullmatch(what):
        return f"unknown key {unknown[1]!r}{f' in [{place}]' if place else ''}"
    if choice := _ENUM.fullmatch(what):
        return f"{place or 'the value'} is {choice[1]}, which is none of its choices"
    if type_error := _TYPE.fullmatch(what):
        return _wrong_type(place or "the whole", type_error[1], type_error[2])
    return f"{place}: {what}" if place else what


def _field(path: str) -> str:
    """A JSON path as the name of a field; an element of a list is one "entry of" it, its number is not known."""
    names = path.removeprefix(".")
    entry = names.endswith("[...]")
    name = re.sub(r"\[(\d+)\]", r"[\1]", names.replace("[...]", ""))
    return f"an entry of {name}" if entry and name else ("an entry" if entry else name)


def _wrong_type(place: str, kinds: str, rest: str) -> str:
    """The message for a value of a wrong type, length or size. rest: such as ", got `str`" or " >= 0"."""
    parsed = _GOT.match(rest)
    limit, value_kind = (parsed["limit"], parsed["given"]) if parsed else (rest, None)
    required = " or ".join(_WORDS.get(kind.strip(), kind.strip()) for kind in kinds.split("|"))
    length = re.fullmatch(r"\s*of length (.+)", limit, re.DOTALL)
    if length and kinds == "array":
        required = f"a list of {_bound(length[1])} entries"
    elif limit.strip():
        required += f" {_bound(limit.removeprefix(' of ').strip())}"
    if value_kind is None:
        return f"{place} must be {required}"
    shown = _WORDS.get(value_kind, value_kind)
    return f"{place} holds {shown}; wanted is {required}"


def _bound(text: str) -> str:
    """A bound such as ">= 0" in words."""
    for sign, words in ((">=", "at least"), ("<=", "at most"), (">", "above"), ("<", "below")):
        text = re.sub(rf"{sign}\s*", f"{words} ", text)
    return text
