"""The schema of the vehicle file accepts what the reader accepts, and refuses what can be seen in one key."""

from __future__ import annotations

import copy
import json
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from dynamics.effects import CATALOGUE
from dynamics.errors import RequestError
from dynamics.vehicle_file import parse_vehicle, vehicle_toml
from dynamics.vehicle_schema import vehicle_schema
from tests.support.command_line import Run, command_line
from tests.support.json_schema import faults
from vehicles import FOLDER

VEHICLES = sorted(FOLDER.glob("*.toml"))
SCHEMA = vehicle_schema()


def wrong(table: dict[str, Any]) -> list[str]:
    return list(faults(table, SCHEMA, SCHEMA))


@pytest.fixture
def table() -> dict[str, Any]:
    return tomllib.loads((FOLDER / "arpl_250g.toml").read_text())


@pytest.mark.parametrize("path", VEHICLES, ids=lambda path: path.stem)
def test_every_bundled_vehicle_is_valid(path: Path) -> None:
    text = path.read_text()
    assert not wrong(tomllib.loads(text))
    assert not wrong(tomllib.loads(vehicle_toml(parse_vehicle(text))))


@pytest.mark.parametrize("name", CATALOGUE)
def test_every_effect_is_valid_at_its_bounds_and_not_beyond(name: str, table: dict[str, Any]) -> None:
    effect = CATALOGUE[name]
    rotor = {"rotor": 0} if effect.per_rotor else {}
    for parameter in effect.parameters:
        for value, fits in ((parameter.lower, True), (parameter.upper, True), (parameter.upper * 2 + 1.0, False)):
            table["effects"] = [{"name": name, "parameters": {parameter.name: value}, **rotor}]
            assert (not wrong(table)) == fits, (parameter.name, value)
    table["effects"] = [{"name": name, "parameters": {"coeficient": 1.0}, **rotor}]
    assert wrong(table)
    table["effects"] = [{"name": name, **({} if rotor else {"rotor": 0})}]
    assert wrong(table)


def _change(path: str, value: Any) -> Callable[[dict[str, Any]], None]:
    def change(table: dict[str, Any]) -> None:
        *places, key = path.split(".")
        for place in places:
            table = table.setdefault(place, {})
        if value is None:
            del table[key]
        else:
            table[key] = value

    return change


@pytest.mark.parametrize(
    ("path", "value"),
    [
        ("nmae", "x"), ("body.mas", 0.3), ("rotors.thrust_const", 1e-7), ("limits.sped", 3.0), ("controller.node", 20),
        ("body.mass", "0.25"), ("body.mass", -1.0), ("body.mass", True), ("body.inertia", [1e-3, 1e-3]),
        ("rotors.spin", [1.5, -1, 1, -1]), ("rotors.thrust_curve", 1.5), ("limits.thrust", [1.0]),
        ("limits.thrust", [-1.0, 2.0]), ("controller.nodes", 20.5), ("controller.nodes", 1000),
        ("controller.position_weight", [1.0, 1.0, -1.0]), ("controller.keep_in_box", 1), ("body", None),
        ("rotors.speed_max", None), ("autopilot.rate_gain", [1.0, 1.0]), ("effects", [{"name": "rotor_darg"}]),
        ("effects", [{"parameters": {}}]), ("effects", [{"name": "mass", "parametres": {}}]),
        ("effect_files", ["effects.txt"]), ("history", [{"date": "2026-01-01"}]),
    ],
)  # fmt: skip
def test_misspelled_keys_and_wrong_types_are_refused_by_both(path: str, value: Any, table: dict[str, Any]) -> None:
    changed = copy.deepcopy(table)
    _change(path, value)(changed)
    assert wrong(changed), path
    import tomli_w

    with pytest.raises(RequestError):
        parse_vehicle(tomli_w.dumps(changed))


def test_effects_of_ones_own_are_allowed_beside_a_file_that_defines_them(table: dict[str, Any]) -> None:
    table["effects"] = [{"name": "my_sail", "parameters": {"area": 0.1}}]
    assert wrong(table)
    table["effect_files"] = ["my_effects.py"]
    assert not wrong(table)


def test_every_number_of_an_effect_has_its_unit_and_bounds() -> None:
    forms = {form["title"]: form for form in SCHEMA["definitions"]["EffectUse"]["anyOf"]}
    for effect in CATALOGUE.values():
        properties = forms[effect.name]["properties"]["parameters"]["properties"]
        assert list(properties) == [parameter.name for parameter in effect.parameters]
        for parameter in effect.parameters:
            assert parameter.unit in properties[parameter.name]["description"]
    assert "N s^2/rad^2" in SCHEMA["definitions"]["Rotors"]["properties"]["thrust_constant"]["description"]
    assert "Hz" in SCHEMA["definitions"]["ControllerSettings"]["properties"]["rate"]["description"]


def test_the_command_prints_it(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    run: Run = command_line(monkeypatch, capsys)
    code, out, _ = run("vehicle", "schema")
    assert code == 0
    assert json.loads(out) == json.loads(json.dumps(SCHEMA))
