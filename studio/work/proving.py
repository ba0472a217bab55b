"""Steps "prove" and "fly": the present version against the first one, on held-out flights and on the mock."""

from __future__ import annotations

from pathlib import Path

import msgspec
import numpy as np

from diagnosis.addition import horizons_of
from diagnosis.estimation.evaluation import sensors_floor
from diagnosis.estimation.held_out import HeldOut
from diagnosis.selection.regression_of_flights import make_regression
from diagnosis.verdict import channel_errors
from dynamics.controller_settings import CONTROL_PERIOD
from dynamics.files import write_json
from dynamics.progress import Progress
from dynamics.references import check_feasibility, named_reference
from dynamics.vehicle import Vehicle
from flights.log import Log
from runtime.control.controller import Controller, ControllerOptions
from runtime.flight_setup import hovering_vehicle
from simulation.lockstep import fly_reference
from studio.work.memory import CaseMemory
from studio.work.results import FILES, Flown, FlownPath, Proved
from studio.work.task import Task

MAX_POINTS = 600  # of a path
FLIGHT_SECONDS = 12.0


def prove(memory: CaseMemory, task: Task, folder: Path, progress: Progress) -> None:
    """Errors of both versions on flights that nothing was fitted to, one step and in open loop."""
    dataset = memory.dataset(task, lambda share, stage: progress(0.2 * share, stage))
    first, present = memory.first_vehicle(task), memory.vehicle(task)
    progress(0.3, "noise of the flights")
    catalogue = memory.catalogue(task)
    regression = make_regression(first, catalogue, dataset.fitted, dataset.flight_of)
    judge = HeldOut(regression, dataset.held_out)
    progress(0.7, "predictions of both versions")
    floor = judge.floor(present)
    sensors = sensors_floor(regression, present, dataset.held_out, floor)
    proved = Proved(
        channels=dict(channel_errors(judge.rows(first), judge.rows(present), floor, sensors)),
        open_loop_before=horizons_of(judge, first),
        open_loop_after=horizons_of(judge, present),
        effects=_effects(present),
    )
    write_json(proved, folder / FILES[Proved])


def fly(memory: CaseMemory, task: Task, folder: Path, progress: Progress) -> None:
    """Fly a manoeuvre on the mock, whose vehicle has the present version's effects, with both models in the controller.

    It shows what the controller gains if the effects are real; the mock is no witness that they are.
    """
    first, present = memory.first_vehicle(task), memory.vehicle(task)
    catalogue = memory.catalogue(task)
    body = msgspec.structs.replace(present, effects=())
    trim = hovering_vehicle(present)
    reference = named_reference(task.reference, trim, duration=task.numbers.get("duration", FLIGHT_SECONDS))
    check_feasibility(reference, trim).require()
    flights, setpoint = [], np.zeros((0, 3))
    for number, (name, model) in enumerate((("the first version", first), ("the present version", present))):
        progress(number / 2, f"flight with {name} in the controller")
        choice = ControllerOptions.for_vehicle(model, period=CONTROL_PERIOD, catalogue=catalogue)
        controller = Controller.build(model, choice, catalogue)
        flown = fly_reference(body, reference, effects=present.effects, controller=controller, catalogue=catalogue)
        setpoint = _thinned(flown.log, "position_setpoint")
        flights.append(FlownPath(flown.position_rmse, flown.aborted, _thinned(flown.truth, "position").tolist()))
    result = Flown(task.reference, flights[0], flights[1], setpoint.tolist(), _effects(present))
    write_json(result, folder / FILES[Flown])


def _thinned(log: Log, name: str) -> np.ndarray:
    """(n, 3) of a stream, thin enough for a picture."""
    stream = log.stream(name)
    if stream is None:
        return np.zeros((0, 3))
    step = max(1, len(stream.values) // MAX_POINTS)
    return np.asarray(stream.values[::step, :3])


def _effects(vehicle: Vehicle) -> tuple[str, ...]:
    return tuple(use.name if use.rotor is None else f"{use.name}[{use.rotor}]" for use in vehicle.effects)
