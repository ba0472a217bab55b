"""Editing a vehicle file in place: what did not change stays as it was written, comments and layout included."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path, PurePosixPath
from typing import Any

import msgspec
import tomlkit
from tomlkit.items import AoT, Array, InlineTable

from dynamics.decoding import editable_toml
from dynamics.effect import Effect
from dynamics.effect_source import KEY, EffectFile, entries_of, read_effect_file_below
from dynamics.effects import CATALOGUE
from dynamics.errors import RequestError
from dynamics.vehicle import Vehicle
from dynamics.vehicle_file import parse_vehicle, vehicle_toml, with_effect_files, without_empty

SIGNIFICANT_DIGITS = 4  # of a value that was fitted; its interval is never as narrow
WIDTH = 110  # of a list in one line, characters


def edited_toml(
    text: str, vehicle: Vehicle, *, folder: Path | None = None, catalogue: Mapping[str, Effect] = CATALOGUE
) -> str:
    """The text of a vehicle file with the values that differ in `vehicle` changed, to four significant digits.

    text: of the file that the vehicle was read from. What is new goes behind its like, what is gone is left out. A
    file whose layout cannot hold the change, as one with effects in one line, is written anew.
    folder: of the file, from which its effect files count; by default the working directory.
    Raises RequestError where the text is no vehicle file.
    """
    folder = (folder or Path()).resolve()
    old = parse_vehicle(with_effect_files(text, folder), catalogue=catalogue)
    vehicle = _in_order_of(old, vehicle)
    document = editable_toml(text)
    _change(document, _table(old), _table(vehicle))
    _set_effect_files(document, vehicle, folder)
    edited = tomlkit.dumps(document)
    try:
        read = parse_vehicle(with_effect_files(edited, folder), catalogue=catalogue)
    except RequestError:
        return vehicle_toml(vehicle)
    alike = _rounded_table(read) == _rounded_table(vehicle) and _contents(read) == _contents(vehicle)
    return edited if alike else vehicle_toml(vehicle)


def _set_effect_files(document: Any, vehicle: Vehicle, folder: Path) -> None:
    """Name the vehicle's effect files as they lie in the file's folder; the text of one that does not stands there."""
    entries = [_entry(file, folder) for file in vehicle.effect_files]
    before = entries_of(document.unwrap())
    if [_comparable(entry) for entry in entries] == [_comparable(entry) for entry in before]:
        return
    document.pop(KEY, None)
    if entries and all(isinstance(entry, dict) for entry in entries):
        document[KEY] = _item(entries, None)
    elif entries:
        array: Array = tomlkit.array()
        for entry in entries:
            array.append(_inline(entry) if isinstance(entry, dict) else entry)
        document[KEY] = array.multiline(len(array.as_string()) > WIDTH)


def _entry(file: EffectFile, folder: Path) -> str | dict[str, str]:
    """An effect file as a vehicle file in a folder names it, or with its text where it lies elsewhere."""
    if not file.is_carried and Path(file.path).is_relative_to(folder):
        name = Path(file.path).relative_to(folder).as_posix()
        try:
            if read_effect_file_below(folder, name).sha256 == file.sha256:
                return name
        except RequestError:  # it has gone meanwhile
            pass
    return {"path": file.name, "sha256": file.sha256, "text": file.text}


def _contents(vehicle: Vehicle) -> list[str]:
    return [file.sha256 for file in vehicle.effect_files]


def _comparable(entry: Any) -> object:
    return str(PurePosixPath(entry)) if isinstance(entry, str) else entry["sha256"]


def _inline(table: dict[str, str]) -> InlineTable:
    inline = tomlkit.inline_table()
    inline.update(table)
    return inline


def rounded_changes(before: Vehicle, after: Vehicle) -> Vehicle:
    """`after` as the file of `before` will hold it: what differs rounded, new effects behind the file's own."""
    after = _in_order_of(before, after)
    changed = msgspec.convert(_only_changes_rounded(_table(before), _table(after)), Vehicle)
    return msgspec.structs.replace(changed, effect_files=after.effect_files)


def _in_order_of(before: Vehicle, after: Vehicle) -> Vehicle:
    """`after` with the effects that `before` has first, in its order."""
    places = {(use.name, use.rotor): place for place, use in enumerate(before.effects)}
    effects = sorted(after.effects, key=lambda use: places.get((use.name, use.rotor), len(places)))
    return msgspec.structs.replace(after, effects=tuple(effects))


def _only_changes_rounded(before: Any, after: Any) -> Any:
    if before == after:
        return after
    if isinstance(after, dict):
        past = before if isinstance(before, dict) else {}
        return {key: _only_changes_rounded(past.get(key), value) for key, value in after.items()}
    if isinstance(after, list):
        entries = [*before, *[None] * len(after)] if isinstance(before, list) else [None] * len(after)
        return [_only_changes_rounded(old, value) for old, value in zip(entries, after, strict=False)]
    return rounded(after) if isinstance(after, float) else after


def _rounded_table(vehicle: Vehicle) -> Any:
    """All numbers rounded: two vehicles that a file holds alike have it in common."""
    return _only_changes_rounded(None, _table(vehicle))


def _table(vehicle: Vehicle) -> dict[str, Any]:
    """All but its effect files, which `_set_effect_files` writes."""
    table = without_empty(msgspec.to_builtins(msgspec.structs.replace(vehicle, effect_files=())))
    assert isinstance(table, dict)
    return table


def _change(document: Any, before: dict[str, Any], after: dict[str, Any]) -> None:
    """Make a table of the document what `after` has, touching what differs from `before` alone."""
    for key in before.keys() - after.keys():
        if key in document:
            del document[key]
    for key, value in after.items():
        old = before.get(key)
        if value == old:
            continue
        if isinstance(value, dict) and isinstance(old, dict) and key in document:
            _change(document[key], old, value)
        elif isinstance(old, list) and isinstance(document.get(key), AoT):
            _change_list(document[key], old, value)
        else:
            document[key] = _item(value, old)


def _change_list(tables: AoT, before: list[dict[str, Any]], after: list[dict[str, Any]]) -> None:
    """Change a list of tables: [[effects]], [[history]]."""
    for place in reversed(range(len(after), len(before))):
        del tables[place]
    for place, value in enumerate(after):
        if place >= len(before):
            tables.append(_item(value, None))
        elif before[place].get("name") == value.get("name"):
            _change(tables[place], before[place], value)
        else:
            tables[place] = _item(value, None)


def _item(value: Any, old: Any) -> Any:
    """A value as an item of a document. old: what stands there, of which unchanged parts keep all their digits."""
    if isinstance(value, float):
        return value if value == old else rounded(value)
    if isinstance(value, dict):
        table = tomlkit.table()
        for key, entry in value.items():
            table[key] = _item(entry, None)
        return table
    if not isinstance(value, list):
        return value
    if value and all(isinstance(entry, dict) for entry in value):
        tables = tomlkit.aot()
        for entry in value:
            tables.append(_item(entry, None))
        return tables
    past_entries = old if isinstance(old, list) and len(old) == len(value) else [None] * len(value)
    array: Array = tomlkit.array()
    array.extend(_item(entry, past) for entry, past in zip(value, past_entries, strict=True))
    return array.multiline(len(array.as_string()) > WIDTH)


def rounded(value: float) -> float:
    """To four significant digits."""
    if value == 0.0 or not math.isfinite(value):
        return value
    return float(f"{value:.{SIGNIFICANT_DIGITS}g}")
