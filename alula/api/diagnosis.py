"""A vehicle's model beside its flights: where it errs, which effect it lacks, the vehicle with that effect."""

from __future__ import annotations

import datetime
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from alula.api.inputs import dataset_of, log_paths, vehicle_of
from alula.api.results import AdditionResult, ComparisonResult, DiagnosisResult, FlightAdditionResult, ProofResult
from alula.workbench import workbench
from dynamics.command import command_line
from dynamics.errors import DataError, RequestError
from dynamics.progress import Progress, no_progress, part_of
from dynamics.recorded_vehicle import system_chosen

if TYPE_CHECKING:
    from diagnosis.data.dataset import Dataset
    from diagnosis.hover_trim import TrimComparison
    from dynamics.vehicle import Vehicle
    from flights import Flight

READING = 0.3  # share of the time of a diagnosis


def compare(
    flights: Flight | str | Path | Sequence[Flight | str | Path],
    vehicle: Vehicle | str | Path,
    *,
    trial: str | None = None,
    effect_files: Sequence[str | Path] = (),
    mapping: str | Path | None = None,
    pose: str | None = None,
    system: int | None = None,
    progress: Progress = no_progress,
) -> ComparisonResult:
    """Compare a vehicle's model with flights: error of each channel over its noise floor, and where it is largest.

    flights: what `read_flights` returned, or logs, or a folder of logs; of one vehicle.
    vehicle: what `load_vehicle` returned, a vehicle file, or the name of a bundled one.
    trial: an effect with values, such as "rotor_drag:coefficient=2e-5", which the vehicle has for this comparison.
    effect_files: Python files with effects of your own that the vehicle names.
    mapping: column mapping (TOML) for CSV files of another tool.
    pose: where the pose comes from, "mocap" or "estimator"; by default as the logs tell.
    system: system id of the vehicle to read where a tlog holds several; by default the first autopilot.
    progress: called with the share that is done, 0 to 1, and what is done now.

    Returns a ComparisonResult.
    Raises RequestError for logs or a vehicle that cannot be used, DataError for flights that cannot answer.

    Example:
        result = alula.compare("logs", "arpl_250g")
        for axis in result.report.axes:
            print(axis.kind, axis.axis, axis.rms / axis.floor)
        result.write_html("comparison.html")
    """
    with workbench("alula.compare"):
        from diagnosis.comparison import compare_dataset
    from dynamics.own_effects import catalogue_of
    from dynamics.vehicle_file import parse_effect

    loaded = vehicle_of(vehicle, effect_files)
    catalogue = catalogue_of(loaded)
    if trial is not None:
        loaded = loaded.with_effect_replaced(parse_effect(trial, loaded.rotors.count, catalogue=catalogue))
    dataset = dataset_of(flights, loaded, None, mapping, pose, part_of(progress, 0.0, 0.5), system)
    progress(0.5, "errors and where they are largest")
    details = compare_dataset(dataset, loaded, catalogue)
    return ComparisonResult(details.comparison, loaded, dataset, details)


def diagnose(
    flights: Flight | str | Path | Sequence[Flight | str | Path],
    vehicle: Vehicle | str | Path,
    *,
    hold_out: str | None = None,
    effect_files: Sequence[str | Path] = (),
    mapping: str | Path | None = None,
    pose: str | None = None,
    system: int | None = None,
    progress: Progress = no_progress,
) -> DiagnosisResult:
    """Name the physical effect that is missing from a vehicle's model, or that the model explains the flights.

    flights: as for `compare`; four flights or more are best.
    vehicle: as for `compare`.
    hold_out: pattern of the file names to evaluate on, such as "hold_*"; by default the last fifth of the flights,
        or blocks of all where these do not fly as the others do.
    effect_files: Python files with effects of your own, considered beside the catalogue's.
    mapping: column mapping (TOML) for CSV files of another tool.
    pose, system, progress: as for `compare`.

    Returns a DiagnosisResult: `report.verdict` is "explained", "effect", "ambiguous" or "unknown".
    Raises RequestError for logs, a vehicle or a pattern that cannot be used, DataError for flights that cannot answer.

    Example:
        result = alula.diagnose("logs", "arpl_250g")
        print(result.sentence)
        print(result.report.next_flight)
    """
    with workbench("alula.diagnose"):
        from diagnosis.diagnose import diagnose_dataset
        from diagnosis.in_flight import with_in_flight
    from dynamics.own_effects import catalogue_of

    loaded = vehicle_of(vehicle, effect_files)
    catalogue = catalogue_of(loaded)
    dataset = dataset_of(flights, loaded, hold_out, mapping, pose, part_of(progress, 0.0, READING), system)
    details = diagnose_dataset(dataset, loaded, catalogue, progress=part_of(progress, READING, 1.0))
    details = with_in_flight(details, dataset, catalogue, loaded)
    return DiagnosisResult(details.diagnosis, loaded, dataset, details)


