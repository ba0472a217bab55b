"""Layouts by the autopilot's parameters: PX4's geometry, ArduPilot's frames, in the order of the readers."""

import numpy as np
import pytest

from dynamics.autopilot_frames import FRAMES, ardupilot_frame
from dynamics.rotor_places import HEXA_X, QUAD_X, rotor_places
from dynamics.vehicle import Body, Rotors, Vehicle
from flights.rotor_layout import rotor_layout

PLACES = [(0.2, 0.3), (-0.2, -0.3), (0.2, -0.3), (-0.2, 0.3)]  # PX4's quad x, forward and right, m
PX4 = {
    "CA_ROTOR_COUNT": 4.0,
    **{
        f"CA_ROTOR{i}_P{axis}": value for i, place in enumerate(PLACES) for axis, value in zip("XY", place, strict=True)
    },
    **{f"CA_ROTOR{i}_KM": ratio for i, ratio in enumerate((0.02, 0.02, -0.02, -0.02))},
}


def test_px4s_geometry_is_in_metres_and_the_readers_order() -> None:
    layout = rotor_layout({**PX4, "THR_MDL_FAC": 0.3, "MPC_THR_HOVER": 0.4})
    assert layout is not None
    assert layout.in_metres
    assert np.allclose(layout.position, [(0.2, 0.3, 0), (-0.2, 0.3, 0), (-0.2, -0.3, 0), (0.2, -0.3, 0)])
    assert (layout.spin, layout.motor) == ((1, -1, 1, -1), (3, 2, 4, 1))
    assert (layout.torque_ratio, layout.thrust_curve, layout.hover) == (pytest.approx(0.02), 0.3, 0.4)


def test_a_tilted_rotor_and_the_generic_arm_are_remarked_upon() -> None:
    layout = rotor_layout({**PX4, "CA_ROTOR1_AX": 0.2})
    assert layout is not None
    assert any("motor 2 is tilted by 11 degrees" in note for note in layout.notes)
    generic = {name: 0.15 * np.sign(v) if name[-2:] in ("PX", "PY") else v for name, v in PX4.items()}
    layout = rotor_layout(generic)
    assert layout is not None
    assert any("generic airframe" in note for note in layout.notes)


def test_other_parameters_state_no_layout() -> None:
    assert rotor_layout({}) is None
    assert rotor_layout({"FRAME_CLASS": 1.0, "FRAME_TYPE": 4.0}) is None


@pytest.mark.parametrize("name", FRAMES)
def test_every_frame_is_a_vehicle_that_can_be_controlled(name: str) -> None:
    frame = FRAMES[name]
    position = tuple((0.2 * x, 0.2 * y, 0.0) for x, y, _ in frame.direction)
    Rotors(position=position, spin=frame.spin, thrust_constant=1e-5, torque_constant=1e-7, speed_max=900.0)


@pytest.mark.parametrize(("name", "table"), [("quad_x", QUAD_X), ("hexa_x", HEXA_X)])
def test_frames_number_their_motors_as_names_do(name: str, table: dict[str, tuple[str, ...]]) -> None:
    frame = FRAMES[name]
    rotors = Rotors(frame.direction, frame.spin, thrust_constant=1e-5, torque_constant=1e-7, speed_max=2000.0)
    places = rotor_places(Vehicle(name, Body(1.0, (0.1, 0.1, 0.1)), rotors))
    by_motor = dict(zip(frame.motor, places, strict=True))
    assert tuple(by_motor[n + 1] for n in range(len(places))) == table["PX4 and ArduPilot motor "]


def test_ardupilots_quad_x_turns_as_px4s() -> None:
    assert ardupilot_frame(1, 1) == "quad_x"
    layout = rotor_layout({"FRAME_CLASS": 1.0, "FRAME_TYPE": 1.0, "MOT_THST_EXPO": 0.65})
    px4 = rotor_layout(PX4)
    assert layout is not None
    assert px4 is not None
    assert (layout.spin, layout.motor, layout.thrust_curve) == (px4.spin, px4.motor, 0.65)
    assert not layout.in_metres
