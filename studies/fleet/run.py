"""A fleet from its folder: which flights are done already, the work on the others, and the results."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from pathlib import Path

import msgspec

from dynamics.errors import RequestError
from dynamics.version import __version__
from flights.parallel import parallel_map
from flights.source import sha256
from runtime.realtime import limit_library_threads
from studies.fleet.diagnosis import FleetTask, diagnose_log, killed_log
from studies.fleet.flight import FleetFlight
from studies.fleet.logs import FleetLog, find_fleet
from studies.fleet.store import FleetStore

Progress = Callable[[int, int, str], None]


class FleetOptions(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Options of `alula diagnose --fleet`.

    folder: of the logs.
    out: folder of the results.
    vehicle: of all logs; None for vehicle files beside them.
    workers: processes, None for one a core.
    scheduler: address of a Dask scheduler.
    """

    folder: Path
    out: Path
    vehicle: str | None = None
    effect_files: tuple[Path, ...] = ()
    mapping: Path | None = None
    pose: str | None = None
    workers: int | None = None
    scheduler: str | None = None


def default_out(folder: Path) -> Path:
    """Where results lie by default: beside the folder, `logs.fleet` for `logs`."""
    named = folder if folder.name not in ("", "..") else folder.resolve()
    return named.with_name(f"{named.name}.fleet")


def run_fleet(options: FleetOptions, progress: Progress | None = None) -> tuple[FleetFlight, ...]:
    """Diagnose every log that is not done yet and give all flights of the folder, in the order of their names.

    progress: called with the number of flights that are done, that of all, and the last one's name.

    Raises RequestError for a folder, a vehicle or options that cannot be used and where results cannot be written,
    VehicleError when the cluster went away; what was finished is kept.
    """
    if options.workers is not None and options.workers < 1:
        raise RequestError(f"{options.workers} workers: wanted 1 or more.")
    logs = find_fleet(options.folder, options.vehicle, effect_files=options.effect_files, without=options.out)
    shared = _shared_settings(options)
    limit_library_threads()  # of the processes that are started from here
    with FleetStore(options.out).opened() as store:
        names = {log.name for log in logs}
        if store.flights and names.isdisjoint(store.flights):
            raise RequestError(
                f"{options.out} holds the results of another fleet: none of its logs is below {options.folder}. Give "
                "another --out."
            )
        store.write_about(options.folder, len(logs))
        tasks = [_task(log, options, shared) for log in logs]
        waiting = [task for task in tasks if not _is_done(store.flights.get(task.empty.log), task)]
        store.drop([task.empty.log for task in waiting if task.empty.log in store.flights])
        _work(waiting, len(tasks), store, options, progress)
        flights = tuple(store.flights[task.empty.log] for task in tasks)
        store.write_table(flights)
    return flights


def _work(
    waiting: Sequence[FleetTask], count: int, store: FleetStore, options: FleetOptions, progress: Progress | None
) -> None:
    """Diagnose logs and write the line of each as soon as it is done."""
    done = count - len(waiting)
    if progress is not None:
        progress(done, count, "")
    for task in (task for task in waiting if task.empty.error):
        store.append(task.empty)
    usable = [task for task in waiting if not task.empty.error]
    done += len(waiting) - len(usable)
    results = parallel_map(diagnose_log, usable, jobs=options.workers, scheduler=options.scheduler, killed=killed_log)
    for _, flight in results:
        store.append(flight)
        done += 1
        if progress is not None:
            progress(done, count, flight.log)


def _task(log: FleetLog, options: FleetOptions, shared: str) -> FleetTask:
    """The work on a log, with the line that it gets if nothing can be done."""
    digest = log.vehicle.digest if log.vehicle else ""
    empty = FleetFlight(
        log.name,
        "refused",
        settings=hashlib.sha256(f"{shared}\n{digest}\n{log.error}".encode()).hexdigest()[:16],
        vehicle=log.vehicle.name if log.vehicle else "",
        vehicle_file=log.vehicle.file if log.vehicle else "",
        error=log.error,
    )
    try:
        stamp = log.path.stat()
        empty = msgspec.structs.replace(empty, size=stamp.st_size, modified=stamp.st_mtime_ns)
    except OSError:
        pass  # the reader says why
    mapping = None if options.mapping is None else options.mapping.resolve()
    text = log.vehicle.text if log.vehicle else ""
    return FleetTask(log.path.resolve(), empty, text, mapping, options.pose)


def _is_done(flight: FleetFlight | None, task: FleetTask) -> bool:
    """Whether a line is that of the same log with the same settings; a copy of it with another date counts as such."""
    if flight is None or flight.status == "failed" or flight.settings != task.empty.settings:
        return False
    if (flight.size, flight.modified) == (task.empty.size, task.empty.modified) and not task.path.is_dir():
        return True
    try:
        return bool(flight.sha256) and flight.sha256 == sha256(task.path)
    except OSError:
        return False


def _shared_settings(options: FleetOptions) -> str:
    """Settings that decide all results besides log and vehicle. Raises RequestError for an unreadable mapping."""
    try:
        mapping = "" if options.mapping is None else options.mapping.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise RequestError(f"cannot read the mapping {options.mapping}: {error}. Give a TOML file.") from error
    return f"{__version__}\n{options.pose or ''}\n{mapping}"
