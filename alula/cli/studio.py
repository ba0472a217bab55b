"""`alula studio`: the way from logs to a better model as a local page in the browser."""

from __future__ import annotations

import os
import signal
import threading
import webbrowser
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from alula.api.inputs import log_paths
from alula.cli.intake import note_skipped, vehicle_beside
from alula.cli.options import Effects, HoldOut, Mapping, Pose
from alula.cli.output import print_next, print_secret
from alula.workbench import workbench
from dynamics.errors import RequestError
from dynamics.unpacking import raise_limits

if TYPE_CHECKING:
    from studio.app.studio import Studio

GIB = 1 << 30


def studio(
    logs: Annotated[list[Path] | None, typer.Argument(help="Logs to begin a case with, or folders of them.")] = None,
    vehicle: Annotated[str | None, typer.Option(help="Vehicle file, or the name of a bundled one.")] = None,
    case: Annotated[
        Path | None, typer.Option(help="Folder of the case: opened where there is one, else made there.")
    ] = None,
    hold_out: HoldOut = None,
    effects: Effects = None,
    mapping: Mapping = None,
    pose: Pose = None,
    cases: Annotated[Path | None, typer.Option(help="Folder in which new cases are made.")] = None,
    result: Annotated[
        list[Path] | None,
        typer.Option(help="A result to show: of --fleet, sweep, train, evaluate --json or fly --record; repeatable."),
    ] = None,
    port: Annotated[
        int | None, typer.Option(min=0, max=65535, help="Port on this computer; 0 for a free one. [default: 8642]")
    ] = None,
    memory: Annotated[
        float | None, typer.Option(min=0.5, help="GB that the working process may take; by default 60 % of all.")
    ] = None,
    browser: Annotated[bool, typer.Option(help="Open the page in the browser.")] = True,
    token: Annotated[
        str | None,
        typer.Option(
            envvar="ALULA_STUDIO_TOKEN",
            help="That opens the studio, for programs; by default a random one. Others see options in the list of "
            "processes: give it in the environment.",
        ),
    ] = None,
    unpack_files: Annotated[
        int | None, typer.Option(min=1, help="Files that an archive may hold. [default: 10000]", show_default=False)
    ] = None,
    unpack_gb: Annotated[
        float | None,
        typer.Option(min=0.001, help="GB that a compressed file may become. [default: 16]", show_default=False),
    ] = None,
    unpack_ratio: Annotated[
        float | None,
        typer.Option(min=1.0, help="Times its own bytes that it may become. [default: 100]", show_default=False),
    ] = None,
) -> None:
    """Open the studio: compare, see, add, and watch the error fall, by clicks.

    A local page, for you alone: its address has a token. Nothing leaves this computer and nothing is loaded from a
    network. Ctrl-C ends it; a case stays in its folder as it stood.
    """
    with workbench("alula studio"):
        from studies.results.read import RESULTS
        from studio.app.door import VARIABLE, Owner
        from studio.app.server import serve
        from studio.app.studio import Studio, default_root
    os.environ.pop(VARIABLE, None)  # the browser and the working processes need none
    owner = Owner(token or "")
    raise_limits(files=unpack_files, gigabytes=unpack_gb, ratio=unpack_ratio)
    room = Studio(cases or default_root(), RESULTS, memory=None if memory is None else int(memory * GIB))
    try:
        results = [room.open_result(path) for path in result or []]
        vehicle = vehicle or vehicle_beside(logs or [])
        note_skipped(logs or [], mapping, vehicle)
        place = _case(room, logs or [], vehicle, case, hold_out, effects or [], mapping, pose)
        place = f"result/{results[0]}" if results and not place else place
        server, address = serve(room, owner, port=port)
    except BaseException:
        room.close()
        raise
    address += place
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: threading.Thread(target=server.shutdown, daemon=True).start())
    print_secret(f"studio: {owner.address(address)}", logged=f"studio: {address}")
    print("Ctrl-C ends it.", flush=True)
    if browser and not os.environ.get("ALULA_NO_BROWSER"):
        webbrowser.open(owner.browser_address(address))
    try:
        server.serve_forever()
    finally:
        server.server_close()
        folders = [entry.folder for entry in room.entries()]  # the newest first
        room.close()
    if folders:
        print_next("studio", "--case", folders[0])


def _case(
    room: Studio,
    logs: list[Path],
    vehicle: str | None,
    case: Path | None,
    hold_out: str | None,
    effects: list[Path],
    mapping: Path | None,
    pose: str | None,
) -> str:
    """The case of a command line, opened or made, and its page's address; the list of cases where none is asked for."""
    from studio.case.case import is_case
    from studio.case.state import Options

    if case is not None and is_case(case):
        if vehicle:
            raise RequestError(f"{case} holds a case already. Open it alone, and choose the vehicle on its page.")
        return f"case/{room.open(case, logs=log_paths(logs, mapping) if logs else [], mapping=mapping)}/log"
    if case is None and not logs:
        if vehicle:
            raise RequestError("a vehicle without a log. Give logs too, or choose the vehicle on the page.")
        return ""
    files = log_paths(logs, mapping) if logs else []
    name = room.create(case, name=case.name if case else files[0].name.partition(".")[0])
    opened = room.case(name)
    if opened is None:
        raise RequestError(f"{case} cannot be opened.")
    options = Options(str(mapping.resolve()) if mapping else "", pose or "", hold_out or "")
    opened.case.set_options(options)
    for file in effects:
        opened.case.add_effect_file(file)
    opened.case.add_logs(files)
    if vehicle is not None:
        opened.case.set_vehicle(vehicle)
    if files:
        opened.start("check")
    return f"case/{name}/log"
