"""Models and their solvers: built here, or, where CasADi or a compiler is missing, those that a wheel carries.

Every physical constant is an argument of a solver, so that one serves all vehicles with as many rotors, the same
effects and the same nodes. What else a controller must know of a vehicle with effects is stored by vehicle.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Mapping, Sequence
from importlib import resources
from pathlib import Path

import msgspec

from dynamics import symbolic
from dynamics.active_effect import ActiveEffect, activate, time_constants
from dynamics.codegen import has_compiler
from dynamics.decoding import decode_json
from dynamics.effect import Effect
from dynamics.effects import CATALOGUE
from dynamics.errors import RequestError
from dynamics.integrators import max_step
from dynamics.model import Model, build_model
from dynamics.own_effects import catalogue_of
from dynamics.vehicle import Vehicle
from dynamics.workbench_install import workbench_install
from runtime.control.kernel_model import FlownModel, KernelFacts, KernelModel, nominal_kernel_model
from runtime.control.rti.problem import Problem
from runtime.control.rti.processor import PROCESSORS, Processor

FOLDER = Path(str(resources.files("runtime.control.rti"))) / "kernels"
FACTS = "facts.json"
EXPORT = "`alula export` the model on a workbench, with --processor of this computer, and give `--bundle B` here"


def flown_model(vehicle: Vehicle, catalogue: Mapping[str, Effect] = CATALOGUE) -> FlownModel:
    """The model of a vehicle with its effects. Raises RequestError where it needs CasADi, which is not there."""
    if symbolic.is_installed():
        return build_model(vehicle, catalogue=catalogue)
    if not vehicle.effects:
        return nominal_kernel_model(vehicle)
    facts = stored_facts().get(facts_key(vehicle))
    if facts is None:
        raise RequestError(
            f"the effects of {vehicle.name} need CasADi, which the flight computer's install leaves out: {EXPORT}, or "
            f"{workbench_install()}."
        )
    return KernelModel.of(vehicle, facts)


def solver_library(model: FlownModel, problem: Problem) -> Path:
    """The solver of a model: compiled unless cached, or a prebuilt one. Raises RequestError when there is neither."""
    if isinstance(model, Model) and has_compiler():
        from runtime.control.rti.compilation import build_solver  # writes formulas out, which only this case needs

        return build_solver(model, problem)
    usable = [processor for processor in PROCESSORS.values() if processor.runs_here]
    for processor in usable:
        path = prebuilt_path(FOLDER, processor, _effects(model), model.vehicle, problem)
        if path.is_file():
            return path
    raise RequestError(
        f"no compiled controller of {model.vehicle.name} with {problem.nodes} nodes in {problem.horizon:g} s came with "
        f"this install, and making one needs CasADi and a C compiler: {EXPORT}, or {workbench_install()} and "
        "a compiler, such as Debian's gcc."
    )


def prebuilt_path(
    folder: Path, processor: Processor, effects: Sequence[ActiveEffect], vehicle: Vehicle, problem: Problem
) -> Path:
    """Where the solver for as many rotors, these effects and nodes is, if it was built; for intervals of any length."""
    longest = max_step(time_constants(effects))
    parts = [processor.name, f"{vehicle.rotors.count}_rotors", *(item.key for item in effects)]
    steps = f"-{1e3 * longest:g}ms" if math.isfinite(longest) else ""
    return folder / processor.machine / f"{'-'.join(parts)}-{problem.nodes}{steps}.so"


def facts_key(vehicle: Vehicle) -> str:
    """Key of the facts of a vehicle's model."""
    return hashlib.sha256(msgspec.json.encode((vehicle.body, vehicle.rotors, vehicle.effects))).hexdigest()


def stored_facts() -> dict[str, KernelFacts]:
    """Facts of the vehicles that were built with this install, by `facts_key`."""
    try:
        return decode_json((FOLDER / FACTS).read_bytes(), dict[str, KernelFacts])
    except FileNotFoundError:
        return {}


def _effects(model: FlownModel) -> Sequence[ActiveEffect]:
    if isinstance(model, Model):
        return model.effects
    return activate(model.vehicle, model.vehicle.effects, catalogue_of(model.vehicle))[0]
