"""Many flights of many vehicles, each diagnosed by itself: a table, and what changes from flight to flight."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from alula.api.results import FleetResult
from alula.workbench import workbench
from dynamics.trust import approve_given


def diagnose_fleet(
    folder: str | Path,
    vehicle: str | Path | None = None,
    *,
    out: str | Path | None = None,
    effect_files: Sequence[str | Path] = (),
    mapping: str | Path | None = None,
    pose: str | None = None,
    workers: int | None = None,
    scheduler: str | None = None,
    progress: Callable[[int, int, str], None] | None = None,
) -> FleetResult:
    """Diagnose every log of a folder by itself, each once; a stopped run continues where it stood.

    Every flight is a line of JSON in `flights.jsonl`, written when it is done; at the end all are in
    `flights.parquet`. A log that cannot be used has a line with the reason, and the others continue.

    folder: of logs in any format, at any depth.
    vehicle: file or bundled name for all logs; by default the nearest `vehicle.toml`, or the only vehicle file of a
        folder, at or above each log inside of the folder.
    out: folder of the results; by default beside the folder, "logs.fleet" for "logs".
    effect_files, mapping, pose: as for `diagnose`.
    workers: processes; by default one for every core.
    scheduler: address of a Dask scheduler ("tcp://host:port") whose workers see the same folders.
    progress: called with the number of logs that are done, that of all, and the name of the last one.

    Returns a FleetResult. A script that calls this needs `if __name__ == "__main__":`, since processes are spawned.
    Raises RequestError for a folder, a vehicle or options that cannot be used and where results cannot be written,
    VehicleError when the cluster goes away; what was finished is kept.

    Example:
        result = alula.diagnose_fleet("logs", "arpl_250g")
        for drift in result.report.drifts:
            print(drift.vehicle, drift.quantity, drift.slope, drift.is_drift)
    """
    with workbench("alula.diagnose_fleet"):
        from studies.fleet.run import FleetOptions, default_out, run_fleet
        from studies.fleet.summary import summarise

    approve_given(effect_files)
    options = FleetOptions(
        folder=Path(folder),
        out=default_out(Path(folder)) if out is None else Path(out),
        vehicle=None if vehicle is None else str(vehicle),
        effect_files=tuple(Path(path).resolve() for path in effect_files),
        mapping=None if mapping is None else Path(mapping),
        pose=pose,
        workers=workers,
        scheduler=scheduler,
    )
    return FleetResult(summarise(str(folder), run_fleet(options, progress)), options.out)
