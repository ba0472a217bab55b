"""Flights with a planted truth: the runtime tracks references on the mock's vehicle, which hides effects."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from functools import cache

from alula.lockstep import fly_reference
from diagnosis.dataset import Dataset, make_dataset
from dynamics.references import named_reference
from dynamics.vehicle import EffectUse, Vehicle
from flights import Flight
from runtime.controller import Controller
from sitl_mock.sensors import SensorErrors
from sitl_mock.vehicle import VehicleOptions

# Nine flights of about 12 s: each effect has one that shows it; the last two are held out.
MANOEUVRES = (
    "line:laps=3,ramp=1",
    "line:plane=yx,laps=3,ramp=1,size=1.3",
    "yaw_spin:laps=3,ramp=1",
    "circle:laps=3,ramp=1,speed=1.2",
    "bob:laps=4,ramp=1,height=0.25",
    "low_flight:laps=2,ramp=1,height=0.3",
    "Lemniscate:laps=4,ramp=1.5,speed=0.9",
    "WarpedEllipse_2:laps=4,ramp=1.5,speed=0.8",
    "ExtendedLemniscate:laps=3,ramp=1",
)
HELD_OUT = 2


@cache
def _controller(vehicle_name: str) -> Controller:
    from dynamics.vehicle_file import read_vehicle
    from vehicles import FOLDER

    return Controller.build(read_vehicle(FOLDER / f"{vehicle_name}.toml"))


def noisy(factor: float) -> VehicleOptions:
    """The mock's sensors with all noise but biases and delay times a factor."""
    usual = SensorErrors()
    names = ("gyro", "accelerometer", "position", "velocity", "tilt", "yaw", "rotor_speed", "rotor_speed_step")
    return VehicleOptions(sensors=dataclasses.replace(usual, **{n: factor * getattr(usual, n) for n in names}))


def planted_flights(
    vehicle: Vehicle,
    effects: Sequence[EffectUse],
    *,
    seed: int,
    options: VehicleOptions | None = None,
    manoeuvres: Sequence[str] = MANOEUVRES,
) -> list[Flight]:
    """One flight of each manoeuvre on a vehicle that hides effects from its file."""
    flights = []
    for i, text in enumerate(manoeuvres):
        reference = named_reference(text, vehicle)
        flown = fly_reference(
            vehicle, reference, effects=effects, options=options, seed=100 * seed + i, name=f"flight_{i}.csv",
            controller=_controller(vehicle.name),
        )  # fmt: skip
        flights.append(Flight.from_log(flown.log))
    return flights


def planted_dataset(
    vehicle: Vehicle, effects: Sequence[EffectUse], *, seed: int, options: VehicleOptions | None = None
) -> Dataset:
    """The flights as diagnosis reads them, the last two held out."""
    return make_dataset(planted_flights(vehicle, effects, seed=seed, options=options), vehicle)
