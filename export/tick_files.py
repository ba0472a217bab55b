"""The tick in C for a user's own node: its sources, an example, and the numbers of a bundle's vehicle as a C header."""

from __future__ import annotations

import ctypes
import math
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np

from dynamics.arrays import Floats
from dynamics.model import ENVIRONMENT_DEFAULT
from runtime.control.controller import Controller, ControllerOptions
from runtime.control.kernel_model import FlownModel
from runtime.control.rti.problem import Problem, fill_options
from runtime.flight.health import HealthLimits
from runtime.flight.thrust import ThrustMap
from runtime.link.estimate import EstimateLimits
from runtime.tick import context
from runtime.tick.library import tick_sources
from runtime.tick.structs import structs_of

FOLDER, VEHICLE_HEADER, EXAMPLE, NODE = "tick", "tick_vehicle.h", "tick_example.c", "tick_node.h"
THREAD = "receiver.c"  # Python's, which a node of its own does without


def tick_files(model: FlownModel, problem: Problem, kernel: Path, name: str) -> dict[str, str]:
    """Texts by file name. kernel: of the model, compiled for this machine. name: of the kernel in the bundle."""
    sources = {file: text for file, text in tick_sources().items() if file != THREAD}
    own = {file: resources.files("export").joinpath(file).read_text(encoding="utf-8") for file in (EXAMPLE, NODE)}
    options = ControllerOptions.for_vehicle(model.vehicle).for_kernel(problem)
    controller = Controller(model, options, library=kernel)
    return {**sources, **own, VEHICLE_HEADER: _vehicle_header(controller, sources["tick.h"], name)}


def _vehicle_header(controller: Controller, header: str, name: str) -> str:
    structs, model, options = structs_of(header), controller.model, controller.options
    vehicle, trim = model.vehicle, controller.trim
    curve = ThrustMap(trim.rotors.thrust_max, trim.rotors.thrust_curve, 0.0)
    own: dict[str, Any] = {kind: structs[f"alula_{kind}"]() for kind in ("vehicle", "limits", "messages")}
    context.write_vehicle(own["vehicle"], trim, controller, curve)
    context.write_limits(own["limits"], EstimateLimits(), HealthLimits.for_vehicle(vehicle))
    context.write_messages(own["messages"])
    problem = options.problem
    words = np.frombuffer(bytes(fill_options(problem, model, controller.solver.trim)).ljust(8, b"\0"), dtype=np.uint64)
    arrays: dict[str, Floats] = {
        "hover": controller.solver.trim.rotor_speed,
        "offsets": problem.offsets,
        "hidden": np.append(model.hidden_initial, 0.0),
        "parameters": model.parameter_values,
        "environment": ENVIRONMENT_DEFAULT,
    }
    lines = [
        f"/* Numbers of {vehicle.name}, for the kernel {name}; written by `alula export`. The autopilot's THR_MDL_FAC",
        " * is taken for 0: set context.vehicle.autopilot_curve where it is not. */",
        "#ifndef ALULA_VEHICLE_H",
        "#define ALULA_VEHICLE_H",
        '#include <math.h>\n\n#include "tick.h"\n',
        f"#define ALULA_NX {model.state_count}",
        f"#define ALULA_NU {model.input_count}",
        f"#define ALULA_NODES {problem.nodes}",
        f"#define ALULA_PERIOD {options.period!r} /* s between ticks */",
        f"#define ALULA_MAX_ERROR {options.max_position_error!r} /* m */\n",
        f"static const uint64_t alula_options[] = {{{', '.join(f'{word:#x}u' for word in words.tolist())}}};",
        *(f"static const double alula_{kind}[] = {_initialiser(values)};" for kind, values in arrays.items()),
        *(f"static const alula_{kind} alula_own_{kind} = {_initialiser(value)};" for kind, value in own.items()),
        "\n#endif",
    ]
    return "\n".join(lines) + "\n"


def _initialiser(value: Any) -> str:
    """A C initialiser of a ctypes struct, an array or a number."""
    if isinstance(value, ctypes.Structure):
        members = (f".{field[0]} = {_initialiser(getattr(value, field[0]))}" for field in value._fields_)
        return f"{{{', '.join(members)}}}"
    if isinstance(value, int):
        return str(value)
    if isinstance(value, float):
        return ("-" if value < 0 else "") + "INFINITY" if math.isinf(value) else repr(float(value))
    return f"{{{', '.join(_initialiser(item) for item in value)}}}"
