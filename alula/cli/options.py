"""Options that several commands share."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer

from dynamics.recorded_vehicle import choose_system

Logs = Annotated[
    list[Path], typer.Argument(help="Logs of one vehicle in any format, or folders of them.", metavar="LOG...")
]
VehicleOption = Annotated[
    str | None,
    typer.Option(
        "--vehicle",
        help="Vehicle file (TOML), or the name of a bundled one; by default the one in the folder of the logs.",
        show_default=False,
    ),
]
HoldOut = Annotated[
    str | None,
    typer.Option(
        help="File names to hold out, as a pattern; by default the last fifth of the flights, or blocks of all where "
        "these do not fly as the others do."
    ),
]


def _approved(paths: list[Path] | None) -> list[Path] | None:
    """Files that the user names for this call, and by that approves for it."""
    from dynamics.trust import approve_given

    approve_given(paths)
    return paths


Effects = Annotated[
    list[Path] | None,
    typer.Option(
        "--effects",
        callback=_approved,
        help="Python file with effects of your own, beside the vehicle file's; runs in this call; repeatable.",
    ),
]


def _chosen(system: int | None) -> int | None:
    """The vehicle that the call reads from recordings of several, which are said on screen."""
    from alula.cli.escaping import printable

    choose_system(system, lambda line: print(printable(line), file=sys.stderr))
    return system


RecordedSystem = Annotated[
    int | None,
    typer.Option(
        "--system",
        min=1,
        max=255,
        callback=_chosen,
        help="System id of the vehicle to read where a tlog holds several; by default the first autopilot.",
    ),
]


def _joined(context: typer.Context, one_flight: bool) -> bool:
    """Several logs of the call as files of one flight."""
    from dynamics.joined_logs import join_logs

    join_logs(one_flight)
    context.call_on_close(lambda: join_logs(False))
    return one_flight


OneFlight = Annotated[
    bool,
    typer.Option(
        "--one-flight",
        callback=_joined,
        help="The logs are files of one flight, stamped by one clock, as the blocks of the Crazyflie client are.",
    ),
]
Page = Annotated[Path | None, typer.Option("--html", help="Write a page with all pictures, one file, to this path.")]
Figures = Annotated[
    Path | None,
    typer.Option("--figures", help="Folder for every picture as PDF, SVG and PNG; needs Chromium or Chrome."),
]
Mapping = Annotated[Path | None, typer.Option("--mapping", help="Column mapping (TOML) for CSV files of other tools.")]
Pose = Annotated[
    str | None,
    typer.Option(help="Where the pose comes from, mocap or estimator; by default as the logs tell.", metavar="SOURCE"),
]

# Of a link to a vehicle.
LINK = "udpin:127.0.0.1:14540"
LinkOption = Annotated[
    str,
    typer.Option(
        "--link",
        help="Where the vehicle is: udpin:, udpout:, tcp:, tcpin: or serial:. 127.0.0.1 hears this machine alone, "
        "0.0.0.0 the whole network.",
    ),
]
System = Annotated[
    int | None, typer.Option(min=1, max=255, help="System id of the vehicle; needed where several are on the link.")
]
Roaming = Annotated[
    bool,
    typer.Option(
        "--roaming", help="Let the vehicle continue from another address after 2 s of silence, as behind a modem."
    ),
]
Signing = Annotated[
    Path | None,
    typer.Option(
        "--signing-key",
        help="Key file (mode 600) of MAVLink 2 signing: sign all that is sent, accept nothing unsigned of the vehicle.",
        metavar="FILE",
    ),
]
Timeout = Annotated[float, typer.Option(min=0.1, help="Seconds to wait for the vehicle.")]
