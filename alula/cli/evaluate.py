"""`alula evaluate`: models on held-out flights, in the tables and figures of the paper and beyond them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer

import alula
from alula.cli.console import Console
from alula.cli.intake import note_skipped
from alula.cli.options import Effects, RecordedSystem
from alula.cli.output import print_next
from dynamics.files import STANDARD_OUTPUT
from studies.tables import terminal_table

Arguments = Annotated[
    list[Path],
    typer.Argument(
        help="Models (.pt), then logs, folders of logs, or a campaign's folder for its test flights.",
        metavar="MODEL... LOG...",
    ),
]


def evaluate(
    arguments: Arguments,
    vehicle: Annotated[
        str | None, typer.Option(help="Vehicle file (TOML) or name whose own model is evaluated beside the others.")
    ] = None,
    effects: Effects = None,
    mapping: Annotated[Path | None, typer.Option(help="Column mapping (TOML) for CSV files of other tools.")] = None,
    system: RecordedSystem = None,
    no_timing: Annotated[bool, typer.Option("--no-timing", help="Do not measure how long a prediction takes.")] = False,
    json_file: Annotated[Path | None, typer.Option("--json", help="Write every figure as JSON; - for stdout.")] = None,
    csv: Annotated[Path | None, typer.Option(help="Folder for one CSV file a table.")] = None,
    pictures: Annotated[Path | None, typer.Option(help="Folder for pictures, PNG and PDF.")] = None,
    html: Annotated[Path | None, typer.Option(help="Write tables and pictures as one page to this file.")] = None,
) -> None:
    """Evaluate models on held-out flights; with a campaign's flights against ground truth, too."""
    models = [path for path in arguments if path.suffix == ".pt"]
    logs = [path for path in arguments if path.suffix != ".pt"]
    note_skipped(logs, mapping)
    console = Console(stderr=json_file == STANDARD_OUTPUT)
    with console.status("reading the flights") as status:
        result = alula.evaluate(
            models,
            logs,
            vehicle=vehicle,
            effect_files=effects or (),
            mapping=mapping,
            timing=not no_timing,
            progress=lambda name: status.update(f"evaluated {name}"),
        )
    for table in result.tables:
        console.print(terminal_table(table))
        console.print()
    for line in result.summary:
        console.print(line, highlight=False)
    written: list[Path] = []
    if json_file is not None:
        result.write_json(json_file)
    if csv is not None:
        written += result.write_csv(csv)
    if pictures is not None:
        written += result.write_pictures(pictures)
    if html is not None:
        result.write_html(html)
        written.append(html)
    for path in written:
        console.print(f"written: {path}", highlight=False)
    if json_file != STANDARD_OUTPUT:
        print_next(*_following(models, logs, vehicle, result.of_nominal))


def _following(
    models: Sequence[Path], logs: Sequence[Path], vehicle: str | None, of_nominal: Sequence[float]
) -> list[object]:
    """Next command: export the first model that errs less than the nominal one, or train one.

    of_nominal: RMSE of each model over that of the nominal model.
    """
    better = [path for path, ratio in zip(models, of_nominal, strict=True) if ratio < 1]
    if better:
        return ["export", better[0], "--out", better[0].with_suffix("")]
    if models:
        return ["train", "--help"]
    return ["train", *logs, "--vehicle", vehicle, "--model", "pi_tcn", "--out", "pi_tcn.pt"]
