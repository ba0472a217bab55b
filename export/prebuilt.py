"""Solvers, and the tick in C, that a wheel carries, so that the vehicles it ships fly without CasADi and a compiler.

python -m export.prebuilt aarch64 FOLDER
"""

from __future__ import annotations

import argparse
import shutil
from collections.abc import Iterator
from pathlib import Path

import msgspec

from dynamics.model import build_model
from dynamics.vehicle import Vehicle
from dynamics.vehicle_file import read_vehicle
from dynamics.vehicle_sizing import size_vehicle
from export.compiler import compiler_for
from export.kernel import KernelRecipe, build_kernel
from runtime.control.kernel_model import kernel_facts
from runtime.control.rti.compilation import ENTRY, solver_recipe
from runtime.control.rti.prebuilt import FACTS, facts_key, prebuilt_path
from runtime.control.rti.problem import Problem
from runtime.control.rti.processor import PROCESSORS, Processor
from runtime.tick.library import build_tick, prebuilt_tick
from vehicles import FOLDER

LEFT_OUT = ("avx512",)  # of x86 processors, each has at least one of the others
FRAMES = ("hexa_x", "octa_x")  # of vehicles without effects, beside the bundled quadrotors


def main() -> None:
    """Build the solvers for a machine, as `platform.machine` names it, into a folder."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("machine", choices=sorted({processor.machine for processor in PROCESSORS.values()}))
    parser.add_argument("folder", type=Path)
    arguments = parser.parse_args()
    for path in build_prebuilt(arguments.machine, arguments.folder):
        print(path)


def build_prebuilt(machine: str, folder: Path) -> list[Path]:
    """The tick in C, solvers and facts of the bundled vehicles, and of any without effects with 4, 6 or 8 rotors.

    Raises RequestError where the compiler for the machine is missing.
    """
    made, facts = list[Path](), dict[str, object]()
    tick = prebuilt_tick(folder, machine)
    tick.parent.mkdir(parents=True, exist_ok=True)
    shutil.copyfile(build_tick(compiler_for(_of(machine)[0])), tick)
    for processor in _of(machine):
        compiler = compiler_for(processor)
        for vehicle in _vehicles():
            model, problem = build_model(vehicle), Problem.from_settings(vehicle.controller)
            path = prebuilt_path(folder, processor, model.effects, vehicle, problem)
            path.parent.mkdir(parents=True, exist_ok=True)
            sources, flags = solver_recipe(model, problem, processor)
            shutil.copyfile(build_kernel(KernelRecipe(sources, flags, ENTRY), compiler), path)
            made.append(path)
            facts[facts_key(vehicle)] = kernel_facts(model)
    (folder / FACTS).write_bytes(msgspec.json.encode(facts))
    return [*dict.fromkeys(made), tick, folder / FACTS]


def _of(machine: str) -> list[Processor]:
    """The processors of a machine that solvers are built for."""
    return [each for each in PROCESSORS.values() if each.machine == machine and each.name not in LEFT_OUT]


def _vehicles() -> Iterator[Vehicle]:
    for path in sorted(FOLDER.glob("*.toml")):
        yield read_vehicle(path)
    for frame in FRAMES:
        draft = size_vehicle(
            name=frame, mass=2.0, arm=0.4, propeller=0.25, kv=900, cells=4, frame=frame, blades=2, command=""
        )
        yield draft.vehicle


if __name__ == "__main__":
    main()
