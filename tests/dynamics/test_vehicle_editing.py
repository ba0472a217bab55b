"""Vehicle files edited in place: a change is the only difference, comments and layout stay."""

import difflib
import tomllib

import msgspec
import pytest

from dynamics.vehicle import EffectUse, HistoryEntry
from dynamics.vehicle_editing import edited_toml, rounded
from dynamics.vehicle_file import parse_vehicle
from vehicles import FOLDER

TEXTS = {path.stem: path.read_text() for path in sorted(FOLDER.glob("*.toml"))}
ENTRY = HistoryEntry("2026-11-22", "added wind", ("a.csv 1234",), {"imu": 0.5}, {"imu": 0.25}, "alula add wind a.csv")


def changed_lines(before: str, after: str) -> list[str]:
    """The lines that differ, with + and -, without empty ones."""
    lines = difflib.unified_diff(before.splitlines(), after.splitlines(), lineterm="", n=0)
    return [line for line in lines if line[0] in "+-" and line[:3] not in ("+++", "---") and line[1:].strip()]


@pytest.mark.parametrize("name", TEXTS)
def test_nothing_changed_leaves_every_character(name: str) -> None:
    assert edited_toml(TEXTS[name], parse_vehicle(TEXTS[name])) == TEXTS[name]


@pytest.mark.parametrize("name", TEXTS)
def test_effects_and_history_are_appended_and_nothing_else_changes(name: str) -> None:
    vehicle = parse_vehicle(TEXTS[name])
    use = EffectUse("parasitic_drag", {"coefficient": 0.0123456789})
    weak = EffectUse("weak_rotor", {"loss": 0.1}, rotor=1)
    after = msgspec.structs.replace(vehicle, effects=(*vehicle.effects, use, weak), history=(*vehicle.history, ENTRY))
    text = edited_toml(TEXTS[name], after)
    lines = changed_lines(TEXTS[name], text)
    assert all(line.startswith("+") for line in lines)
    assert "+coefficient = 0.01235" in lines
    read = parse_vehicle(text)
    assert read.effects[-1] == weak
    assert read.history[-1] == ENTRY
    assert read.effects[: len(vehicle.effects)] == vehicle.effects


def test_a_changed_value_keeps_its_comment_and_the_others_their_digits() -> None:
    text = TEXTS["px4_sih"]
    vehicle = parse_vehicle(text)
    body = msgspec.structs.replace(vehicle.body, mass=1.2512345, inertia=(0.025, 0.025, 0.0312345))
    effects = (*vehicle.effects[:1], EffectUse("linear_drag", {"coefficient": 1.98765}), *vehicle.effects[2:])
    after = edited_toml(text, msgspec.structs.replace(vehicle, body=body, effects=effects))
    assert changed_lines(text, after) == [
        "-mass = 1.0                                # kg",
        "-inertia = [0.025, 0.025, 0.030]           # kg m^2",
        "+mass = 1.251                                # kg",
        "+inertia = [0.025, 0.025, 0.03123]           # kg m^2",
        "-coefficient = 1.0                         # N s/m",
        "+coefficient = 1.988                         # N s/m",
    ]


def test_effects_that_are_gone_are_left_out() -> None:
    text = TEXTS["px4_sih"]
    vehicle = parse_vehicle(text)
    without = msgspec.structs.replace(vehicle, effects=())
    assert parse_vehicle(edited_toml(text, without)).effects == ()
    last = msgspec.structs.replace(vehicle, effects=vehicle.effects[1:])
    assert parse_vehicle(edited_toml(text, last)).effects == vehicle.effects[1:]


def test_an_edited_file_can_be_edited_again() -> None:
    text = TEXTS["arpl_250g"]
    for number in range(3):
        vehicle = parse_vehicle(text)
        use = EffectUse("weak_rotor", {"loss": 0.1 + 0.01 * number}, rotor=number)
        text = edited_toml(
            text,
            msgspec.structs.replace(vehicle, effects=(*vehicle.effects, use), history=(*vehicle.history, ENTRY)),
        )
    vehicle = parse_vehicle(text)
    assert [use.rotor for use in vehicle.effects][-3:] == [0, 1, 2]
    assert len(vehicle.history) == 3
    tomllib.loads(text)


def test_a_layout_that_cannot_hold_the_change_is_written_anew() -> None:
    text = TEXTS["arpl_250g"].split("[[effects]]")[0]
    head, rest = text.split("[body]", 1)
    text = f'{head}effects = [{{name = "rotor_drag", parameters = {{coefficient = 1e-5}}}}]\n\n[body]{rest}'
    vehicle = parse_vehicle(text)
    use = EffectUse("weak_rotor", {"loss": 0.1}, rotor=2)
    after = msgspec.structs.replace(vehicle, effects=(*vehicle.effects, use))
    assert parse_vehicle(edited_toml(text, after)) == after


def test_values_have_four_significant_digits() -> None:
    assert [rounded(v) for v in (0.0, 1.23456e-7, -98765.4)] == [0.0, 1.235e-7, -98770.0]
