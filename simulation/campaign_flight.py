"""One flight of a campaign, flown and written by a worker process."""

from __future__ import annotations

import dataclasses
from functools import lru_cache
from pathlib import Path
from typing import Literal

import msgspec
import numpy as np

from dynamics.controller_settings import CONTROL_PERIOD
from dynamics.errors import RequestError, VehicleError
from dynamics.own_effects import catalogue_of
from dynamics.references import Reference, check_feasibility, named_reference
from dynamics.references.feasibility import slowed
from dynamics.units import RPM
from dynamics.vehicle import EffectUse, Vehicle
from dynamics.vehicle_file import parse_vehicle
from flights.flight import Flight
from runtime.control.controller import Controller
from simulation.lockstep import FlownReference, fly_reference
from sitl_mock.scenario import parse_scenario

SPEEDS = (1.0, 0.9, 0.8, 0.7, 0.6, 0.5)  # tried in this order when hidden effects are too strong for full speed


class FlightTask(msgspec.Struct, frozen=True):
    """Everything that one flight depends on, and the folder of its files."""

    name: str
    reference: str
    split: Literal["train", "test"]
    folder: Path
    vehicle_text: str
    scenario_text: str
    effects: tuple[EffectUse, ...]
    seed: int
    csv: bool

    @property
    def flight_file(self) -> Path:
        """The vehicle's measurements."""
        return self.folder / self.split / f"{self.name}{self._ending}"

    @property
    def truth_file(self) -> Path:
        """Ground truth, row by row at the same times."""
        return self.folder / "truth" / f"{self.name}{self._ending}"

    @property
    def summary_file(self) -> Path:
        """Its `FlightSummary`."""
        return self.folder / "summaries" / f"{self.name}.json"

    @property
    def _ending(self) -> str:
        return ".csv" if self.csv else ".parquet"


class FlightSummary(msgspec.Struct, frozen=True):
    """Summary of a flight.

    speed: factor on the reference's own.
    duration: s.
    position_rmse: of the true position, m.
    peak_...: of ground truth in m/s, m/s^2, rad/s^2 (over 10 ms) and rpm.
    """

    name: str
    split: str
    reference: str
    speed: float
    seed: int
    duration: float
    samples: int
    position_rmse: float
    peak_speed: float
    peak_acceleration: float
    peak_angular_acceleration: float
    peak_rotor_rpm: float


def fly_task(task: FlightTask) -> FlightSummary:
    """Fly a flight and write ground truth, summary and flight, in this order: the flight's file completes the set.

    Raises VehicleError when it cannot be flown at half its speed, RequestError when nothing can be written.
    """
    vehicle = parse_vehicle(task.vehicle_text)
    scenario = parse_scenario(task.scenario_text, vehicle.rotors.count, catalogue=catalogue_of(vehicle))
    full = _within_reach(named_reference(task.reference, vehicle), vehicle)
    for speed in SPEEDS:
        reference = full if speed == 1.0 else slowed(full, speed)
        start = reference.states(np.zeros(1))[0]
        options = dataclasses.replace(
            scenario.vehicle_options(),
            position=(float(start[0]), float(start[1])),
            yaw=float(2 * np.arctan2(start[9], start[6])),
        )
        flown = fly_reference(
            vehicle,
            reference,
            effects=task.effects,
            options=options,
            seed=task.seed,
            name=task.name,
            controller=_controller(task.vehicle_text),
        )
        if not flown.aborted:
            return _write(task, flown, reference)
    raise VehicleError(f"{task.name} cannot be flown even at half its speed: {flown.aborted}. Hide fewer effects.")


@lru_cache(maxsize=4)
def _controller(vehicle_text: str) -> Controller:
    return Controller.build(parse_vehicle(vehicle_text))


def _within_reach(reference: Reference, vehicle: Vehicle) -> Reference:
    """The reference as fast as the vehicle can fly it, at most as it is."""
    verdict = check_feasibility(reference, vehicle)
    if verdict.is_feasible:
        return reference
    if verdict.feasible_speed is None:
        verdict.require()
        raise RequestError(f"the vehicle cannot fly {reference.name}.")
    return slowed(reference, verdict.feasible_speed)


def _write(task: FlightTask, flown: FlownReference, reference: Reference) -> FlightSummary:
    truth = Flight.from_log(flown.truth, rate=1 / CONTROL_PERIOD)
    flight = Flight.from_log(flown.log, rate=1 / CONTROL_PERIOD)
    rows = min(_complete_rows(flight), len(truth))
    flight, truth = flight.rows(0, rows), truth.rows(0, rows)
    requested = named_reference(task.reference, reference.vehicle)
    summary = _summary(task, flight, truth, reference.law.rate / requested.law.rate)
    _save(truth, task.truth_file, csv=task.csv)
    task.summary_file.write_bytes(msgspec.json.format(msgspec.json.encode(summary)))
    _save(flight, task.flight_file, csv=task.csv)
    return summary


def _save(flight: Flight, file: Path, *, csv: bool) -> None:
    if csv:
        flight.to_csv(file)
    else:
        flight.to_parquet(file)


def _complete_rows(flight: Flight) -> int:
    """Number of rows up to the last complete one: the estimate is late, so that the last rows have none."""
    complete = np.isfinite(np.hstack([flight["position"], flight["rotor_speed"]])).all(axis=1)
    return int(np.flatnonzero(complete)[-1]) + 1


def _summary(task: FlightTask, flight: Flight, truth: Flight, speed: float) -> FlightSummary:
    error = truth["position"] - flight["position_setpoint"]
    acceleration = np.diff(truth["velocity"], axis=0) / CONTROL_PERIOD
    turning = np.diff(truth["rate"], axis=0) / CONTROL_PERIOD
    return FlightSummary(
        name=task.name,
        split=task.split,
        reference=task.reference,
        speed=round(speed, 4),
        seed=task.seed,
        duration=round(len(flight) * CONTROL_PERIOD, 3),
        samples=len(flight),
        position_rmse=float(np.sqrt(np.mean(np.sum(error**2, axis=1)))),
        peak_speed=_peak(truth["velocity"]),
        peak_acceleration=_peak(acceleration),
        peak_angular_acceleration=_peak(turning),
        peak_rotor_rpm=float(truth["rotor_speed"].max()) / RPM,
    )


def _peak(vectors: np.ndarray) -> float:
    return float(np.linalg.norm(vectors, axis=1).max())
