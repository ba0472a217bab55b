"""`alula export`: a trained model, or a vehicle file, as a bundle that flies."""

from __future__ import annotations

import shlex
import sys
from pathlib import Path
from typing import Annotated

import msgspec
import typer

from alula.cli.workbench import workbench
from runtime.control.bundle import Integrator
from vehicles import vehicle_path


def export(
    model: Annotated[str, typer.Argument(help="Checkpoint (.pt) of `alula train`, or a vehicle file for its physics.")],
    out: Annotated[Path, typer.Option(help="Folder to write.")],
    logs: Annotated[
        list[Path] | None,
        typer.Option("--log", help="Flight whose windows the backends are compared on; repeatable; else references."),
    ] = None,
    member: Annotated[int, typer.Option(min=0, help="Member of an ensemble that flies.")] = 0,
    processor: Annotated[str, typer.Option(help="native, avx512, avx2 or sse2.")] = "native",
    integrator: Annotated[
        Integrator | None,
        typer.Option(help="How the kernel makes motion of accelerations; what fits the model's labels if left out."),
    ] = None,
    nodes: Annotated[int, typer.Option(min=2, help="Nodes of the horizon.")] = 20,
    horizon: Annotated[float, typer.Option(min=0.1, help="Length of the horizon, s.")] = 1.0,
    windows: Annotated[int, typer.Option(min=10, help="Windows of each kind to compare on.")] = 1000,
    seed: Annotated[int, typer.Option(help="Seed of the random windows.")] = 0,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace an existing bundle.")] = False,
    flight_check: Annotated[
        bool,
        typer.Option("--flight-check/--no-flight-check", help="Fly a learned model for some seconds in simulation."),
    ] = True,
    as_json: Annotated[bool, typer.Option("--json", help="Print comparisons and flight check as JSON.")] = False,
) -> None:
    """Write ONNX, C and the real-time kernel of a model, and prove that they compute what was trained."""
    with workbench("alula export"):
        from export.bundle import ExportOptions, export_bundle, summary
        from export.trained import read_model
        from runtime.control.rti.problem import Problem
        from runtime.control.rti.processor import named_processor
        from simulation.flight_check import check_bundle

    options = ExportOptions(
        Problem(nodes=nodes, horizon=horizon), named_processor(processor), tuple(logs or ()), windows, seed, overwrite,
        shlex.join(["alula", *sys.argv[1:]]),
    )  # fmt: skip
    path = Path(model) if Path(model).suffix == ".pt" else vehicle_path(model)
    exported = export_bundle(read_model(path, member=member, integrator=integrator), out, options)
    check = check_bundle(out, exported.manifest) if flight_check else None
    if as_json:
        told = {**msgspec.to_builtins(exported.parity), "flight_check": check and check.told}
        sys.stdout.buffer.write(msgspec.json.format(msgspec.json.encode(told)) + b"\n")
        return
    print("\n".join(summary(exported)))
    if check is not None:
        print(f"warning: {check.warning}" if check.warning else f"flight check: {check.text}")
