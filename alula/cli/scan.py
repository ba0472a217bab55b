"""`alula scan`: what broke in each flight of a folder, one JSON line a log."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Annotated, Any, TextIO

import typer

from alula.cli.console import Console
from alula.cli.output import command
from alula.cli.progress import counting_bar
from dynamics.errors import DataError, RequestError
from dynamics.version import VERSION_KEY, __version__


def scan(
    folder: Annotated[Path, typer.Argument(help="Folder of logs of any format.", metavar="FOLDER")],
    jobs: Annotated[int, typer.Option(help="Logs that are read at the same time.", min=1)] = 1,
    out: Annotated[Path | None, typer.Option(help="File for the lines; standard output by default.")] = None,
) -> None:
    """Tell for every log of a folder what broke first: one JSON line a log, with the columns of PX4's Flight Review.

    A log that cannot be read is a line with an error. Lines come as logs are finished; an interrupt keeps those.
    """
    from alula.workbench import workbench

    with workbench("alula scan"):
        from flights.folder import LOGGED, folder_content
        from flights.health.scan import scanned
        from flights.parallel import parallel_map
    if not folder.is_dir():
        raise RequestError(f"{folder} is no folder. Give a folder of logs, or one log to `alula inspect`.")
    content = folder_content(folder)
    named = [path for path in content.others if path.name.removesuffix(".gz").endswith(LOGGED)]
    logs = [str(path) for path in sorted((*content.logs, *named))]
    if not logs:
        raise RequestError(f"there is no log in {folder}. Give a folder of ULog, DataFlash, MCAP, CSV or other logs.")
    errors = 0
    console = Console(stderr=True)
    stream = sys.stdout if out is None else _opened(out)
    try:
        with counting_bar(console) as bar:
            bar.disable = not console.is_terminal
            task = bar.add_task("scan", total=len(logs), last="")
            for place, line in parallel_map(scanned, logs, jobs=jobs):
                errors += line["outcome"] == "error"
                _write(line, stream)
                bar.update(task, advance=1, last=Path(logs[place]).name)
    finally:
        if out is not None:
            stream.close()
    if errors == len(logs):
        raise DataError(f"none of {errors} logs could be read; each line has the reason.")
    print(f"next: {command('inspect', folder)}", file=sys.stderr)  # lines of JSON are on standard output


def _opened(out: Path) -> TextIO:
    try:
        return out.open("w", encoding="utf-8")
    except OSError as error:
        raise RequestError(
            f"cannot write {out}: {error.strerror or error}. Give --out a file that can be written."
        ) from error


def _write(line: dict[str, Any], stream: TextIO) -> None:
    """One line of strict JSON; numbers that are none become null."""
    stream.write(f"{json.dumps({**line, VERSION_KEY: __version__}, allow_nan=False)}\n")
    stream.flush()
