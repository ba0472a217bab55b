"""All orders of the rotors on real and planted flights: which are refused. Writes results/rotor_orders.md.

    python -m benchmarks.rotor_orders

Every flight is judged alone, and each set as a whole, in all 24 orders, with the rotors' turning directions reversed,
and with the rotors' clock shifted by 0.2 s.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np

from benchmarks.provenance import write_result
from diagnosis.data.rotor_moments import compared_moments, require_rotor_moments
from diagnosis.data.segment import Segment, segments
from dynamics.errors import DataError
from dynamics.vehicle import Vehicle
from dynamics.vehicle_file import read_vehicle
from fixtures.planted import planted_flights
from flights import Flight
from vehicles import FOLDER

DATA = Path(__file__).resolve().parents[1] / "tests" / "data"
HEADER = (
    "| set | flights | s | agreement, file's order | any combination | yaw | right order passes | "
    "wrong orders refused, named rightly, named wrongly | reversed spin refused | 0.2 s shift refused |\n"
    "| --- | --- | --- | --- | --- | --- | --- | --- | --- | --- |"
)
CLOCK = 0.2  # s
GENTLE = ("circle:laps=1,ramp=2,speed=0.5", "line:laps=1,ramp=2,speed=0.5", "yaw_spin:laps=1,ramp=2")


def main() -> None:
    """Judge all sets and write the table."""
    lines = [HEADER]
    for name, flights, vehicle in sets():
        parts = [tuple(segments(flight, vehicle)) for flight in flights]
        flown = [part for part in parts if part]
        together = [s for part in flown for s in part]
        groups: list[Sequence[Segment]] = [together, *(flown if len(flown) > 1 else ())]
        lines.append(row(name, groups, vehicle))
    write_result("rotor_orders", "Orders of the rotors that pass the check of the data", "\n".join(lines))


def sets() -> Iterator[tuple[str, Sequence[Flight], Vehicle]]:
    """Name, flights and vehicle file of each set."""
    crazyflie, px4 = read_vehicle(FOLDER / "crazyflie.toml"), read_vehicle(FOLDER / "px4_sih.toml")
    lee = [DATA / "crazyflie" / "log20.gz", *sorted((DATA / "imrc_lee_crazyflie").glob("log*.gz"))]
    yield "Crazyflie, Lee controller, commanded thrust and torque", read(lee), heavier(crazyflie, 0.037, 3300.0)
    yield "Crazyflie, manual flight", read([DATA / "arpl_crazyflie" / "log10_cut.csv.gz"]), crazyflie
    yield "NanoBench", read(sorted((DATA / "nanobench").glob("*.gz"))), heavier(crazyflie, 0.0409, 2700.0)
    yield "PX4, SIH", read(sorted((DATA / "px4_sih_flights").glob("*.ulg.gz"))), px4
    small = read_vehicle(FOLDER / "arpl_250g.toml")
    yield "planted, nothing hidden", planted_flights(small, [], seed=101), small
    yield "planted, gentle", planted_flights(small, [], seed=103, manoeuvres=GENTLE), small


def read(logs: Sequence[Path]) -> list[Flight]:
    """The flights of logs."""
    return [Flight.read(log) for log in logs]


def heavier(vehicle: Vehicle, mass: float, speed_max: float) -> Vehicle:
    """The vehicle with another mass, kg, and speed at full signal, rad/s."""
    body = msgspec.structs.replace(vehicle.body, mass=mass)
    return msgspec.structs.replace(
        vehicle, body=body, rotors=msgspec.structs.replace(vehicle.rotors, speed_max=speed_max)
    )


def row(name: str, groups: Sequence[Sequence[Segment]], vehicle: Vehicle) -> str:
    """A line of the table: the first group is all flights, the others one flight each."""
    permutations = list(itertools.permutations(range(vehicle.rotors.count)))
    moments = compared_moments(groups[0], vehicle)
    passed, refused, right, wrong, spins, clocks = 0, 0, 0, 0, 0, 0
    rotors = vehicle.rotors
    backwards = msgspec.structs.replace(
        vehicle, rotors=msgspec.structs.replace(rotors, spin=tuple(-s for s in rotors.spin))
    )
    for group in groups:
        for order in permutations:
            answer = refusal([replace(s, rotor_speed=s.rotor_speed[:, np.argsort(order)]) for s in group], vehicle)
            if order == permutations[0]:
                passed += answer == ""
                continue
            refused += answer != ""
            right += f"columns {list(order)}" in answer
            wrong += "columns [" in answer and f"columns {list(order)}" not in answer
        spins += refusal(group, backwards) != ""
        late = [replace(s, rotor_speed=np.roll(s.rotor_speed, round(CLOCK * s.rate), axis=0)) for s in group]
        clocks += refusal(late, vehicle) != ""
    count, others = len(groups), len(groups) * (len(permutations) - 1)
    own = range(rotors.count)
    return (
        f"| {name} | {max(1, count - 1)} | {sum(s.duration for s in groups[0]):.0f} | {moments.agreement(own):.2f} | "
        f"{moments.explained:.2f} | {moments.correlations(own)[2]:.2f} | {passed} of {count} | {refused} of {others}, "
        f"{right}, {wrong} | {spins} of {count} | {clocks} of {count} |"
    )


def refusal(parts: Sequence[Segment], vehicle: Vehicle) -> str:
    """The message with which segments are refused, empty if they are not."""
    try:
        require_rotor_moments(parts, vehicle)
    except DataError as error:
        return str(error)
    return ""


if __name__ == "__main__":
    main()
