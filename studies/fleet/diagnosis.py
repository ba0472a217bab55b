"""The diagnosis of one log of a fleet, as a worker does it."""

from __future__ import annotations

import math
import os
import socket
import threading
import time
from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path

import msgspec

from diagnosis.data.dataset import align_logs, make_dataset
from diagnosis.diagnose import diagnose_dataset
from diagnosis.report import ChannelError, Diagnosis, MissingEffect, ParameterValue, sentence
from dynamics.effect import Effect
from dynamics.errors import AlulaError
from dynamics.own_effects import catalogue_of
from dynamics.vehicle import Vehicle
from dynamics.vehicle_file import parse_vehicle
from flights import Log, read_log
from flights.quality.inspection import judge
from flights.readers.ulog import AIRFRAME
from flights.source import sha256
from studies.fleet.date import log_date
from studies.fleet.flight import FleetChannel, FleetEffect, FleetFlight, FleetParameter

DEVIATIONS = 1.96  # of a normal distribution, to either end of a 95 % interval
# casadi's and numpy's work of one log fills a core, and a Dask worker may have several threads
_ONE_AT_A_TIME = threading.Lock()


class FleetTask(msgspec.Struct, frozen=True):
    """A log with everything that a worker needs for it.

    path: on a disk that every worker shares.
    empty: the flight's line without results.
    vehicle_text: the vehicle file.
    mapping: column mapping of foreign CSV files.
    pose: where the pose comes from.
    """

    path: Path
    empty: FleetFlight
    vehicle_text: str
    mapping: Path | None = None
    pose: str | None = None


def diagnose_log(task: FleetTask) -> FleetFlight:
    """The line of a log; it raises nothing, so that the others continue."""
    with _ONE_AT_A_TIME:
        began = time.perf_counter()
        flight = _diagnosed(task)
        taken = round(time.perf_counter() - began, 2)
    return msgspec.structs.replace(flight, seconds=taken, worker=f"{socket.gethostname()} {os.getpid()}")


def killed_log(task: FleetTask) -> FleetFlight:
    """The line of a log whose worker was killed twice."""
    return msgspec.structs.replace(
        task.empty,
        status="failed",
        error="its worker process died twice, killed or out of memory. Give fewer --workers, or cut the log; the "
        "next run tries it again.",
    )


def _diagnosed(task: FleetTask) -> FleetFlight:
    flight = _dated(task.empty, None, task.path)
    try:
        log = read_log(task.path, mapping=task.mapping, pose=task.pose)
        flight = _dated(flight, log, task.path)
        vehicle, catalogue = _vehicle(task.vehicle_text)
        inspection = judge(log, catalogue)
        flight = msgspec.structs.replace(
            flight,
            duration=inspection.duration,
            free_flight=inspection.free_flight,
            inspection=inspection.verdict,
            inspected=inspection.sentence,
        )
        details = diagnose_dataset(make_dataset(align_logs([log]), vehicle), vehicle, catalogue)
    except AlulaError as error:
        status = "failed" if isinstance(error.__cause__, OSError) else "refused"
        reason = str(error).replace(str(task.path), flight.log)
        return msgspec.structs.replace(_hashed(flight, task.path), status=status, error=reason)
    except Exception as error:  # of any kind: the other logs continue
        failure = f"{type(error).__name__}: {error}. This is a defect of Alula; the next run tries the log again."
        return msgspec.structs.replace(_hashed(flight, task.path), status="failed", error=failure)
    return _with_diagnosis(flight, details.diagnosis)


@lru_cache(maxsize=64)
def _vehicle(text: str) -> tuple[Vehicle, Mapping[str, Effect]]:
    """A vehicle with its catalogue, parsed once for all of its logs."""
    vehicle = parse_vehicle(text)
    return vehicle, catalogue_of(vehicle)


def _dated(flight: FleetFlight, log: Log | None, path: Path) -> FleetFlight:
    date, source = log_date(log, flight.log, path)
    flight = msgspec.structs.replace(flight, date=date, date_from=source)
    if log is None:
        return flight
    duration = round(log.duration, 3)
    airframe = log.metadata.get(AIRFRAME, "")
    return msgspec.structs.replace(flight, sha256=log.provenance.sha256, duration=duration, airframe=airframe)


def _hashed(flight: FleetFlight, path: Path) -> FleetFlight:
    """The line with the log's hash, where it could not be read but opened."""
    if flight.sha256:
        return flight
    try:
        return msgspec.structs.replace(flight, sha256=sha256(path))
    except OSError:
        return flight


def _with_diagnosis(flight: FleetFlight, diagnosis: Diagnosis) -> FleetFlight:
    return msgspec.structs.replace(
        flight,
        status="diagnosed",
        verdict=diagnosis.verdict,
        sentence=sentence(diagnosis),
        effects=tuple(map(_effect, diagnosis.effects)),
        channels={kind: _channel(error) for kind, error in diagnosis.channels.items()},
        next_flight=diagnosis.next_flight,
    )


def _effect(effect: MissingEffect) -> FleetEffect:
    values = {name: _parameter(value) for name, value in effect.parameters.items()}
    return FleetEffect(effect.name, effect.rotor, values, effect.confidence, effect.ambiguous_with)


def _parameter(value: ParameterValue) -> FleetParameter:
    reach = DEVIATIONS * value.std
    return FleetParameter(value.value, value.std, value.value - reach, value.value + reach, value.unit)


def _channel(error: ChannelError) -> FleetChannel:
    ratio = error.before / error.floor if error.floor > 0 else math.inf
    return FleetChannel(
        error.before, error.after, error.floor, round(ratio, 4) if math.isfinite(ratio) else None, error.unit
    )
