"""Texts that people write: vehicle files, thresholds, mappings, scenarios, references, options of a command line."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import msgspec
import tomli_w

from diagnosis.thresholds import Thresholds
from diagnosis.thresholds_file import read_thresholds
from dynamics.effect_source import effect_file, read_effect_file
from dynamics.references.table import read_table
from dynamics.vehicle import Vehicle
from dynamics.vehicle_editing import edited_toml
from dynamics.vehicle_file import parse_effect, read_vehicle, vehicle_name, vehicle_toml, with_settings
from dynamics.vehicle_folder import vehicle_files_in
from flights import mapping as mappings
from flights.mapping import read_mapping
from sitl_mock.scenario import read_scenario
from tests.fuzz.mutation import Parts
from tests.fuzz.target import Target
from vehicles import FOLDER

VEHICLE = read_vehicle(FOLDER / "arpl_250g.toml")
SCENARIO = b"""\
wind = { x = 1.0, y = 0.0 }
estimator = "mocap"
start_height_error = 0.1
yaw = 0.5
[clock]
drift = 1e-5
[sensors]
delay = 0.01
[parameters]
MPC_THR_HOVER = 0.5
[[effects]]
name = "rotor_drag"
parameters = { coefficient = 2.2e-5 }
[[faults]]
kind = "estimator_reset"
at = 60.0
"""


def _vehicle(path: Path) -> None:
    """As it is read, edited and written; a vehicle that was read is the same when it is read again."""
    vehicle_name(path.read_bytes().decode(errors="replace"))
    vehicle = read_vehicle(path)
    edited_toml(path.read_text(encoding="utf-8"), _heavier(vehicle), folder=path.parent)
    path.with_name("again.toml").write_text(vehicle_toml(vehicle), encoding="utf-8")
    again = read_vehicle(path.with_name("again.toml"))
    assert vehicle_toml(again) == vehicle_toml(vehicle)


def _heavier(vehicle: Vehicle) -> Vehicle:
    return msgspec.structs.replace(vehicle, body=msgspec.structs.replace(vehicle.body, mass=1.01 * vehicle.body.mass))


def _vehicles(_: Path) -> list[Parts]:
    carried = effect_file("my_effects.py", "# nothing\n")
    with_text = msgspec.structs.replace(VEHICLE, effect_files=(carried,))
    texts = [path.read_bytes() for path in sorted(FOLDER.glob("*.toml"))] + [vehicle_toml(with_text).encode()]
    return [{"vehicle.toml": text} for text in (*texts, texts[0] + USES)]


def _thresholds(_: Path) -> list[Parts]:
    return [{"thresholds.toml": tomli_w.dumps(msgspec.to_builtins(Thresholds())).encode()}]


def _mappings(_: Path) -> list[Parts]:
    return [{"mapping.toml": path.read_bytes()} for path in sorted(mappings.FOLDER.glob("*.toml"))]


def _references(_: Path) -> list[Parts]:
    rows = [f"{t / 10},{0.02 * t},{0.001 * t * t},1.5,0.1" for t in range(30)]
    return [{"path.csv": "\n".join(["t,position_x,position_y,position_z,yaw", *rows, ""]).encode()}]


def _text(read: Callable[[str], object]) -> Callable[[Path], object]:
    """A reader of an option, which the shell hands over with surrogates where it is no UTF-8."""
    return lambda path: read(path.read_bytes().decode("utf-8", "surrogateescape"))


def _effect(text: str) -> None:
    for word in text.split("\n"):
        parse_effect(word, VEHICLE.rotors.count)


def _settings(text: str) -> None:
    with_settings(VEHICLE, text.split("\n"))


USES = b"""
[[effects]]
name = "motor_lag"
parameters = { time_constant = 0.03 }
[[effects]]
name = "weak_rotor"
rotor = 1
"""
EFFECTS = b"motor_lag:time_constant=0.03\nrotor_drag\nweak_rotor:loss=0.1,rotor=1\nwind:x=1,y=2\nslung_load:mass=0.05"
SETTINGS = b"controller.horizon=0.8\ncontroller.nodes=20\ncontroller.position_weight=[1.0, 2, 3]\ncontroller.rate=100"
OWN_EFFECTS = Path(__file__).parents[3] / "examples" / "my_effects.py"

TARGETS = (
    Target("vehicle", _vehicles, _vehicle),
    Target("vehicle_folder", _vehicles, lambda path: vehicle_files_in(path.parent)),
    Target("thresholds", _thresholds, read_thresholds),
    Target("mapping", _mappings, read_mapping),
    Target("scenario", lambda _: [{"scenario.toml": SCENARIO}], lambda path: read_scenario(path, 4)),
    Target("reference", _references, lambda path: read_table(path, VEHICLE)),
    Target("effect_option", lambda _: [{"effects": EFFECTS}], _text(_effect)),
    Target("setting_option", lambda _: [{"settings": SETTINGS}], _text(_settings)),
    Target("effect_file", lambda _: [{"my_effects.py": OWN_EFFECTS.read_bytes()}], read_effect_file),
)
