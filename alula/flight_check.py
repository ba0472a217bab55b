"""A few seconds of flight with a new bundle, in lockstep on its own vehicle file: does the network itself hold it?"""

from __future__ import annotations

from pathlib import Path

from alula.flight_verdict import FlightCheck, write_check
from alula.lockstep import fly_reference
from dynamics.errors import VehicleError
from dynamics.references import check_feasibility, named_reference
from dynamics.references.reference import Reference
from dynamics.vehicle import Vehicle
from runtime.bundle import Bundle, Manifest, read_bundle
from runtime.controller import Controller

GENTLE = ("Ellipse_1:laps=1", "hover:laps=1")  # 9 and 10 s; the first that the vehicle can fly


def check_bundle(folder: Path, manifest: Manifest) -> FlightCheck | None:
    """Fly a bundle that was just written and keep the verdict in it; None for physics, and for a model of the desk."""
    if not manifest.learned or manifest.filtered_inputs:
        return None
    check = check_flight(read_bundle(folder))
    write_check(check, folder)
    return check


def check_flight(bundle: Bundle) -> FlightCheck:
    """Fly a learned bundle, with the effects of its vehicle file and the noise of a vehicle's sensors."""
    controller, nominal = Controller.of_bundle(bundle), Controller.beside(bundle)
    reference = _gentle(controller.trim)
    try:
        flown = fly_reference(bundle.vehicle, reference, controller=controller, nominal=nominal)
    except VehicleError as error:
        return FlightCheck(reference.name, ended=str(error))
    seconds = flown.seconds
    return FlightCheck(
        reference.name, seconds, flown.position_rmse if seconds else None,
        flown.fallback_seconds / seconds if seconds else 1.0, dict(flown.events), flown.aborted,
    )  # fmt: skip


def _gentle(vehicle: Vehicle) -> Reference:
    references = [named_reference(name, vehicle) for name in GENTLE]
    return next((found for found in references if check_feasibility(found, vehicle).is_feasible), references[-1])
