"""model.c and model.h: CasADi's generated forward and Jacobian, and an example that calls them."""

from __future__ import annotations

import tempfile
from importlib import resources
from pathlib import Path

import casadi as ca

from dynamics.codegen import CompiledFunction, build_library
from export.symbolic import jacobian_function, model_function
from export.trained import ExportedModel

SOURCE, HEADER, EXAMPLE = "model.c", "model.h", "example.c"
FLAGS = ("-O2", "-fPIC", "-shared", "-w")


def c_files(model: ExportedModel) -> dict[str, str]:
    """Text of model.c, model.h and example.c. Nothing in them depends on this machine."""
    generator = ca.CodeGenerator(SOURCE, {"with_header": True, "casadi_int": "long long int"})
    generator.add(model_function(model))
    generator.add(jacobian_function(model))
    with tempfile.TemporaryDirectory() as folder:
        generator.generate(f"{folder}/")
        texts = {name: (Path(folder) / name).read_text() for name in (SOURCE, HEADER)}
    hidden = ", ".join(repr(float(value)) for value in model.flight_model.hidden_initial) or "0"
    constants = (
        "\n/* Of this model: seconds between columns, hover speed in rad/s, hidden states in hover. */\n"
        f"static const double alula_model_dt = {model.config.dt!r};\n"
        f"#define HOVER_SPEED {model.vehicle.hover_speed!r}\n"
        f"static const double hidden_initial[] = {{{hidden}}};\n"
    )
    end = texts[HEADER].rindex("#ifdef __cplusplus")
    texts[HEADER] = texts[HEADER][:end] + constants.lstrip("\n") + "\n" + texts[HEADER][end:]
    texts[EXAMPLE] = resources.files("export").joinpath(EXAMPLE).read_text()
    return texts


def build_c_files(files: dict[str, str]) -> Path:
    """Path of the compiled model.c. Raises RequestError when there is no compiler."""
    return build_library({name: files[name] for name in (SOURCE, HEADER)}, flags=FLAGS, entry=SOURCE)


def compiled(model: ExportedModel, files: dict[str, str]) -> dict[str, CompiledFunction]:
    """Forward and Jacobian of a bundle's model.c as this machine's code, by name."""
    library = build_c_files(files)
    functions = (model_function(model), jacobian_function(model))
    return {function.name(): CompiledFunction(function, library) for function in functions}
