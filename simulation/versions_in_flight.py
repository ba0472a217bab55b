"""Two versions of a vehicle in the controller, on a vehicle that has the effects of the second, in lockstep."""

from __future__ import annotations

from collections.abc import Mapping

import msgspec
import numpy as np

from dynamics.controller_settings import CONTROL_PERIOD
from dynamics.effect import Effect
from dynamics.progress import Progress, no_progress
from dynamics.rate_loop import autopilot_gains
from dynamics.references import check_feasibility, named_reference
from dynamics.vehicle import Vehicle
from flights.log import Log
from runtime.control.controller import Controller, ControllerOptions
from runtime.flight_setup import hovering_vehicle
from simulation.lockstep import fly_reference

SECONDS = 12.0
MAX_POINTS = 600  # of a path


class FlownPath(msgspec.Struct, frozen=True):
    """A flight. rmse: of the position, m; aborted: why it ended early; path: (n, 3), m, thinned for a picture."""

    rmse: float
    aborted: str
    path: list[list[float]]


class VersionsInFlight(msgspec.Struct, frozen=True):
    """A manoeuvre with the first version in the controller and with the present one.

    reference: its name.
    setpoint: (n, 3), m, thinned.
    effects: that the flown vehicle has, by their names.
    """

    reference: str
    before: FlownPath
    after: FlownPath
    setpoint: list[list[float]]
    effects: tuple[str, ...]


def fly_versions(
    first: Vehicle,
    present: Vehicle,
    reference: str,
    catalogue: Mapping[str, Effect],
    *,
    duration: float = SECONDS,
    progress: Progress = no_progress,
) -> VersionsInFlight:
    """Fly a manoeuvre on a vehicle with the present version's effects, with either model in the controller.

    It shows what the controller gains if the effects are real, and is no witness that they are. duration: s.
    Raises RequestError for an unknown reference, or one that the vehicle cannot fly.
    """
    body, trim = msgspec.structs.replace(present, effects=()), hovering_vehicle(present)
    path = named_reference(reference, trim, duration=duration)
    check_feasibility(path, trim).require()
    gains = autopilot_gains(body, present.effects, catalogue)  # that both fly with
    flights, setpoint = [], np.zeros((0, 3))
    for number, (name, model) in enumerate((("the first version", first), ("the present version", present))):
        progress(number / 2, f"flight with {name} in the controller")
        options = ControllerOptions.for_vehicle(model, period=CONTROL_PERIOD, gains=gains, catalogue=catalogue)
        controller = Controller.build(model, options, catalogue)
        flown = fly_reference(body, path, effects=present.effects, controller=controller, catalogue=catalogue)
        setpoint = _thinned(flown.log, "position_setpoint")
        flights.append(FlownPath(flown.position_rmse, flown.aborted, _thinned(flown.truth, "position").tolist()))
    labels = tuple(use.label for use in present.effects)
    return VersionsInFlight(reference, flights[0], flights[1], setpoint.tolist(), labels)


def _thinned(log: Log, name: str) -> np.ndarray:
    """(n, 3) of a stream, thin enough for a picture."""
    stream = log.stream(name)
    if stream is None:
        return np.zeros((0, 3))
    step = max(1, len(stream.values) // MAX_POINTS)
    return np.asarray(stream.values[::step, :3])
