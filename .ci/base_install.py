"""Proof that an install without the workbench's packages is whole: what flies imports, all data came along.

Of `alula` the command line and the commands' own modules are imported: commands of the workbench bring what they need
when they are called.
"""

import importlib
import importlib.util
import pkgutil
from importlib.resources import files as files_of
from pathlib import Path

import alula
from alula.cli.app import COMMANDS
from dynamics.vehicle_file import read_vehicle

ROOMS = ("dynamics", "runtime", "vehicles")
OF_THE_WORKBENCH = ("mock", "demo")  # commands that simulate PX4, with all of pymavlink
WORKBENCH = ("casadi", "onnxruntime", "pymavlink", "torch", "scipy", "matplotlib")
LIMIT = 150e6  # bytes of what Alula brings, byte code included
OF_VENV = ("pip", "setuptools", "pkg_resources", "_distutils_hack")

present = [name for name in WORKBENCH if importlib.util.find_spec(name)]
assert not present, f"the base install must not bring {present}"

modules = [
    module_info.name
    for room in ROOMS
    for module_info in pkgutil.walk_packages(importlib.import_module(room).__path__, prefix=f"{room}.")
]
for name in (*modules, *(f"alula.cli.{command}" for command in COMMANDS if command not in OF_THE_WORKBENCH)):
    importlib.import_module(name)

vehicles = [read_vehicle(str(path)).name for path in files_of("vehicles").iterdir() if path.name.endswith(".toml")]
assert "arpl_250g" in vehicles, f"the vehicle files are missing: {vehicles}"
assert callable(alula.fly), "the base install must fly from Python, too"
assert alula.load_vehicle("arpl_250g").name == "arpl_250g"

site = Path(alula.__file__).parents[1]
brought = [path for path in site.iterdir() if not path.name.startswith(OF_VENV)]
files = [file for path in brought for file in (path.rglob("*") if path.is_dir() else [path]) if file.is_file()]
size = sum(file.stat().st_size for file in files)
assert size <= LIMIT, f"the base install takes {size / 1e6:.0f} MB, at most {LIMIT / 1e6:.0f} MB are allowed"
print(f"base install: {size / 1e6:.0f} MB, {len(modules)} modules, vehicles {', '.join(sorted(vehicles))}")
