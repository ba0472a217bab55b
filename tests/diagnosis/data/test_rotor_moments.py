"""The rotors must turn the vehicle as the file says: any wrong order is refused, the right one never is."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
import pytest

from diagnosis.data.rotor_moments import require_rotor_moments
from diagnosis.data.segment import Segment, segments
from dynamics.errors import DataError
from dynamics.vehicle import Vehicle
from dynamics.vehicle_file import read_vehicle
from flights import Flight
from vehicles import FOLDER

DATA = Path(__file__).parents[2] / "data"
PERMUTATIONS = list(itertools.permutations(range(4)))
OWN = (0, 1, 2, 3)


def flown(logs: Sequence[Path], vehicle: Vehicle) -> list[Segment]:
    return [part for log in logs for part in segments(Flight.read(log), vehicle)]


def reordered(parts: Sequence[Segment], order: Sequence[int]) -> list[Segment]:
    """The log's column order[i] has what the file's rotor i did."""
    inverse = np.argsort(order)
    return [replace(part, rotor_speed=part.rotor_speed[:, inverse]) for part in parts]


@pytest.fixture(scope="module")
def crazyflie() -> Vehicle:
    return read_vehicle(FOLDER / "crazyflie.toml")


@pytest.fixture(scope="module")
def sets(crazyflie: Vehicle) -> dict[str, tuple[list[Segment], Vehicle]]:
    """Real flights: commanded thrust and torque, motor signals in manual and in fast flight, PX4's motors."""
    lee = [DATA / "crazyflie" / "log20.gz", *(DATA / "imrc_lee_crazyflie" / f"log{n}.gz" for n in (54, 100, "136_2"))]
    manual = [DATA / "arpl_crazyflie" / "log10_cut.csv.gz"]
    fast = sorted((DATA / "nanobench").glob("*.csv.gz"))
    px4 = [DATA / "px4_sih_flights" / "textbook_1_circle.ulg.gz"]
    upgraded, heavy = with_mass(crazyflie, 0.037, speed_max=3300.0), with_mass(crazyflie, 0.0409, speed_max=2700.0)
    sih = read_vehicle(FOLDER / "px4_sih.toml")
    named = {"lee": (lee, upgraded), "manual": (manual, crazyflie), "fast": (fast, heavy), "px4": (px4, sih)}
    return {name: (flown(logs, vehicle), vehicle) for name, (logs, vehicle) in named.items()}


def with_mass(vehicle: Vehicle, mass: float, *, speed_max: float) -> Vehicle:
    body = msgspec.structs.replace(vehicle.body, mass=mass)
    rotors = msgspec.structs.replace(vehicle.rotors, speed_max=speed_max)
    return msgspec.structs.replace(vehicle, body=body, rotors=rotors)


@pytest.mark.parametrize("name", ["lee", "manual", "fast", "px4"])
def test_of_all_orders_of_real_rotors_only_the_right_one_passes(
    sets: dict[str, tuple[list[Segment], Vehicle]], name: str
) -> None:
    parts, vehicle = sets[name]
    for order in PERMUTATIONS:
        if order == OWN:
            assert require_rotor_moments(parts, vehicle) == ()
            continue
        with pytest.raises(DataError, match="rotors do not turn the vehicle") as refusal:
            require_rotor_moments(reordered(parts, order), vehicle)
        assert f"columns {list(order)} are the file's rotors [0, 1, 2, 3]" in str(refusal.value)


@pytest.mark.parametrize("name", ["lee", "fast"])
def test_each_real_flight_alone_shows_the_order(sets: dict[str, tuple[list[Segment], Vehicle]], name: str) -> None:
    parts, vehicle = sets[name]
    for part in parts:
        require_rotor_moments([part], vehicle)
        for order in ((3, 2, 1, 0), (1, 0, 3, 2), (1, 2, 3, 0), (0, 2, 1, 3)):
            with pytest.raises(DataError, match=r"columns \["):
                require_rotor_moments(reordered([part], order), vehicle)


def test_one_flight_in_another_order_is_named(sets: dict[str, tuple[list[Segment], Vehicle]]) -> None:
    parts, vehicle = sets["lee"]
    mixed = [*reordered(parts[:1], (3, 2, 1, 0)), *parts[1:], *parts[1:], *parts[1:]]
    with pytest.raises(DataError, match=r"log20.*in another order than in the other flights.*\[3, 2, 1, 0\]"):
        require_rotor_moments(mixed, vehicle)


def test_turning_directions_of_the_wrong_sign_are_refused(sets: dict[str, tuple[list[Segment], Vehicle]]) -> None:
    parts, vehicle = sets["manual"]
    rotors = msgspec.structs.replace(vehicle.rotors, spin=tuple(-s for s in vehicle.rotors.spin))
    with pytest.raises(DataError, match="direction opposite to the vehicle file's"):
        require_rotor_moments(parts, msgspec.structs.replace(vehicle, rotors=rotors))


@pytest.mark.parametrize("seconds", [-0.4, 0.2, 0.6])
def test_rotors_on_another_clock_are_refused_with_the_shift(
    sets: dict[str, tuple[list[Segment], Vehicle]], seconds: float
) -> None:
    parts, vehicle = sets["lee"]
    late = [replace(p, rotor_speed=np.roll(p.rotor_speed, round(seconds * p.rate), axis=0)) for p in parts]
    with pytest.raises(DataError, match="their clock is not the gyro's") as refusal:
        require_rotor_moments(late, vehicle)
    assert ("earlier" if seconds > 0 else "later") in str(refusal.value)


def test_rotors_of_another_flight_are_refused(sets: dict[str, tuple[list[Segment], Vehicle]]) -> None:
    parts, vehicle = sets["lee"]
    foreign = [
        replace(a, rotor_speed=np.resize(b.rotor_speed, a.rotor_speed.shape))
        for a, b in zip(parts, parts[::-1], strict=True)
    ]
    with pytest.raises(DataError, match=r"say nothing about moments|clock is not the gyro's|do not turn the vehicle"):
        require_rotor_moments(foreign, vehicle)


def test_rotors_that_all_read_their_mean_are_refused(sets: dict[str, tuple[list[Segment], Vehicle]]) -> None:
    parts, vehicle = sets["manual"]
    mean = [replace(p, rotor_speed=np.tile(p.rotor_speed.mean(axis=1, keepdims=True), 4)) for p in parts]
    with pytest.raises(DataError, match="say nothing about moments"):
        require_rotor_moments(mean, vehicle)


def test_arms_turned_by_45_degrees_are_refused(sets: dict[str, tuple[list[Segment], Vehicle]]) -> None:
    """A plus for a cross: no order fits, though any combination of the rotors would."""
    parts, vehicle = sets["manual"]
    c = 0.028 * np.sqrt(2)
    plus = ((0.0, c, 0.0), (-c, 0.0, 0.0), (0.0, -c, 0.0), (c, 0.0, 0.0))
    rotors = msgspec.structs.replace(vehicle.rotors, position=plus)
    with pytest.raises(DataError, match="no other order of them fits"):
        require_rotor_moments(parts, msgspec.structs.replace(vehicle, rotors=rotors))