def compare_hover(
    logs: str | Path | Sequence[str | Path],
    normal: str | Path | Sequence[str | Path],
    vehicle: Vehicle | str | Path,
    *,
    mapping: str | Path | None = None,
    system: int | None = None,
) -> TrimComparison:
    """Whether a rotor works harder in hover than in normal flights of the same vehicle.

    Needs no more than motor commands and a way to see hover, and so answers where `diagnose` cannot.

    logs: the flights in question: paths, a folder or a pattern.
    normal: normal flights of the vehicle, likewise.
    vehicle: as for `compare`.
    mapping: column mapping (TOML) for CSV files of another tool.
    system: as for `compare`.

    Returns a TrimComparison: the verdict, and each rotor's share of the commands.
    Raises RequestError for logs that cannot be found, DataError for flights without hover.

    Example:
        result = alula.compare_hover("hover/suspect.csv", "hover/normal_*", "arpl_250g")
        print(result.verdict, [rotor.now for rotor in result.rotors])
    """
    with workbench("alula.compare_hover"):
        from diagnosis.hover_trim import read_trim
    loaded = vehicle_of(vehicle)
    with system_chosen(system):
        return read_trim(
            log_paths(logs, mapping), log_paths(normal, mapping), loaded, None if mapping is None else Path(mapping)
        )


def add_effect(
    flights: Flight | str | Path | Sequence[Flight | str | Path],
    vehicle: Vehicle | str | Path,
    effect: str | None = None,
    *,
    rotor: int | None = None,
    hold_out: str | None = None,
    effect_files: Sequence[str | Path] = (),
    mapping: str | Path | None = None,
    pose: str | None = None,
    system: int | None = None,
    progress: Progress = no_progress,
) -> AdditionResult:
    """Fit effects and add them to a vehicle, if held-out flights bear them out and no error rises there.

    flights, vehicle: as for `compare`.
    effect: name in the catalogue; by default all that the diagnosis names, fitted jointly.
    rotor: number of the rotor, from 0, for an effect of one; by default the one that fits best.
    hold_out, effect_files, mapping, pose, system, progress: as for `diagnose`.

    Returns an AdditionResult, whose vehicle has the effects; nothing is written yet.
    Raises RequestError for an unknown effect, DataError with the numbers where the flights do not bear it out.

    Example:
        result = alula.add_effect("logs", "heavy.toml", "mass")
        print(result.report.parameters)
        print(result.write_next_version("heavy.toml"))
    """
    if effect is None and rotor is not None:
        raise RequestError("a rotor without an effect. Name the effect, or leave the rotor to the diagnosis.")
    with workbench("alula.add_effect"):
        from diagnosis.addition import add_effect as add_to_vehicle
        from diagnosis.addition_report import report
    from dynamics.own_effects import catalogue_of
    from dynamics.vehicle import EffectUse
    from dynamics.vehicle_file import check_effect, find_vehicle

    loaded = vehicle_of(vehicle, effect_files)
    catalogue = catalogue_of(loaded)
    if effect is not None and effect in catalogue and rotor is not None:
        check_effect(EffectUse(effect, {}, rotor), loaded.rotors.count, catalogue=catalogue)
    dataset = dataset_of(flights, loaded, hold_out, mapping, pose, part_of(progress, 0.0, READING), system)
    today = datetime.datetime.now(tz=datetime.UTC).date().isoformat()
    details = add_to_vehicle(
        effect,
        dataset,
        loaded,
        catalogue,
        date=today,
        command=command_line(),
        rotor=rotor,
        progress=part_of(progress, READING, 1.0),
    )
    source = find_vehicle(vehicle) if isinstance(vehicle, str | Path) else None
    return AdditionResult(details.vehicle, report(details), details, source, catalogue)


