"""Rotors by place and by the autopilots' numbers: a user takes off the right propeller."""

import msgspec
import numpy as np
import pytest

from dynamics.rotor_places import DIRECTIONS, rotor_names, rotor_places
from dynamics.vehicle import Vehicle
from dynamics.vehicle_file import find_vehicle, read_vehicle
from flights.readers.crazyflie import _ROTORS
from flights.readers.px4_rotors import QUAD_X
from sitl_mock.wire.snapshot import motor_order


def vehicle_at(angles: list[float]) -> Vehicle:
    """A vehicle with rotors at these directions from forward to the left, degrees."""
    base = read_vehicle(find_vehicle("arpl_250g"))
    position = tuple((float(np.cos(a)), float(np.sin(a)), 0.0) for a in np.radians(angles))
    spin = tuple((-1) ** place for place in range(len(angles)))
    return msgspec.structs.replace(base, rotors=msgspec.structs.replace(base.rotors, position=position, spin=spin))


def test_the_bundled_quadrotors_rotors_have_the_readers_motor_numbers() -> None:
    vehicle = read_vehicle(find_vehicle("px4_sih"))
    names = rotor_names(vehicle)
    assert names[0] == "rotor 0 (front left; PX4 and ArduPilot motor 3, Crazyflie M4)"
    for rotor, motor in enumerate(QUAD_X):
        assert f"motor {motor + 1}," in names[rotor]
    for motor, rotor in enumerate(motor_order(np.array(vehicle.rotors.position))):
        assert f"motor {motor + 1}," in names[rotor]
    for rotor, column in enumerate(_ROTORS):
        assert column.upper() in names[rotor]


@pytest.mark.parametrize(
    ("angles", "places"),
    [
        ([0, 90, 180, 270], ("front", "left", "back", "right")),
        ([30, 90, 150, 210, 270, 330], ("front left", "left", "back left", "back right", "right", "front right")),
        (list(range(0, 360, 45)), DIRECTIONS),
        ([45, 50, 135, 140, 225, 230, 315, 320], ("",) * 8),
    ],
    ids=["plus", "hexa X", "octa", "coaxial"],
)
def test_places_are_the_nearest_of_eight_directions(angles: list[float], places: tuple[str, ...]) -> None:
    assert rotor_places(vehicle_at(angles)) == places


def test_frames_without_usual_numbers_have_their_place_alone() -> None:
    assert rotor_names(vehicle_at([0, 90, 180, 270]))[1] == "rotor 1 (left)"
    assert rotor_names(vehicle_at([45, 50, 135, 140, 225, 230, 315, 320]))[3] == "rotor 3"
    assert rotor_names(vehicle_at([30, 90, 150, 210, 270, 330]))[1] == "rotor 1 (left; PX4 and ArduPilot motor 2)"
