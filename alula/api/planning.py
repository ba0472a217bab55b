"""Identification flights: planned for a vehicle, flown on the mock, ready for the vehicle."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from alula.api.results import IdentificationFlight
from alula.workbench import workbench

if TYPE_CHECKING:
    from diagnosis.experiment import PlannedFlight
    from dynamics.vehicle import Vehicle

PACES = (1.0, 0.9, 0.8, 0.7)  # tried in this order on the mock


def plan_flight(
    vehicle: Vehicle | str | Path,
    request: str = "identify",
    *,
    effect_files: Sequence[str | Path] = (),
    trial: bool = True,
    progress: Callable[[str, float], None] | None = None,
) -> IdentificationFlight:
    """Plan the manoeuvre that shows the most of a vehicle's effects, and fly it on the mock.

    vehicle: what `load_vehicle` returned, a vehicle file, or the name of a bundled one.
    request: "identify" or "identify:duration=40,box=4x4x2.5,speed=5,for=drag+inertia+lag,seed=1": at most 60 s; width,
        depth and height of the room about the place of take-off, m; limit of the speed, m/s; effects by name or by a
        part of it, all of the catalogue where left out.
    effect_files: Python files with effects of your own, planned for beside the catalogue's.
    trial: fly it on the mock, slower where that does not follow.
    progress: called with what is done, "planning" or "flying on the mock", and its share.

    Returns an IdentificationFlight: `plan.reference`, `plan.expected`, `trial`.
    Raises RequestError for a request that makes no sense or has no room, VehicleError where the mock cannot fly it.

    Example:
        flight = alula.plan_flight("arpl_250g", "identify:duration=20,box=4x4x3,for=drag", trial=False)
        print([(one.name, one.usual, one.std) for one in flight.plan.expected])
    """
    with workbench("alula.plan_flight"):
        from diagnosis.experiment import parse_request
        from diagnosis.experiment import plan_flight as plan
    from alula.api.inputs import vehicle_of
    from dynamics.own_effects import catalogue_of

    flying = vehicle_of(vehicle, effect_files)
    report = progress or (lambda _, __: None)
    planned = plan(flying, parse_request(request), catalogue_of(flying), lambda share: report("planning", share))
    if not trial:
        return IdentificationFlight(planned, 1.0, None)
    report("flying on the mock", 0.0)
    return _flown_on_mock(flying, planned)


def _flown_on_mock(vehicle: Vehicle, planned: PlannedFlight) -> IdentificationFlight:
    from dynamics.errors import VehicleError
    from simulation.trial_flight import fly_trial

    for pace in PACES:
        plan = planned if pace == 1.0 else planned.at_pace(pace)
        flown = fly_trial(vehicle, plan.reference)
        if flown.succeeded:
            return IdentificationFlight(plan, pace, flown)
    raise VehicleError(
        f"the mock of {vehicle.name} cannot fly {planned.request.text}, at {PACES[-1]:g} of its speed either: "
        f"{flown.text}. Give a lower speed, as in identify:speed=2, or lower limits in the vehicle file."
    )
