"""Reading, checking and writing vehicle files (TOML), and effects written on a command line."""

from __future__ import annotations

import difflib
import math
import tomllib
import types
import typing
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import msgspec
import tomli_w
import tomlkit

from dynamics.controller_defaults import lookaheads
from dynamics.controller_settings import ControllerSettings
from dynamics.decoding import editable_toml, parse_toml
from dynamics.effect import Effect
from dynamics.effect_file import with_effects_of
from dynamics.effect_source import (
    KEY,
    EffectFile,
    as_carried,
    carried_files,
    entries_of,
    read_effect_file,
    read_effect_file_below,
    tables_toml,
    without_duplicates,
)
from dynamics.effects import CATALOGUE
from dynamics.errors import RequestError
from dynamics.trust import require_approved
from dynamics.vehicle import EffectUse, Vehicle
from dynamics.vehicle_plausibility import require_plausible
from vehicles import FOLDER


def find_vehicle(name: str | Path) -> Path:
    """The path of a vehicle file: the path itself, or that of a bundled file by its name, such as "arpl_250g".

    A file or folder of that name in the working directory comes first.
    """
    bundled = FOLDER / f"{name}.toml"
    is_bundled = Path(name).name == str(name) and bundled.exists() and not Path(name).exists()
    return bundled if is_bundled else Path(name)


def read_vehicle(
    path: str | Path, *, effect_files: Sequence[str | Path] = (), catalogue: Mapping[str, Effect] = CATALOGUE
) -> Vehicle:
    """A vehicle from its file.

    effect_files: with effects of one's own, beside those that the file names.

    Raises RequestError when the file cannot be read, holds a key that does not exist (naming the nearest one that
    does), lacks one, describes a vehicle that cannot exist, or has effects that the user has not approved.
    """
    text = vehicle_text(path, effect_files=effect_files)
    require_approved(effect_files_in(text), carrier=path)
    try:
        return parse_vehicle(text, catalogue=catalogue)
    except RequestError as error:
        raise RequestError(f"{path}: {error}") from error


def vehicle_text(path: str | Path, *, effect_files: Sequence[str | Path] = ()) -> str:
    """The text of a vehicle file that holds the texts of its effect files, so that it can be parsed anywhere.

    effect_files: added to those that the file names. Raises RequestError when the file, or one of them, cannot be read.
    """
    path = Path(path)
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise RequestError(f"cannot read the vehicle file {path}: {error}. Give a TOML file, see vehicles/.") from error
    return with_effect_files(text, path.parent, effect_files)


def with_effect_files(text: str, folder: Path, added: Sequence[str | Path] = ()) -> str:
    """The text of a vehicle file with the texts of its effect files, and of added ones, in place of their names.

    folder: from which its names count, and in which, or below which, these files lie.
    Raises RequestError for a file that lies elsewhere or is no plain Python text. Nothing runs.
    """
    try:
        table = parse_toml(text)
    except tomllib.TOMLDecodeError:
        return text  # `parse_vehicle` says where
    entries = entries_of(table)
    if not (entries or added):
        return text
    named = [read_effect_file_below(folder, entry) for entry in entries if isinstance(entry, str)]
    carried = as_carried(carried_files(entries))
    further = [read_effect_file(path) for path in added]
    of_path = {file.path: file for file in (*carried, *named, *further)}
    return with_texts(text, without_duplicates(of_path.values()))


def with_texts(text: str, files: Sequence[EffectFile]) -> str:
    """The text of a vehicle file with these effect files in place of its own. Raises RequestError for no TOML."""
    try:
        document = editable_toml(text)
    except tomllib.TOMLDecodeError as error:
        raise RequestError(f"not valid TOML: {error}.") from None
    if document.pop(KEY, None) is None and not files:
        return text
    return tomlkit.dumps(document) + tables_toml(files)


def with_added_files(vehicle: Vehicle, paths: Sequence[str | Path]) -> Vehicle:
    """A vehicle with further effect files, checked anew. Raises RequestError as `parse_vehicle`."""
    if not paths:
        return vehicle
    files = without_duplicates([*vehicle.effect_files, *map(read_effect_file, paths)])
    return parse_vehicle(vehicle_toml(msgspec.structs.replace(vehicle, effect_files=tuple(files))))


def effect_files_in(text: str) -> tuple[EffectFile, ...]:
    """The effect files whose texts a vehicle file holds; none are run. Raises RequestError for damaged ones."""
    return tuple(carried_files(effect_entries(text)))


def effect_entries(text: str) -> list[Any]:
    """Entries of a vehicle file under `effect_files`: names, tables with texts; empty for a text that is no TOML."""
    try:
        return entries_of(parse_toml(text))
    except tomllib.TOMLDecodeError:
        return []  # `parse_vehicle` says where


def without_effect_files(text: str) -> tuple[str, tuple[str, ...]]:
    """The text of a vehicle file without its list of Python files, and that list; nothing of these is run.

    Raises RequestError for a text that is no TOML.
    """
    try:
        document = editable_toml(text)
    except tomllib.TOMLDecodeError as error:
        raise RequestError(f"not valid TOML: {error}. Give a vehicle file, see vehicles/.") from error
    named = document.pop("effect_files", [])
    return tomlkit.dumps(document), tuple(map(str, named)) if isinstance(named, list) else ()


