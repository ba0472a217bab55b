"""Gyro bias: a constant error of the measured body rates."""

from dataclasses import replace

from dynamics import symbolic as ca
from dynamics.effect import Effect, Parameter, Prior, Reading, Values
from dynamics.excitation import Excitation

AXES = ("x", "y", "z")
SENSOR_PRIOR = 0.01  # rad/s, of a healthy gyro


def measurement(reading: Reading, p: Values, _: int | None) -> Reading:
    """The measured body rate is the true one plus (x, y, z)."""
    return replace(reading, rate_body=reading.rate_body + ca.vertcat(*[p[axis] for axis in AXES]))


EFFECT = Effect(
    name="gyro_bias",
    summary="Constant error of the gyro",
    source="Titterton and Weston, Strapdown Inertial Navigation Technology, 2004, eq. 12.1",
    parameters=tuple(
        Parameter(axis, "rad/s", f"bias about body {axis}", -2.0, 2.0, lambda _: Prior(0.02, 0.05)) for axis in AXES
    ),
    measurement=measurement,
    sensor_prior=SENSOR_PRIOR,
    excitation=Excitation(
        (("rate",), ("attitude",)),
        measure="duration",
        weak=5.0,
        enough=15.0,
        flight="any flight",
        manoeuvre="half a minute of quiet hover",
    ),
)
