"""JSON Schema (draft 7) of the vehicle file, made of the definitions that read it: for editors, and for other programs.

TOML editors complete keys and underline wrong ones by it. What needs more than one key at a time (an impossible
inertia, a layout that cannot yaw) stays with `dynamics.vehicle_file`.
"""

from __future__ import annotations

import inspect
import re
from collections.abc import Mapping
from typing import Any

import msgspec

from dynamics.controller_settings import BOUNDS, ControllerSettings
from dynamics.effect import Effect
from dynamics.effects import CATALOGUE
from dynamics.vehicle import EffectUse, Vehicle

DRAFT = "http://json-schema.org/draft-07/schema#"
PYTHON_FILE = {"type": "string", "pattern": r"\.py$", "description": "A Python file beside this one or below it."}
Schema = dict[str, Any]


def vehicle_schema(catalogue: Mapping[str, Effect] = CATALOGUE) -> Schema:
    """The schema of a vehicle file. catalogue: effects whose parameters, units and bounds it knows."""
    _, definitions = msgspec.json.schema_components((Vehicle,), ref_template="#/definitions/{name}")
    kinds = {kind.__name__: kind for kind in _structs(Vehicle)}
    parts = {name: _with_texts(_for_toml(part), kinds[name]) for name, part in definitions.items()}
    for key, (low, high, unit) in BOUNDS.items():
        _limit(parts[ControllerSettings.__name__]["properties"][key], low, high, unit)
    parts[EffectUse.__name__] |= {"anyOf": [*map(_effect, catalogue.values()), _own_effect(catalogue)]}
    vehicle = parts.pop(Vehicle.__name__)
    files = vehicle["properties"]["effect_files"]
    files["items"] = {"anyOf": [PYTHON_FILE, files["items"]]}
    of_catalogue = {"properties": {"effects": {"items": {"properties": {"name": {"enum": list(catalogue)}}}}}}
    return {
        "$schema": DRAFT,
        **vehicle,
        "title": "Alula vehicle file",
        "if": {"not": {"required": ["effect_files"]}},
        "then": of_catalogue,  # an effect that is none of the catalogue's needs a file that defines it
        "definitions": parts,
    }


def _structs(kind: type[msgspec.Struct]) -> set[type[msgspec.Struct]]:
    """A struct and all that it holds."""
    structs: set[type[msgspec.Struct]] = set()
    waiting: list[Any] = [msgspec.inspect.type_info(kind)]
    while waiting:
        info = waiting.pop()
        if isinstance(info, msgspec.inspect.StructType):
            if info.cls in structs:
                continue
            structs.add(info.cls)
            waiting += [field.type for field in info.fields]
        for name in ("types", "item_types"):
            waiting += getattr(info, name, ())
        waiting += [part for name in ("item_type", "value_type") if (part := getattr(info, name, None)) is not None]
    return structs


def _for_toml(schema: Any) -> Any:
    """A schema without null, which TOML does not have, and with lists as draft 7 describes them."""
    if isinstance(schema, list):
        return [_for_toml(part) for part in schema]
    if not isinstance(schema, dict):
        return schema
    if "anyOf" in schema:
        options = [_for_toml(option) for option in schema["anyOf"] if option != {"type": "null"}]
        rest = {key: value for key, value in schema.items() if key != "anyOf"}
        schema = {**rest, **options[0]} if len(options) == 1 else {**rest, "anyOf": options}
    idle = "$ref" in schema or schema.get("default", ...) is None  # a default that nobody reads, or that is null
    changed = {key: _for_toml(value) for key, value in schema.items() if key != "default" or not idle}
    if "prefixItems" in changed:
        entries = changed.pop("prefixItems")
        same = all(entry == entries[0] for entry in entries)
        changed |= {"items": entries[0]} if same else {"items": entries, "additionalItems": False}
    return changed


def _with_texts(schema: Schema, kind: type[msgspec.Struct]) -> Schema:
    """The schema of a struct with what its docstring says of each field, unit included."""
    heading, _, rest = inspect.cleandoc(kind.__doc__ or "").partition("\n\n")
    schema["description"] = heading
    for names, text in re.findall(r"^([a-z_]+(?:, [a-z_]+)*): (.+(?:\n {4}.+)*)", rest, re.MULTILINE):
        for name in names.split(", "):
            if name in schema.get("properties", {}):
                _describe(schema["properties"][name], " ".join(text.split()))
    return schema


def _describe(schema: Schema, text: str) -> None:
    """Write a description; beside a reference, where draft 7 reads nothing, the reference moves below it."""
    if "$ref" in schema:
        schema["allOf"] = [{"$ref": schema.pop("$ref")}]
    schema["description"] = text


def _limit(schema: Schema, low: float, high: float, unit: str) -> None:
    """Write the bounds of a number, or of each in a list."""
    number = schema["items"] if schema.get("type") == "array" else schema
    schema["description"] = f"{schema.get('description', '').rstrip('.')}. {low:g} to {high:g} ({unit}).".lstrip(". ")
    number |= {"minimum": low, "maximum": high}


def _effect(effect: Effect) -> Schema:
    """An effect of the catalogue as a vehicle file uses it."""
    parameters = {
        parameter.name: {
            "type": "number",
            "minimum": parameter.lower,
            "maximum": parameter.upper,
            "description": f"{parameter.meaning}, {parameter.unit}; {parameter.lower:g} to {parameter.upper:g}.",
        }
        for parameter in effect.parameters
    }
    schema: Schema = {
        "title": effect.name,
        "description": effect.summary,
        "properties": {
            "name": {"const": effect.name},
            "parameters": {"type": "object", "properties": parameters, "additionalProperties": False},
        },
    }
    if effect.per_rotor:
        schema["properties"]["rotor"] = {"type": "integer", "minimum": 0, "description": "Number of the rotor, from 0."}
        return schema | {"required": ["name", "rotor"]}
    schema["properties"]["rotor"] = False
    return schema | {"required": ["name"]}


def _own_effect(catalogue: Mapping[str, Effect]) -> Schema:
    return {
        "title": "an effect of your own",
        "description": "Of a Python file in effect_files.",
        "properties": {"name": {"not": {"enum": list(catalogue)}}},
        "required": ["name"],
    }
