"""Accelerometer bias: a constant error of the measured specific force."""

from dataclasses import replace

from dynamics import symbolic as ca
from dynamics.effect import Effect, Parameter, Prior, Reading, Values
from dynamics.excitation import POSE, Excitation

AXES = ("x", "y", "z")
SENSOR_PRIOR = 0.02  # m/s^2, of a healthy accelerometer


def measurement(reading: Reading, p: Values, _: int | None) -> Reading:
    """The measured specific force is the true one plus (x, y, z)."""
    return replace(reading, specific_force=reading.specific_force + ca.vertcat(*[p[axis] for axis in AXES]))


EFFECT = Effect(
    name="imu_bias",
    summary="Constant error of the accelerometer",
    source="Titterton and Weston, Strapdown Inertial Navigation Technology, 2004, eq. 12.1",
    parameters=tuple(
        Parameter(axis, "m/s^2", f"bias along body {axis}", -20.0, 20.0, lambda _: Prior(0.1, 0.3)) for axis in AXES
    ),
    measurement=measurement,
    sensor_prior=SENSOR_PRIOR,
    excitation=Excitation(
        (("specific_force",), *POSE),
        measure="tilt",
        weak=0.05,
        enough=0.2,
        flight="tilted flight in several headings: circle",
        manoeuvre="hover with the nose turned to four directions",
    ),
)
