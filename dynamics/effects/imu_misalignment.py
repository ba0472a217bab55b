"""Misalignment of the inertial sensors: the accelerometer, mostly with the gyro, is turned against the body."""

from collections.abc import Sequence
from dataclasses import replace

from dynamics import quaternion
from dynamics import symbolic as ca
from dynamics.effect import Effect, Parameter, Prior, Reading, Span, Values
from dynamics.excitation import POSE, Excitation
from dynamics.vehicle import Vehicle

AXES = ("x", "y", "z")


def usual_gyro(_: Vehicle) -> Prior:
    """Both sensors are on one board."""
    return Prior(1.0, 0.5)


def measurement(reading: Reading, p: Values, _: int | None) -> Reading:
    """The accelerometer measures in axes that are turned from the body's by the rotation vector (x, y, z).

    So does the gyro where gyro_turns is 1; where it is 0 its axes are the body's.
    """
    angle = ca.vertcat(*[p[axis] for axis in AXES])
    accelerometer, gyro = (quaternion.small_turn(share * angle) for share in (1.0, p["gyro_turns"]))
    return replace(
        reading,
        specific_force=quaternion.rotate_inverse(accelerometer, reading.specific_force),
        gyro_axes=quaternion.multiply(gyro, reading.gyro_axes),
    )


def grid(_: Vehicle, __: Span) -> Sequence[dict[str, float]]:
    """The accelerometer with the gyro, and alone."""
    return [{"gyro_turns": turns} for turns in (1.0, 0.0)]


EFFECT = Effect(
    name="imu_misalignment",
    summary="Accelerometer and gyro turned against the body",
    source="Titterton and Weston, Strapdown Inertial Navigation Technology, 2004, sec. 12.3 (mounting misalignment)",
    parameters=(
        *(Parameter(axis, "rad", f"turn about body {axis}", -0.4, 0.4, lambda _: Prior(0.0, 0.03)) for axis in AXES),
        Parameter("gyro_turns", "1", "1: the gyro is turned as well; 0: its axes are the body's", 0.0, 1.0, usual_gyro),
    ),
    measurement=measurement,
    grid=grid,
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