def vehicle_name(text: str) -> str:
    """The name in the text of a vehicle file, "unnamed" where there is none; nothing of it is run."""
    try:
        name = parse_toml(text).get("name")
    except tomllib.TOMLDecodeError:
        return "unnamed"
    return name if isinstance(name, str) else "unnamed"


def parse_vehicle(text: str, *, catalogue: Mapping[str, Effect] = CATALOGUE) -> Vehicle:
    """A vehicle from the text of its file, with the texts of its effect files; see `vehicle_text`.

    Raises RequestError as `read_vehicle`.
    """
    try:
        table = parse_toml(text)
    except tomllib.TOMLDecodeError as error:
        raise RequestError(f"not valid TOML: {error}.") from error
    refuse_unknown_keys(table, Vehicle)
    _refuse_non_finite(table)
    _refuse_names(table)
    try:
        vehicle = msgspec.convert(table, Vehicle)
    except msgspec.ValidationError as error:
        if isinstance(error.__cause__, RequestError):
            raise error.__cause__ from None
        raise RequestError(f"{error}.") from error
    if vehicle.effect_files:
        catalogue = {**with_effects_of(vehicle.effect_files, vehicle), **catalogue}
    for use in vehicle.effects:
        check_effect(use, vehicle.rotors.count, catalogue=catalogue)
    _check_controller(vehicle, catalogue)
    require_plausible(vehicle)
    return vehicle


def write_vehicle(vehicle: Vehicle, path: str | Path) -> None:
    """Write a vehicle file. Raises RequestError when there is one already, or none can be written there."""
    write_vehicle_text(vehicle_toml(vehicle), Path(path))


def write_vehicle_text(text: str, path: Path) -> None:
    """Write the text of a vehicle file. Raises RequestError as `write_vehicle`."""
    try:
        file = path.open("x", encoding="utf-8")
    except FileExistsError:
        raise RequestError(f"{path} exists and a vehicle file is never overwritten; give another name.") from None
    except OSError as error:
        raise RequestError(
            f"cannot write the vehicle file {path}: {error}. Give a folder that can be written."
        ) from error
    try:
        with file:
            file.write(text)
    except OSError as error:
        path.unlink(missing_ok=True)
        raise RequestError(f"cannot write the vehicle file {path}: {error}. Nothing was left there.") from error


def vehicle_toml(vehicle: Vehicle) -> str:
    """A vehicle as the text of its file; `parse_vehicle` gives the same vehicle again."""
    table = without_empty(msgspec.to_builtins(msgspec.structs.replace(vehicle, effect_files=())))
    return tomli_w.dumps(table) + tables_toml(vehicle.effect_files)


def parse_effect(text: str, rotor_count: int, *, catalogue: Mapping[str, Effect] = CATALOGUE) -> EffectUse:
    """An effect as written on a command line: `name` or `name:key=value,key=value`, with `rotor=i` where it needs one.

    Raises RequestError for an unknown effect or key, a value that is no number, or one outside its bounds.
    """
    name, _, rest = text.partition(":")
    values: dict[str, float] = {}
    for pair in filter(None, rest.split(",")):
        key, equals, value = pair.partition("=")
        try:
            values[key.strip()] = float(value)
        except ValueError:
            raise RequestError(
                f"effect {text!r}: {pair!r} is not key=number. Write name:key=value,key=value."
            ) from None
        if not equals:
            raise RequestError(f"effect {text!r}: {pair!r} is not key=number. Write name:key=value,key=value.")
    rotor = values.pop("rotor", None)
    if rotor is not None and not rotor.is_integer():
        raise RequestError(f"effect {text!r}: rotor = {rotor} is not a whole number; give 0 to {rotor_count - 1}.")
    use = EffectUse(name.strip(), values, None if rotor is None else int(rotor))
    check_effect(use, rotor_count, catalogue=catalogue)
    return use


def effect_text(use: EffectUse) -> str:
    """An effect as `parse_effect` reads it, its values in the shortest digits that keep them."""
    values = [f"{key}={value!r}" for key, value in use.parameters.items()]
    rotor = [] if use.rotor is None else [f"rotor={use.rotor}"]
    return ":".join(filter(None, (use.name, ",".join([*values, *rotor]))))


def check_effect(use: EffectUse, rotor_count: int, *, catalogue: Mapping[str, Effect] = CATALOGUE) -> None:
    """Refuse an effect that the catalogue does not hold, or values that it cannot have, with a RequestError."""
    if use.name not in catalogue:
        raise RequestError(f"unknown effect {use.name!r}{nearest(use.name, catalogue)}. Known: {', '.join(catalogue)}.")
    effect = catalogue[use.name]
    parameters = {parameter.name: parameter for parameter in effect.parameters}
    for key, value in use.parameters.items():
        if key not in parameters:
            close = nearest(key, parameters)
            raise RequestError(f"effect {use.name}: unknown parameter {key!r}{close}. It has {', '.join(parameters)}.")
        lower, upper, unit = parameters[key].lower, parameters[key].upper, parameters[key].unit
        if not lower <= value <= upper:
            raise RequestError(
                f"effect {use.name}: {key} = {value} {unit} is outside its bounds [{lower}, {upper}] {unit}."
            )
    if effect.per_rotor and (use.rotor is None or not 0 <= use.rotor < rotor_count):
        raise RequestError(
            f"effect {use.name} acts on one rotor: give rotor = 0 to {rotor_count - 1}, not {use.rotor}."
        )
    if not effect.per_rotor and use.rotor is not None:
        raise RequestError(f"effect {use.name} acts on the whole vehicle: leave rotor out.")


