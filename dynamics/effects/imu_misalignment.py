"""Misalignment of the inertial sensors: accelerometer and gyro are turned against the body."""

from dataclasses import replace

import casadi as ca

from dynamics import quaternion
from dynamics.effect import Effect, Parameter, Prior, Reading, Values
from dynamics.excitation import POSE, Excitation

AXES = ("x", "y", "z")


def measurement(reading: Reading, p: Values, _: int | None) -> Reading:
    """Both sensors measure in axes that are turned from the body's by the rotation vector (x, y, z)."""
    turn = quaternion.small_turn(ca.vertcat(*[p[axis] for axis in AXES]))
    return replace(
        reading,
        specific_force=quaternion.rotate_inverse(turn, reading.specific_force),
        rate_body=quaternion.rotate_inverse(turn, reading.rate_body),
    )


EFFECT = Effect(
    name="imu_misalignment",
    summary="Accelerometer and gyro turned against the body",
    source="Titterton and Weston, Strapdown Inertial Navigation Technology, 2004, sec. 12.3 (mounting misalignment)",
    parameters=tuple(
        Parameter(axis, "rad", f"turn about body {axis}", -0.4, 0.4, lambda _: Prior(0.0, 0.03)) for axis in AXES
    ),
    measurement=measurement,
    confounded_with=("imu_bias",),
    excitation=Excitation(
        (("specific_force",), ("rate",), *POSE),
        measure="tilting_rate",
        weak=0.2,
        enough=0.6,
        flight="tilted flight in several headings: circle",
        manoeuvre="quick alternating rolls and pitches, climbs and descents",
    ),
)
