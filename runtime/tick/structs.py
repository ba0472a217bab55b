"""The structs of tick.h as ctypes classes: read from the header, so that there is one definition."""

from __future__ import annotations

import ctypes
import re
from collections.abc import Mapping
from typing import Any

_TYPES: Mapping[str, Any] = {
    "double": ctypes.c_double,
    "int32_t": ctypes.c_int32,
    "uint32_t": ctypes.c_uint32,
    "int64_t": ctypes.c_int64,
    "uint8_t": ctypes.c_uint8,
    "alula_propagate": ctypes.c_void_p,
    "alula_feedback": ctypes.c_void_p,
    "alula_check": ctypes.c_void_p,
}
_STRUCT = re.compile(r"typedef struct \{\n(.*?)\n\} (alula_\w+);", re.DOTALL)
_MEMBER = re.compile(r"^\s*(?:const )?(\w+) (\*?)(\w+)(?:\[(\w+)\])?;")
_NUMBER = re.compile(r"^#define (ALULA_\w+) (\d+)", re.MULTILINE)
_ENUM = re.compile(r"^    (ALULA_\w+)(?: = 0)?,", re.MULTILINE)


def structs_of(*texts: str) -> dict[str, type[ctypes.Structure]]:
    """The structs that C texts define, by name, each after those that it holds."""
    text = "".join(texts)
    numbers = {name: int(value) for name, value in _NUMBER.findall(text)}
    made: dict[str, type[ctypes.Structure]] = {}
    for body, name in _STRUCT.findall(text):
        fields = []
        for line in body.splitlines():
            if (member := _MEMBER.match(line)) is None:
                continue
            kind, pointer, field, length = member.groups()
            base = ctypes.c_void_p if pointer else _TYPES.get(kind) or made[kind]
            fields.append((field, base * (numbers[length] if length in numbers else int(length)) if length else base))
        made[name] = type(name, (ctypes.Structure,), {"_fields_": fields})
    return made


def reasons_of(header: str) -> tuple[str, ...]:
    """The reasons why a tick was left to its caller, in words, by number; the first of one that was not."""
    return tuple(name.removeprefix("ALULA_").lower().replace("_", " ") for name in _ENUM.findall(header))
