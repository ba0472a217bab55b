"""Numbers of a vehicle in another unit: grams, millimetres, inches, g cm^2, revolutions per minute."""

from __future__ import annotations

import msgspec
import pytest

from dynamics.errors import RequestError
from dynamics.vehicle import Rotors, Vehicle
from dynamics.vehicle_file import find_vehicle, parse_vehicle, read_vehicle, vehicle_toml
from dynamics.vehicle_plausibility import require_in_range, require_plausible

BUNDLED = ("arpl_250g", "crazyflie", "px4_sih")


def _changed(vehicle: Vehicle, *, body: dict[str, object] | None = None, **rotors: object) -> Vehicle:
    return msgspec.structs.replace(
        vehicle,
        body=msgspec.structs.replace(vehicle.body, **(body or {})),
        rotors=msgspec.structs.replace(vehicle.rotors, **rotors),
    )


def _scaled(rotors: Rotors, factor: float) -> tuple[tuple[float, ...], ...]:
    return tuple(tuple(factor * value for value in place) for place in rotors.position)


@pytest.mark.parametrize("name", BUNDLED)
def test_bundled_vehicles_are_plausible(name: str) -> None:
    require_plausible(read_vehicle(find_vehicle(name)))


@pytest.mark.parametrize("name", BUNDLED)
def test_a_file_of_which_all_is_scaled_with_a_mass_in_grams_is_refused_with_the_mass_in_kg(name: str) -> None:
    vehicle = read_vehicle(find_vehicle(name))
    body, rotors = vehicle.body, vehicle.rotors
    grams = _changed(
        vehicle,
        body={"mass": 1000 * body.mass, "inertia": tuple(1000 * value for value in body.inertia)},
        thrust_constant=1000 * rotors.thrust_constant,
        torque_constant=1000 * rotors.torque_constant,
    )
    with pytest.raises(RequestError, match=rf"g are {body.mass:g} kg"):
        parse_vehicle(vehicle_toml(grams))


@pytest.mark.parametrize("name", BUNDLED)
@pytest.mark.parametrize(("unit", "factor"), [("mm", 1e3), ("cm", 1e2), ("inches", 1 / 0.0254)])
def test_positions_in_another_unit_are_refused(name: str, unit: str, factor: float) -> None:
    vehicle = read_vehicle(find_vehicle(name))
    with pytest.raises(RequestError, match="lengths in m"):
        parse_vehicle(vehicle_toml(_changed(vehicle, position=_scaled(vehicle.rotors, factor))))


@pytest.mark.parametrize("name", BUNDLED)
@pytest.mark.parametrize("factor", [1e7, 1e6, 1e4, 1e3, 1e-3])  # g cm^2, kg mm^2, kg cm^2, g m^2, t m^2
def test_an_inertia_in_another_unit_is_refused(name: str, factor: float) -> None:
    vehicle = read_vehicle(find_vehicle(name))
    inertia = tuple(factor * value for value in vehicle.body.inertia)
    with pytest.raises(RequestError, match="Check inertia"):
        parse_vehicle(vehicle_toml(_changed(vehicle, body={"inertia": inertia})))


@pytest.mark.parametrize(
    ("rotors", "words"),
    [
        ({"radius": 0.9}, "inch"),  # 1.8 inches of diameter taken as m of radius
        ({"radius": 0.02, "speed_max": 40_000.0, "thrust_constant": 2e-9}, "rpm"),
        ({"radius": 0.002}, "thrust coefficient"),
        ({"speed_max": 9.55 * 2600.0}, "rpm"),
    ],
)
def test_rotors_in_other_units_are_refused(rotors: dict[str, object], words: str) -> None:
    with pytest.raises(RequestError, match=words):
        parse_vehicle(vehicle_toml(_changed(read_vehicle(find_vehicle("crazyflie")), **rotors)))


def test_a_centre_of_mass_in_millimetres_is_refused() -> None:
    vehicle = read_vehicle(find_vehicle("px4_sih"))
    with pytest.raises(RequestError, match="fall over"):
        parse_vehicle(vehicle_toml(_changed(vehicle, body={"centre_of_mass": (2.0, 0.0, 0.0)})))


@pytest.mark.parametrize(
    ("values", "words"),
    [({"mass": 1000.0}, "1000 g are 1"), ({"arm": 225.0}, "225 mm"), ({"propeller": 10.0}, "10 in")],
)
def test_what_is_given_in_another_unit_is_refused_with_the_unit(values: dict[str, float], words: str) -> None:
    with pytest.raises(RequestError, match=words):
        require_in_range(**values)


def test_rotors_one_above_the_other_share_their_disc() -> None:
    vehicle = read_vehicle(find_vehicle("px4_sih"))
    places = vehicle.rotors.position
    both = (*places, *((x, y, 0.05) for x, y, _ in places))
    rotors = msgspec.structs.replace(vehicle.rotors, position=both, spin=(1, -1, 1, -1, -1, 1, -1, 1))
    require_plausible(msgspec.structs.replace(vehicle, rotors=rotors))
