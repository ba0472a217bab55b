"""One short flight of the runtime's logic on the mock's vehicle, as a log with its ground truth."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache, partial

import numpy as np

from dynamics.arrays import Floats
from dynamics.references import named_reference
from dynamics.vehicle_file import parse_effect, read_vehicle
from fixtures.flight_store import stored
from flights import Flight
from flights.log import Log, Stream
from simulation.lockstep import FlownReference, fly_reference
from sitl_mock.vehicle.vehicle import VehicleOptions


@lru_cache(maxsize=2)
def flown(reference: str = "Lemniscate:laps=9", seed: int = 1) -> FlownReference:
    """Some twenty seconds of a reference with sensor noise and drag that the controller does not know."""
    return stored(partial(_fly, reference, seed), "simulated flight", reference, seed)


def _fly(reference: str, seed: int) -> FlownReference:
    vehicle = read_vehicle("vehicles/arpl_250g.toml")
    track = named_reference(reference, vehicle)
    start = track.states(np.zeros(1))[0]
    options = VehicleOptions(position=(float(start[0]), float(start[1])))
    effects = [parse_effect(text, 4) for text in ("motor_lag:time_constant=0.035", "rotor_drag:coefficient=2.2e-5")]
    return fly_reference(vehicle, track, effects=effects, options=options, seed=seed, name="simulated")


def changed(log: Log, name: str, values: Floats) -> Log:
    """The log with other values of a quantity."""
    return replace(
        log,
        streams=tuple(Stream(s.name, s.time, values, s.source) if s.name == name else s for s in log.streams),
    )


def thinned(log: Log, name: str, every: int) -> Log:
    """The log with only every so many samples of a quantity."""
    return replace(
        log,
        streams=tuple(
            Stream(s.name, s.time[::every], s.values[::every], s.source) if s.name == name else s for s in log.streams
        ),
    )


def without(log: Log, *names: str) -> Log:
    """The log without some quantities."""
    return replace(log, streams=tuple(stream for stream in log.streams if stream.name not in names))


def values(log: Log, name: str) -> Floats:
    """A copy of a quantity's values."""
    stream = log.stream(name)
    assert stream is not None
    return stream.values.copy()


def table(log: Log) -> Flight:
    """The log as a flight at 100 Hz."""
    return Flight.from_log(log, rate=100.0)