def with_settings(
    vehicle: Vehicle, assignments: Sequence[str], *, catalogue: Mapping[str, Effect] = CATALOGUE
) -> Vehicle:
    """The vehicle with settings of its controller replaced, each written as `controller.horizon=0.8`.

    Raises RequestError for a key that does not exist or a value that cannot be flown.
    """
    table: dict[str, Any] = msgspec.to_builtins(vehicle.controller)
    for text in assignments:
        name, equals, value = text.partition("=")
        section, _, key = name.strip().partition(".")
        if not equals or section != "controller":
            raise RequestError(f"setting {text!r}: write controller.KEY=VALUE, as in controller.horizon=0.8.")
        try:
            table[key] = parse_toml(f"value = {value}")["value"]
        except tomllib.TOMLDecodeError:
            raise RequestError(
                f"setting {text!r}: {value!r} is no number, true, false or [x, y, z]; write it as in a vehicle file."
            ) from None
    refuse_unknown_keys({"controller": table}, Vehicle)
    _refuse_non_finite(table, "controller")
    try:
        changed = msgspec.structs.replace(vehicle, controller=msgspec.convert(table, ControllerSettings))
    except msgspec.ValidationError as error:
        if isinstance(error.__cause__, RequestError):
            raise error.__cause__ from None
        raise RequestError(f"controller: {error}.") from error
    _check_controller(changed, catalogue)
    return changed


def _check_controller(vehicle: Vehicle, catalogue: Mapping[str, Effect]) -> None:
    """Raise RequestError for a horizon that is too short for the vehicle; the default one never is."""
    if vehicle.controller != ControllerSettings():
        lookaheads(vehicle, catalogue)


def nearest(word: str, valid: Mapping[str, object] | tuple[str, ...]) -> str:
    """A remark that names the valid word nearest to an unknown one; empty when none is near."""
    close = difflib.get_close_matches(word, list(valid), n=1, cutoff=0.5)
    return f"; did you mean {close[0]!r}?" if close else ""


def refuse_unknown_keys(table: Mapping[str, Any], kind: type[msgspec.Struct], where: str = "") -> None:
    """Raise a RequestError at the first key of a table that its struct does not have, naming the nearest one."""
    hints = typing.get_type_hints(kind)
    for key, value in table.items():
        if key not in hints:
            place = f" in [{where}]" if where else ""
            valid = ", ".join(hints)
            raise RequestError(f"unknown key {key!r}{place}{nearest(key, hints)}. Known there: {valid}.")
        inner = _struct_inside(hints[key])
        if inner is None:
            continue
        for entry in value if isinstance(value, list) else [value]:
            if isinstance(entry, dict):
                refuse_unknown_keys(entry, inner, f"{where}.{key}" if where else key)


def _refuse_non_finite(value: Any, where: str = "") -> None:
    """Raise a RequestError at the first inf or nan, which TOML allows and no comparison catches."""
    if isinstance(value, dict):
        for key, item in value.items():
            _refuse_non_finite(item, f"{where}.{key}" if where else key)
    elif isinstance(value, list):
        for item in value:
            _refuse_non_finite(item, where)
    elif isinstance(value, float) and not math.isfinite(value):
        raise RequestError(f"{where} holds {value}: give finite numbers.")


def _refuse_names(table: Mapping[str, Any]) -> None:
    """Raise a RequestError for effect files by name, where no folder is known from which the names count."""
    if name := next((entry for entry in entries_of(table) if isinstance(entry, str)), None):
        raise RequestError(
            f"{KEY} names {name!r}, and its text is not here: give the file itself with --effects FILE, or the vehicle "
            "file from the folder in which it lies."
        )


def _struct_inside(hint: Any) -> type[msgspec.Struct] | None:
    """The struct that a hint is, or that a tuple or union of it holds."""
    if isinstance(hint, type) and issubclass(hint, msgspec.Struct):
        return hint
    if typing.get_origin(hint) in (tuple, list, typing.Union, types.UnionType):
        structs = (_struct_inside(part) for part in typing.get_args(hint))
        return next((struct for struct in structs if struct is not None), None)
    return None


def without_empty(value: Any) -> Any:
    """Value without entries that are None, empty or unset, which TOML cannot or need not hold."""
    if isinstance(value, dict):
        return {key: without_empty(item) for key, item in value.items() if item not in (None, "", [], (), {})}
    if isinstance(value, list | tuple):
        return [without_empty(item) for item in value]
    return value
