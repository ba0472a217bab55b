"""The whole loop on a simulated vehicle with a hidden effect.

Fly the nominal model, diagnose these flights, add the effects, fly the same with them in the controller's model.
"""

from __future__ import annotations

from collections.abc import Callable
from importlib import util
from typing import TYPE_CHECKING

import msgspec

from dynamics.errors import RequestError
from dynamics.own_effects import catalogue_of
from dynamics.references import named_reference
from dynamics.vehicle_file import find_vehicle, parse_effect, read_vehicle
from dynamics.workbench_install import workbench_install
from studies.demo.flights import LEARNED, NOMINAL, Announce, DemoOptions, clear_old_files, pilot, rmse_on_px4_estimate
from studies.demo.result import DemoReport, FlownManoeuvre

if TYPE_CHECKING:
    from studies.demo.learning import Learning

Started = Callable[[str], None]
NEEDED = ("scipy", "pyarrow")  # for diagnosis, which a flight computer's install leaves out


def check_options(options: DemoOptions) -> None:
    """Refuse what cannot be flown or written before anything takes off; makes the folder. Raises RequestError."""
    vehicle = read_vehicle(find_vehicle(options.vehicle))
    for text in options.effects:
        parse_effect(text, vehicle.rotors.count, catalogue=catalogue_of(vehicle))
    for name in options.manoeuvres:
        named_reference(name, vehicle)
    if not options.manoeuvres:
        raise RequestError("no manoeuvre was given; name at least one, such as Lemniscate.")
    if options.lockstep and (absent := absent_libraries()):
        raise RequestError(
            f"flights in lockstep need {' and '.join(absent)}: {workbench_install()}, or fly over the link."
        )
    probe = options.folder / ".part-probe"
    try:
        options.folder.mkdir(parents=True, exist_ok=True)
        probe.touch()
        probe.unlink()
    except OSError as error:
        raise RequestError(
            f"cannot write to {options.folder}: {error.strerror}. Give a folder that can be written with --out."
        ) from None


def absent_libraries() -> tuple[str, ...]:
    """Libraries that the second half needs and this install lacks."""
    return tuple(name for name in NEEDED if util.find_spec(name) is None)


def run_demo(
    options: DemoOptions, announce: Announce, started: Started, *, command: str = ""
) -> tuple[DemoReport, Learning | None]:
    """Fly, diagnose, add, fly again; the first half alone without the workbench's libraries or `learn`.

    started: called with the name of each part as it begins.
    command: for the vehicle file's history.

    Raises RequestError for options that make no sense, VehicleError when a flight does not end as it should, DataError
    when the flights cannot be diagnosed.
    """
    check_options(options)
    clear_old_files(options)
    nominal = _fly_all(options, str(find_vehicle(options.vehicle)), NOMINAL, announce, started)
    absent = absent_libraries() if options.learn else ()
    report = DemoReport(
        options.vehicle, options.effects, options.seed, nominal, lockstep=options.lockstep, missing=absent
    )
    if absent or not options.learn:
        return report, None
    from studies.demo.learning import learn  # brings SciPy

    started("diagnosis")
    learning = learn(options, [flown.recording for flown in nominal], command=command)
    learned = learning.learned
    if learned.vehicle_file:
        again = _fly_all(options, learned.vehicle_file, LEARNED, announce, started)
        learned = msgspec.structs.replace(learned, flown=again)
    return msgspec.structs.replace(report, learned=learned), learning


def _fly_all(
    options: DemoOptions, vehicle: str, model: str, announce: Announce, started: Started
) -> tuple[FlownManoeuvre, ...]:
    """Every manoeuvre with one model on a vehicle with a full battery."""
    flown = []
    with pilot(options, announce) as fly:
        for name in options.manoeuvres:
            started(f"{name}, {model}")
            flight = fly(name, vehicle, model)
            flown.append(msgspec.structs.replace(flight, px4_rmse=rmse_on_px4_estimate(name, vehicle, options)))
    return tuple(flown)
