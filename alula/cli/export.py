"""`alula export`: a trained model, or a vehicle file, as a bundle that flies; and its verification where it flies."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

import alula
from alula.cli.options import Effects
from alula.cli.output import print_next
from dynamics.errors import RequestError
from dynamics.files import STANDARD_OUTPUT, write_answer
from runtime.control.bundle import Integrator
from runtime.control.rti.processor import PROCESSORS, named_processor


def export(
    model: Annotated[
        str | None, typer.Argument(help="Checkpoint (.pt) of `alula train`, or a vehicle file for its physics.")
    ] = None,
    out: Annotated[Path | None, typer.Option(help="Folder to write.")] = None,
    verify: Annotated[
        Path | None,
        typer.Option(
            metavar="BUNDLE",
            help="Instead of exporting: check on this computer that a bundle's kernel answers as at its export, and "
            "how long a tick takes.",
        ),
    ] = None,
    effects: Effects = None,
    logs: Annotated[
        list[Path] | None,
        typer.Option(
            "--log",
            help="Flight or folder of flights whose windows the backends are compared on; repeatable; else references.",
        ),
    ] = None,
    member: Annotated[int, typer.Option(min=0, help="Member of an ensemble that flies.")] = 0,
    processor: Annotated[str, typer.Option(help=f"Of the kernel: native, {', '.join(PROCESSORS)}.")] = "native",
    integrator: Annotated[
        Integrator | None,
        typer.Option(help="How the kernel makes motion of accelerations; by default what fits the model's labels."),
    ] = None,
    nodes: Annotated[
        int | None, typer.Option(min=2, help="Nodes of the horizon; the vehicle file's, 20, if left out.")
    ] = None,
    horizon: Annotated[
        float | None, typer.Option(min=0.1, help="Length of the horizon, s; the vehicle file's, 1, if left out.")
    ] = None,
    windows: Annotated[int, typer.Option(min=10, help="Windows of each kind to compare on.")] = 1000,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the random windows.")] = 0,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace an existing bundle.")] = False,
    flight_check: Annotated[
        bool,
        typer.Option("--flight-check/--no-flight-check", help="Fly a learned model for some seconds in simulation."),
    ] = True,
    as_json: Annotated[bool, typer.Option("--json", help="Print comparisons and flight check as JSON.")] = False,
) -> None:
    """Write ONNX, C and the real-time kernel of a model, and prove that they compute the same."""
    if verify is not None:
        _verify(verify, [model, out], as_json=as_json)
        return
    if model is None or out is None:
        raise RequestError("nothing to export: give MODEL and --out FOLDER, or --verify BUNDLE.")
    result = alula.export(
        model,
        out,
        effect_files=effects or (),
        logs=logs or (),
        member=member,
        processor=processor,
        integrator=integrator,
        nodes=nodes,
        horizon=horizon,
        windows=windows,
        seed=seed,
        overwrite=overwrite,
        flight_check=flight_check,
    )
    if as_json:
        write_answer(result.report, STANDARD_OUTPUT)
        return
    print("\n".join(result.summary))
    if (check := result.flight_check) is not None:
        print(f"warning: {check.warning}" if check.warning else f"flight check: {check.text}")
    if result.of_nominal is not None and result.of_nominal >= 1:
        print(
            f"warning: not to be flown: on its validation flights the model errs {result.of_nominal:.3g} times as much "
            "as the nominal one"
        )
        print_next("train", "--help")
    elif named_processor(processor).runs_here:
        _print_flight(out)
    else:
        print_next("export", "--verify", out)


def _verify(bundle: Path, others: list[object], *, as_json: bool) -> None:
    if any(other is not None for other in others):
        raise RequestError("--verify checks a bundle that was exported: leave MODEL and --out out.")
    verification = alula.verify(bundle)
    if as_json:
        write_answer(verification, STANDARD_OUTPUT)
    else:
        print("\n".join(verification.lines))
    verification.require()
    if not as_json:
        _print_flight(bundle)


def _print_flight(bundle: Path) -> None:
    print_next("fly", "--bundle", bundle, "--reference", "hover", "--record", "recordings")
