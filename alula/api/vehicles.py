"""Vehicle files: made of a vehicle's parts or of its logs, and compared with logs."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from alula.api.inputs import log_paths, vehicle_of
from alula.workbench import workbench
from dynamics.command import command_line
from dynamics.recorded_vehicle import system_chosen

if TYPE_CHECKING:
    from diagnosis.vehicle_check import VehicleCheck
    from diagnosis.vehicle_from_logs import LogVehicle
    from dynamics.vehicle import Vehicle
    from dynamics.vehicle_draft import Draft


def new_vehicle(
    name: str,
    *,
    mass: float,
    arm: float,
    propeller: float,
    kv: float,
    cells: int,
    frame: str = "quad_x",
    blades: int = 2,
) -> Draft:
    """A vehicle by rules of thumb, from what is written on its parts, each number with its source and interval.

    mass: kg, ready to fly.
    arm: from the centre to a motor's axis, m.
    propeller: diameter, m.
    kv: of the motors, rpm/V.
    cells: of the battery, in series.
    frame: "quad_x", "quad_plus", "quad_h", "hexa_x", "hexa_plus", "octa_x", "octa_plus" or "octaquad_x".
    blades: of a propeller.

    Returns a Draft: `vehicle` is the vehicle, `toml` its file's text, `open` what only flights tell.
    Raises RequestError for numbers that make no vehicle.

    Example:
        draft = alula.new_vehicle("mine", mass=1.5, arm=0.225, propeller=0.254, kv=920, cells=4)
        print(draft.vehicle.hover_speed, draft.entry("body.inertia").interval)
    """
    from dynamics.vehicle_sizing import size_vehicle

    return size_vehicle(
        name=name,
        mass=mass,
        arm=arm,
        propeller=propeller,
        kv=kv,
        cells=cells,
        frame=frame,
        blades=blades,
        command=command_line(),
    )


def vehicle_from_logs(
    logs: str | Path | Sequence[str | Path],
    name: str = "vehicle",
    *,
    mass: float | None = None,
    arm: float | None = None,
    propeller: float | None = None,
    speed_max: float | None = None,
    frame: str | None = None,
    autopilot: str | None = None,
    mapping: str | Path | None = None,
    system: int | None = None,
) -> LogVehicle:
    """A vehicle from its logs: layout by the autopilot's parameters, constants estimated from the flights.

    logs: paths, a folder or a pattern; of one vehicle.
    name: of the vehicle.
    mass: kg, as flown; None leaves it open, and everything that scales with it is of 1 kg.
    arm: from the centre to the outermost motor's axis, m; by default as the parameters state it.
    propeller: diameter, m.
    speed_max: of a rotor at full signal, rad/s, for logs without rotor speeds.
    frame: as of `new_vehicle`, for logs whose parameters state no layout of rotors; needs `arm`.
    autopilot: "px4", "ardupilot", "crazyflie" or "betaflight", whose motor numbers the file has; by default the logs'.
    mapping: column mapping (TOML) for CSV files of another tool.
    system: as of `read_flight`.

    Returns a LogVehicle: `draft` as of `new_vehicle`, `identified` the estimates with their intervals.
    Raises RequestError for logs that cannot be used, DataError for logs without a layout.

    Example:
        made = alula.vehicle_from_logs("logs", "mine", mass=1.5, arm=0.225)
        print(made.draft.toml, *made.draft.open, sep="\\n")
    """
    with workbench("alula.vehicle_from_logs"):
        from diagnosis.vehicle_from_logs import vehicle_from_logs as from_logs
    with system_chosen(system):
        return from_logs(
            log_paths(logs, mapping),
            name=name,
            mass=mass,
            arm=arm,
            propeller=propeller,
            speed_max=speed_max,
            frame=frame,
            autopilot=autopilot,
            mapping=mapping,
            command=command_line(),
        )


def check_vehicle(
    logs: str | Path | Sequence[str | Path],
    vehicle: Vehicle | str | Path,
    *,
    effect_files: Sequence[str | Path] = (),
    mapping: str | Path | None = None,
    system: int | None = None,
) -> VehicleCheck:
    """Compare a vehicle file with logs of the vehicle: which number disagrees, and by how much.

    logs: paths, a folder or a pattern; of one vehicle.
    vehicle: what `load_vehicle` returned, a vehicle file, or the name of a bundled one.
    effect_files: Python files with effects of your own that the vehicle names.
    mapping: column mapping (TOML) for CSV files of another tool.
    system: as of `read_flight`.

    Returns a VehicleCheck: `agrees`, and `numbers`, each with an `answer` and a `text`.
    Raises RequestError for logs or a vehicle that cannot be used.

    Example:
        check = alula.check_vehicle("logs", "mine.toml")
        print(*(number.text for number in check.numbers if number.answer == "disagrees"), sep="\\n")
    """
    with workbench("alula.check_vehicle"):
        from diagnosis.vehicle_check import check_vehicle as check
    from dynamics.own_effects import catalogue_of

    loaded = vehicle_of(vehicle, effect_files)
    with system_chosen(system):
        return check(log_paths(logs, mapping), loaded, catalogue_of(loaded), mapping=mapping)
