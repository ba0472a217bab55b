"""Folders of logs as a command reads them: files that are none are skipped, a vehicle file beside the logs is used."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

from alula.api.inputs import names_of
from alula.cli.escaping import printable
from alula.workbench import workbench
from dynamics.errors import RequestError
from dynamics.vehicle_folder import vehicle_files_in


def vehicle_of_logs(logs: Sequence[Path], vehicle: str | None, mapping: Path | None = None) -> str:
    """The vehicle that was given, or the only vehicle file in the folders of logs; says what it uses and skips.

    Raises RequestError where there is none, or more than one.
    """
    vehicle = vehicle or vehicle_beside(logs)
    if vehicle is None:
        folders = [str(log) for log in logs if log.is_dir()]
        where = f", and no vehicle file lies in {', '.join(folders)}" if folders else ""
        raise RequestError(f"no --vehicle was given{where}. Give a vehicle file, or the name of a bundled one.")
    note_skipped(logs, mapping, vehicle)
    return vehicle


def vehicle_beside(logs: Sequence[Path]) -> str | None:
    """The only vehicle file in the folders of logs, said in a line; None where there is none.

    Raises RequestError where there are several.
    """
    files = {file.resolve(): file for log in logs if log.is_dir() for file in vehicle_files_in(log)}
    if len(files) > 1:
        names = ", ".join(map(str, files.values()))
        raise RequestError(f"{len(files)} vehicle files lie beside the logs: {names}. Give one as --vehicle.")
    for file in files.values():
        print(printable(f"vehicle file: {file}, beside the logs"), file=sys.stderr)
        return str(file)
    return None


def note_skipped(logs: Sequence[Path], mapping: Path | None = None, vehicle: str | None = None) -> None:
    """Print one line on the files of folders that are no logs. vehicle: a file among them that is used."""
    folders = [log for log in logs if log.is_dir()]
    if not folders:
        return
    with workbench("reading logs"):
        from flights.folder import folder_content
    others = [file for folder in folders for file in folder_content(folder, mapping).others]
    skipped = [file for file in others if vehicle is None or file.resolve() != Path(vehicle).resolve()]
    if skipped:
        what = "1 file that is no log" if len(skipped) == 1 else f"{len(skipped)} files that are no logs"
        print(printable(f"skipped {what}: {names_of(skipped)}"), file=sys.stderr)
