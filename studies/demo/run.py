"""The whole loop on a simulated vehicle with a hidden effect.

Fly the nominal model, diagnose these flights, add the effects, fly the same with them in the controller's model.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from importlib import util
from typing import TYPE_CHECKING

import msgspec

from dynamics.errors import RequestError, VehicleError
from dynamics.own_effects import catalogue_of
from dynamics.references import named_reference
from dynamics.vehicle_file import find_vehicle, parse_effect, read_vehicle
from runtime.realtime import LIBRARY_THREADS
from studies.demo.flights import (
    LEARNED,
    NOMINAL,
    Announce,
    DemoOptions,
    FlightTask,
    TaskOutcome,
    clear_old_files,
    first_error,
    fly_over_link,
    fly_task,
    tasks_of,
)
from studies.demo.result import DemoReport, FlownManoeuvre

if TYPE_CHECKING:
    from studies.demo.learning import Learning

Started = Callable[[str, float], None]
DIAGNOSIS_SHARE = 0.3  # of the computing of the whole demo
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

    started: called with the name of each part as it begins, and the share of all work that is done before it.
    command: for the vehicle file's history.

    Raises RequestError for options that make no sense, VehicleError when a flight does not end as it should, DataError
    when the flights cannot be diagnosed.
    """
    check_options(options)
    clear_old_files(options)
    learning_absent = absent_libraries() if options.learn else ()
    learns = options.learn and not learning_absent
    half = (1.0 - DIAGNOSIS_SHARE) / 2 if learns else 1.0
    stamp = time.strftime("%Y%m%d-%H%M%S")
    first = partial(_fly_all, options, str(find_vehicle(options.vehicle)), NOMINAL, stamp, announce)
    nominal = first(lambda name, share: started(name, half * share))
    report = DemoReport(
        options.vehicle,
        options.effects,
        options.seed,
        nominal,
        lockstep=not options.realtime,
        missing=learning_absent,
    )
    if not learns:
        return report, None
    from studies.demo.learning import learn  # brings SciPy

    started("diagnosis", half)
    learning = learn(options, [flown.recording for flown in nominal], command=command)
    learned = learning.learned
    if learned.vehicle_file:
        second = partial(_fly_all, options, learned.vehicle_file, LEARNED, stamp, announce)
        again = second(lambda name, share: started(name, 1.0 - half + half * share))
        learned = msgspec.structs.replace(learned, flown=again)
    return msgspec.structs.replace(report, learned=learned), learning


def _fly_all(
    options: DemoOptions, vehicle: str, model: str, stamp: str, announce: Announce, started: Started
) -> tuple[FlownManoeuvre, ...]:
    """Every manoeuvre with one model on a vehicle with a full battery, and the same on PX4's estimate."""
    tasks = tasks_of(options, vehicle, model, stamp)
    names = options.manoeuvres
    over_link: list[FlownManoeuvre] = []
    done = 0.8 if options.realtime else 0.0  # share of the work before the flights in simulated time
    if options.realtime:
        in_real_time = partial(fly_over_link, options, vehicle, model, stamp, announce)
        over_link = in_real_time(lambda name, share: started(name, done * share))
    outcomes: dict[int, TaskOutcome] = {}
    started(f"{len(tasks)} flights, {model}", done)
    with _one_thread_a_process():
        for index, outcome in _outcomes(tasks, options.jobs):
            outcomes[index] = outcome
            started(tasks[index].title, done + (1.0 - done) * len(outcomes) / len(tasks))
    in_order = [outcomes[index] for index in range(len(tasks))]
    for line in (line for outcome in in_order for line in outcome.lines):
        announce(line)
    if error := first_error(in_order):
        raise VehicleError(error)
    flown = over_link or [outcome.flown for outcome in in_order if outcome.flown is not None]
    rmse = [outcome.px4_rmse for outcome in in_order[-len(names) :]]
    return tuple(msgspec.structs.replace(one, px4_rmse=px4) for one, px4 in zip(flown, rmse, strict=True))


def _outcomes(tasks: Sequence[FlightTask], jobs: int) -> Iterator[tuple[int, TaskOutcome]]:
    """Place and outcome of each task, as they are finished."""
    if absent_libraries():  # which the parallel map's room needs
        return enumerate(map(fly_task, tasks))
    from flights.parallel import parallel_map

    return parallel_map(fly_task, tasks, jobs=min(jobs, len(os.sched_getaffinity(0))))


@contextmanager
def _one_thread_a_process() -> Iterator[None]:
    """One thread a library in the processes that are started: with their pools two on two processors take five times as
    long (Makefile)."""
    added = [name for name in LIBRARY_THREADS if name not in os.environ]
    os.environ.update(dict.fromkeys(added, "1"))
    try:
        yield
    finally:
        for name in added:
            del os.environ[name]
