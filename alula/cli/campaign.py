"""`alula campaign`: flies the paper's data set on the mock's vehicle."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.table import Table

from alula.cli.console import Console
from alula.cli.options import Effects
from alula.cli.output import print_next
from alula.workbench import workbench
from dynamics.errors import RequestError
from dynamics.files import STANDARD_OUTPUT, write_answer

if TYPE_CHECKING:
    from simulation.campaign import CampaignManifest


def campaign(
    out: Annotated[
        Path,
        typer.Option(help="Folder to write; an unfinished campaign continues there."),
    ],
    vehicle: Annotated[str, typer.Option(help="Vehicle file (TOML), or the name of a bundled one.")] = "arpl_250g",
    effect: Annotated[
        list[str] | None,
        typer.Option(
            help="What the vehicle hides: name:key=value,...; repeatable. By default what a real one hides: drags, "
            "flapping, inflow, motor lag, small errors of thrust and inertia, gusts."
        ),
    ] = None,
    effects: Effects = None,
    no_effects: Annotated[
        bool, typer.Option("--no-effects", help="Hide nothing: the simulated domain of the paper's starred baselines.")
    ] = False,
    scenario: Annotated[Path | None, typer.Option(help="Scenario file (TOML): sensors, battery, effects.")] = None,
    seed: Annotated[int, typer.Option(help="Seed of all randomness: same seed, same bits.")] = 0,
    flights: Annotated[
        list[str] | None, typer.Option(help="Names, patterns (Lemniscate*), train or test; repeatable. All by default.")
    ] = None,
    jobs: Annotated[int | None, typer.Option(min=1, help="Processes; one for every core by default.")] = None,
    scheduler: Annotated[str | None, typer.Option(help="Dask scheduler to fly on, tcp://HOST:PORT.")] = None,
    csv: Annotated[bool, typer.Option("--csv", help="Write CSV instead of Parquet.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print the manifest as JSON, progress on stderr.")] = False,
) -> None:
    """Fly the paper's 68 trajectories (58 min; 60 to train, 8 to test) in simulated time, with the nominal model."""
    if no_effects and effect:
        raise RequestError("--no-effects and --effect contradict each other. Give one of them.")
    with workbench("alula campaign"):
        from simulation.campaign import Campaign, CampaignOptions
    options = CampaignOptions(
        folder=out,
        vehicle=vehicle,
        effects=() if no_effects else tuple(effect) if effect else None,
        effect_files=tuple(effects or ()),
        scenario=scenario,
        seed=seed,
        flights=tuple(flights or ()),
        jobs=jobs,
        scheduler=scheduler,
        csv=csv,
    )
    request = Campaign(options)
    console = Console(stderr=as_json)
    columns = (
        TextColumn("{task.description:24}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=console) as bar:
        task = bar.add_task("flying", total=len(request.flights))
        manifest = request.run(lambda summary: bar.update(task, advance=1, description=summary.name))
    if as_json:
        write_answer(manifest, STANDARD_OUTPUT)
    else:
        _print(manifest, out, console)
        print_next("train", out, "--vehicle", vehicle, "--model", "pi_tcn", "--out", "pi_tcn.pt")


def _print(manifest: CampaignManifest, out: Path, console: Console) -> None:
    table = Table("flight", title="flown", title_justify="left")
    for heading in ("s", "at speed", "RMSE m", "m/s", "m/s²", "rad/s²", "rpm"):
        table.add_column(heading, justify="right")
    for flight in manifest.flights:
        if flight.split == "test" or len(manifest.flights) <= 16:
            table.add_row(
                flight.name,
                f"{flight.duration:.1f}",
                f"{flight.speed:.2f}",
                f"{flight.position_rmse:.3f}",
                f"{flight.peak_speed:.2f}",
                f"{flight.peak_acceleration:.1f}",
                f"{flight.peak_angular_acceleration:.0f}",
                f"{flight.peak_rotor_rpm:.0f}",
            )
    console.print(table)
    minutes, seconds = divmod(round(manifest.duration), 60)
    console.print(
        f"{len(manifest.flights)} flights, {minutes} min {seconds:02d} s, up to {manifest.peak_speed:.1f} m/s, "
        f"{manifest.peak_acceleration:.1f} m/s², {manifest.peak_angular_acceleration:.0f} rad/s², "
        f"{manifest.peak_rotor_rpm:.0f} rpm; written to {out}",
        highlight=False,
    )