def add_from_flight(
    recording: str | Path,
    vehicle: Vehicle | str | Path,
    effect: str | None = None,
    *,
    effect_files: Sequence[str | Path] = (),
    pose: str | None = None,
    progress: Progress = no_progress,
) -> FlightAdditionResult:
    """Add to a vehicle what its model followed in a recorded flight, if the errors of the flight do not rise with it.

    What is added has a 95 % interval, at the end of tracking, without the vehicle file's own value. The wind is that of
    the flight, and added where it is named alone.

    recording: of `alula fly --adapt shadow` or `on` with this vehicle, or a folder for its newest one.
    vehicle: as for `compare`.
    effect: the one to add; by default all.
    effect_files, pose, progress: as for `diagnose`.

    Returns a FlightAdditionResult, whose vehicle has the values; nothing is written yet.
    Raises RequestError for a recording of another vehicle or an effect that it did not follow, DataError where it
    followed nothing, nothing changes, or an error rises.

    Example:
        result = alula.add_from_flight("recordings", "my_quad.toml")
        print(result.report.parameters)
        print(result.write_next_version("my_quad.toml"))
    """
    with workbench("alula.add_from_flight"):
        from diagnosis.flight_addition import add_followed, flight_report, require_own_flight
    from dynamics.own_effects import catalogue_of
    from dynamics.vehicle_file import find_vehicle
    from flights.followed import require_followed
    from runtime.record.recording import newest_recording

    path = newest_recording(Path(recording))
    loaded = vehicle_of(vehicle, effect_files)
    catalogue = catalogue_of(loaded)
    followed = require_followed(path)
    require_own_flight(followed, loaded, catalogue)
    dataset = _dataset_or_none(path, loaded, pose, part_of(progress, 0.0, 2 * READING))
    progress(2 * READING, "errors before and after")
    today = datetime.datetime.now(tz=datetime.UTC).date().isoformat()
    details = add_followed(followed, loaded, catalogue, dataset, effect=effect, date=today, command=command_line())
    source = find_vehicle(vehicle) if isinstance(vehicle, str | Path) else None
    return FlightAdditionResult(details.vehicle, flight_report(details, followed), details, followed, source, catalogue)


def _dataset_or_none(path: Path, vehicle: Vehicle, pose: str | None, progress: Progress) -> Dataset | None:
    """The data set of one recording; None where it holds too little to compare errors."""
    try:
        return dataset_of([path], vehicle, None, None, pose, progress)
    except DataError:
        return None


def prove(
    flights: Flight | str | Path | Sequence[Flight | str | Path],
    vehicle: Vehicle | str | Path,
    before: Vehicle | str | Path,
    *,
    fly: str | None = None,
    hold_out: str | None = None,
    effect_files: Sequence[str | Path] = (),
    mapping: str | Path | None = None,
    pose: str | None = None,
    system: int | None = None,
    progress: Progress = no_progress,
) -> ProofResult:
    """Compare two versions of a vehicle on held-out flights, and what the controller gains by the second.

    flights, vehicle: as for `compare`.
    before: the version to compare with, likewise.
    fly: a reference, such as "Lemniscate", to fly in simulation on a vehicle with the effects of `vehicle`, with either
        version in the controller.
    hold_out, effect_files, mapping, pose, system, progress: as for `diagnose`.

    Returns a ProofResult.
    Raises RequestError for logs, a vehicle or a reference that cannot be used, DataError for flights that cannot
    answer.

    Example:
        result = alula.prove("logs", "my_quad.v2.toml", "my_quad.toml")
        for kind, error in result.report.channels.items():
            print(kind, error.before, error.after, error.floor)
    """
    with workbench("alula.prove"):
        from diagnosis.proof import prove_versions
        from simulation.versions_in_flight import fly_versions
    from dynamics.own_effects import catalogue_of

    present, first = vehicle_of(vehicle, effect_files), vehicle_of(before, effect_files)
    catalogue = catalogue_of(present)
    dataset = dataset_of(flights, present, hold_out, mapping, pose, part_of(progress, 0.0, READING), system)
    end = 1.0 if fly is None else 0.5
    report = prove_versions(dataset, first, present, catalogue, part_of(progress, READING, end))
    if fly is None:
        return ProofResult(report, None)
    flown = fly_versions(first, present, fly, catalogue, progress=part_of(progress, end, 1.0))
    return ProofResult(report, flown)
