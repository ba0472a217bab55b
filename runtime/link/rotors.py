"""Rotor speeds as the link brings them: messages of the autopilot's motors as speeds of the vehicle file's rotors."""

from __future__ import annotations

from collections.abc import Callable
from math import atan2, isfinite, pi

import msgspec
import numpy as np

from dynamics.arrays import Floats
from dynamics.autopilot_frames import FRAMES
from dynamics.vehicle import Rotors
from runtime.link.link import Link
from runtime.link.parameters import read_parameter
from runtime.link.telemetry import MotorOutputs, RotorSpeeds

PULSE_LOW, PULSE_SPAN = 1000.0, 1000.0  # us of a motor at rest, and its range (PX4's PWM_MAIN_MINn and MAXn)
MAX_ANGLE = 0.35  # rad between the directions of a motor and of its rotor


class RotorReading(msgspec.Struct, frozen=True):
    """Speeds (n,) of all rotors, rad/s, in the vehicle file's order.

    measured: by ESCs, and not commanded by outputs.
    """

    time: float
    speed: Floats
    measured: bool


def motor_of_rotors(rotors: Rotors, motors: Floats | None = None) -> tuple[int, ...] | None:
    """For each rotor the index of its motor, by direction from the centre; None where they do not agree.

    motors: (n, 2) forward and left, m, of the autopilot's motors in its order; None for PX4's usual frame of as many.
    """
    directions = np.array(rotors.position)[:, :2]
    if motors is not None:
        return _matched(directions, motors)
    frames = (frame for frame in FRAMES.values() if len(frame.angle) == rotors.count)
    for frame in frames:
        angles = np.radians(frame.angle)
        order = _matched(directions, np.column_stack([np.cos(angles), -np.sin(angles)]))
        if order is not None:
            return order
    return None


def _matched(rotors: Floats, motors: Floats) -> tuple[int, ...] | None:
    if len(rotors) != len(motors):
        return None
    angles = [np.array([atan2(y, x) for x, y in part]) for part in (rotors, motors)]
    apart = np.abs((angles[0][:, None] - angles[1] + pi) % (2 * pi) - pi)
    order = tuple(int(motor) for motor in apart.argmin(axis=1))
    return order if len(set(order)) == len(order) and float(apart.min(axis=1).max()) < MAX_ANGLE else None


def motor_positions(link: Link, count: int) -> Floats | None:
    """Forward and left (n, 2), m, of the autopilot's motors, by CA_ROTORn_PX and PY; None where it states none."""
    positions = np.zeros((count, 2))
    for motor in range(count):
        for axis, name in enumerate(("PX", "PY")):
            value = read_parameter(link, f"CA_ROTOR{motor}_{name}", timeout=0.3, attempts=2).value
            if value is None:
                return None
            positions[motor, axis] = float(value) if axis == 0 else -float(value)
    return positions if np.ptp(positions) > 0 else None


class RotorReader:
    """Joins messages of a few motors each to readings of all rotors. Pure."""

    def __init__(self, order: tuple[int, ...], speed_of: Callable[[float], float]) -> None:
        """order: for each rotor the index of its motor. speed_of: rad/s, of a motor's signal, 0..1."""
        self._order, self._speed_of = list(order), speed_of
        self._speed = np.full(max(order) + 1, np.nan)

    def read(self, sample: RotorSpeeds | MotorOutputs) -> RotorReading | None:
        """The speeds of all rotors once a message has completed them; None before, or where one is none."""
        if isinstance(sample, RotorSpeeds):
            return self._join(sample)
        if sample.source != "SERVO_OUTPUT_RAW" or len(sample.value) <= max(self._order):
            return None
        pulses = np.array(sample.value)[self._order]
        if not np.all((pulses > PULSE_LOW) & (pulses <= PULSE_LOW + PULSE_SPAN)):
            return None  # disarmed, or outputs of another kind
        signals = (pulses - PULSE_LOW) / PULSE_SPAN
        speed = np.array([self._speed_of(signal) for signal in signals.tolist()])
        return RotorReading(sample.time, speed, measured=False)

    def _join(self, sample: RotorSpeeds) -> RotorReading | None:
        for motor, speed in enumerate(sample.speed, sample.first):
            if motor < len(self._speed):
                self._speed[motor] = speed
        speeds = self._speed[self._order]
        complete = isfinite(float(speeds.sum())) and bool((speeds > 0).all())
        if not complete or sample.first + len(sample.speed) < len(self._speed):
            return None
        return RotorReading(sample.time, speeds, measured=True)
