"""Step "check": each log as one table for the page, at once, and then its inspection."""

from __future__ import annotations

import os
import shutil
from collections.abc import Sequence
from pathlib import Path

import msgspec
import numpy as np

from diagnosis.vehicle_from_logs import layout_of
from dynamics.errors import AlulaError
from dynamics.files import make_folder, write_json
from dynamics.progress import Progress
from flights import Flight, Log
from flights.hypotheses import Hypothesis, explain
from flights.quality import Inspection
from flights.quality.inspection import judge
from flights.quantities import QUANTITIES
from flights.reading import ContradictedLogError
from runtime.flight_setup import VEHICLE_TEXT
from runtime.record.recording import read_attachments
from studio.pages.flight_panels import ANGLES, ANGLES_SETPOINT, drawn_columns, quantities_of
from studio.pages.inspected import coverage_maps, delay_points
from studio.work.arrays import write_arrays
from studio.work.memory import CaseMemory
from studio.work.results import FILES, FLIGHTS, Checked, ColumnInfo, FlightInfo, HypothesisInfo, PictureInfo
from studio.work.rows import picture_info
from studio.work.task import Task

UNITS = {name: quantity.unit for name, quantity in QUANTITIES.items()} | {ANGLES: "rad", ANGLES_SETPOINT: "rad"}


def check(memory: CaseMemory, task: Task, folder: Path, progress: Progress) -> None:
    """Read and inspect the logs; tables appear in the folder of flights before the inspection begins."""
    logs = memory.logs(task, lambda share, stage: progress(0.4 * share, stage))
    infos, flights = _write_flights(task, logs)
    catalogue = memory.catalogue(task) if task.vehicle else None
    inspections: list[Inspection | None] = []
    for number, (log, flight) in enumerate(zip(logs, flights, strict=True)):
        progress(0.4 + 0.6 * number / len(logs), f"inspecting {infos[number].name}")
        if not isinstance(log, Log) or flight is None:
            inspections.append(None)
            continue
        inspection = judge(log, catalogue) if catalogue else judge(log)
        if inspection.verdict == "unusable":  # perhaps for its columns: what repairs them
            infos[number] = msgspec.structs.replace(infos[number], hypotheses=_hypotheses(explain(log.streams)))
        inspections.append(inspection)
    pictures = tuple(_pictures(one) for one in inspections)
    write_json(Checked(tuple(infos), tuple(inspections), pictures, _has_layout(flights)), folder / FILES[Checked])


def _pictures(inspection: Inspection | None) -> dict[str, PictureInfo]:
    """Delays and coverage of a log."""
    if inspection is None:
        return {}
    delays = delay_points(inspection)
    named = {} if delays is None else {"delays": picture_info(delays)}
    return named | {f"coverage_{n}": picture_info(one) for n, one in enumerate(coverage_maps(inspection))}


def _write_flights(task: Task, logs: list[Log | AlulaError]) -> tuple[list[FlightInfo], list[Flight | None]]:
    """Write each log's table, where it has one."""
    target = Path(task.flights)
    part = target.with_name(f"{target.name}.part{os.getpid()}")
    shutil.rmtree(part, ignore_errors=True)
    make_folder(part, advice="Make room on the disk.")
    infos: list[FlightInfo] = []
    flights: list[Flight | None] = []
    for number, (path, log) in enumerate(zip(task.logs, logs, strict=True)):
        try:
            if not isinstance(log, Log):
                raise log
            flight = Flight.from_log(log)
        except AlulaError as error:
            explained = error.hypotheses if isinstance(error, ContradictedLogError) else ()
            hypotheses = _hypotheses(explained)
            infos.append(FlightInfo(Path(path).name, path, refused=str(error), hypotheses=hypotheses))
            flights.append(None)
            continue
        drawn, kinds = drawn_columns(flight), quantities_of(flight)
        table = np.array(list(drawn.values()), dtype=np.float32)
        write_arrays(part, {f"time_{number}": flight.time, f"table_{number}": table})
        columns = tuple(ColumnInfo(name, kinds[name], UNITS[kinds[name]]) for name in drawn)
        name, flown = Path(path).name, _flown(path)
        infos.append(FlightInfo(name, path, flight.duration, flight.rate, columns, vehicle=flown, events=log.events))
        flights.append(flight)
    write_json(infos, part / FLIGHTS)
    shutil.rmtree(target, ignore_errors=True)
    part.rename(target)
    return infos, flights


def _hypotheses(hypotheses: Sequence[Hypothesis]) -> tuple[HypothesisInfo, ...]:
    """Hypotheses about a log's columns, as the page has them."""
    return tuple(HypothesisInfo(one.text, one.evidence, one.lines if one.repairs else "") for one in hypotheses)


def _flown(path: str) -> str:
    """The text of the vehicle file that a recording holds, empty where the log is none."""
    return read_attachments(Path(path)).get(VEHICLE_TEXT, "")


def _has_layout(flights: list[Flight | None]) -> bool:
    """Whether the logs' parameters state the rotors' layout."""
    readable = [flight for flight in flights if flight is not None]
    try:
        return bool(readable) and layout_of(readable) is not None
    except AlulaError:
        return False
