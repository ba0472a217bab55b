"""Frames of multirotors as the autopilots number and turn their motors.

Source: ArduPilot, AP_MotorsMatrix.cpp; PX4's airframes of the same names agree with it, in places, numbers and turns.
Crazyflie and Betaflight (propellers in) turn the rotors of a quad x as these do, and number them otherwise.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from dynamics.arrays import Vector3

CCW, CW = 1, -1


@dataclass(frozen=True)
class Frame:
    """A frame's motors in the autopilot's order, motor 1 first.

    angle: clockwise from forward, seen from above, degrees.
    turns: 1 counter-clockwise, -1 clockwise, seen from above.
    order: place among the motors of each rotor, in the order in which logs are read.
    """

    angle: tuple[float, ...]
    turns: tuple[int, ...]
    order: tuple[int, ...]

    @property
    def directions(self) -> tuple[Vector3, ...]:
        """Unit vectors from the centre to each motor, in the autopilot's order, body FLU."""
        angles = [math.radians(angle) for angle in self.angle]
        return tuple((_clean(math.cos(a)), _clean(-math.sin(a)), 0.0) for a in angles)

    @property
    def direction(self) -> tuple[Vector3, ...]:
        """Unit vectors from the centre to each rotor, body FLU."""
        return tuple(self.directions[motor] for motor in self.order)

    @property
    def spin(self) -> tuple[int, ...]:
        """Sign of each rotor's reaction torque about body z: opposite to the turn."""
        return tuple(-self.turns[motor] for motor in self.order)

    @property
    def motor(self) -> tuple[int, ...]:
        """The autopilot's number of each rotor's motor, from 1."""
        return tuple(motor + 1 for motor in self.order)


def _clean(value: float) -> float:
    """Without the rounding of angles: 0 instead of 6e-17."""
    return round(value, 12) + 0.0


def _frame(angle: tuple[float, ...], turns: tuple[int, ...], order: tuple[int, ...] | None = None) -> Frame:
    return Frame(angle, turns, order or tuple(range(len(angle))))


QUAD_X_ORDER = (2, 1, 3, 0)  # front left, back left, back right, front right
FRAMES: Mapping[str, Frame] = {
    "quad_x": _frame((45, -135, -45, 135), (CCW, CCW, CW, CW), QUAD_X_ORDER),
    "quad_plus": _frame((90, -90, 0, 180), (CCW, CCW, CW, CW)),
    "quad_h": _frame((45, -135, -45, 135), (CW, CW, CCW, CCW), QUAD_X_ORDER),
    "hexa_x": _frame((90, -90, -30, 150, 30, -150), (CW, CCW, CW, CCW, CCW, CW)),
    "hexa_plus": _frame((0, 180, -120, 60, -60, 120), (CW, CCW, CW, CCW, CCW, CW)),
    "octa_x": _frame((22.5, -157.5, 67.5, 157.5, -22.5, -112.5, -67.5, 112.5), (CW, CW, CCW, CCW, CCW, CCW, CW, CW)),
    "octa_plus": _frame((0, 180, 45, 135, -45, -135, -90, 90), (CW, CW, CCW, CCW, CCW, CCW, CW, CW)),
    "octaquad_x": _frame((45, -45, -135, 135, -45, 45, 135, -135), (CCW, CW, CCW, CW, CCW, CW, CCW, CW)),
}
AUTOPILOTS = ("PX4", "ArduPilot", "Crazyflie", "Betaflight")
# motor numbers of front left, back left, back right and front right, of autopilots that number a quad x by themselves
OWN_NUMBERS: Mapping[str, tuple[int, ...]] = {"Crazyflie": (4, 3, 2, 1), "Betaflight": (4, 3, 1, 2)}
ARDUPILOT_CLASSES: Mapping[int, str] = {1: "quad", 2: "hexa", 3: "octa", 4: "octaquad"}  # FRAME_CLASS
ARDUPILOT_TYPES: Mapping[int, str] = {0: "plus", 1: "x", 3: "h"}  # FRAME_TYPE


def ardupilot_frame(frame_class: int, frame_type: int) -> str | None:
    """The name of a frame by FRAME_CLASS and FRAME_TYPE, None where it is none of these."""
    name = f"{ARDUPILOT_CLASSES.get(frame_class)}_{ARDUPILOT_TYPES.get(frame_type)}"
    return name if name in FRAMES else None
