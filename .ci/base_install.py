"""Proof that an install without the workbench's packages is whole: what flies imports, all data came along.

Of `alula` the command line and the commands' own modules are imported: commands of the workbench bring what they need
when they are called.
"""

import importlib
import importlib.util
import pkgutil
from importlib.resources import files

import alula
from alula.cli.app import COMMANDS
from dynamics.vehicle_file import read_vehicle

ROOMS = ("dynamics", "runtime", "sitl_mock", "vehicles")
WORKBENCH = ("torch", "scipy", "matplotlib")

present = [name for name in WORKBENCH if importlib.util.find_spec(name)]
assert not present, f"the base install must not bring {present}"

modules = [
    module_info.name
    for room in ROOMS
    for module_info in pkgutil.walk_packages(importlib.import_module(room).__path__, prefix=f"{room}.")
]
for name in (*modules, *(f"alula.cli.{command}" for command in COMMANDS)):
    importlib.import_module(name)

vehicles = [read_vehicle(str(path)).name for path in files("vehicles").iterdir() if path.name.endswith(".toml")]
assert "arpl_250g" in vehicles, f"the vehicle files are missing: {vehicles}"
assert callable(alula.fly), "the base install must fly from Python, too"
assert alula.load_vehicle("arpl_250g").name == "arpl_250g"
print(f"base install: {len(modules)} modules, vehicles {', '.join(sorted(vehicles))}")
