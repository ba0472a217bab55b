"""A planned manoeuvre flown on the mock before the vehicle flies it: in lockstep, from the ground to the ground."""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from dynamics.errors import VehicleError
from dynamics.references import Reference
from dynamics.vehicle import Vehicle
from dynamics.vehicle_file import write_vehicle
from runtime.flight.mission import Plan
from simulation.whole_flight import WholeFlight, fly_whole
from sitl_mock.mock import MockOptions

MAX_ERROR = 0.5  # m between the reference and the true position: beyond it a box is no limit
FURTHER = 90.0  # s that a flight may take beside its reference


@dataclass(frozen=True)
class TrialFlight:
    """A flight on the mock.

    position_rmse, position_max: of the true position while the reference was tracked, m.
    ended: why it was cut short, empty if it was not.
    """

    position_rmse: float
    position_max: float
    ended: str = ""

    @property
    def succeeded(self) -> bool:
        """Whether the reference was flown to its end, near it all the time."""
        return not self.ended and self.position_max <= MAX_ERROR

    @property
    def text(self) -> str:
        """One line for a terminal."""
        if self.ended:
            return f"ended early: {self.ended}"
        return f"{self.position_rmse:.3f} m RMS off, {self.position_max:.2f} m at most"


def fly_trial(vehicle: Vehicle, reference: Reference, *, seed: int = 0) -> TrialFlight:
    """Fly a reference on the mock of a vehicle, which hides nothing. Raises VehicleError when it does not take off."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "vehicle.toml"
        write_vehicle(vehicle, file)
        flight = fly_whole(
            MockOptions(file, seed=seed, estimator="mocap", ground="legs", clock="steady"),
            reference,
            plan=Plan(origin="takeoff"),
            limit=reference.duration + FURTHER,
        )
    return _result(flight)


def _result(flight: WholeFlight) -> TrialFlight:
    away = flight.distances(flight.truth)
    if not away.size:
        raise VehicleError(f"the mock of this vehicle did not reach the start of the manoeuvre: {flight.outcome}.")
    ended = flight.landing_reason or ("" if flight.landed else flight.outcome)
    return TrialFlight(flight.tracking_error(flight.truth), float(np.nanmax(away)), ended)
