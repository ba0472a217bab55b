"""Lever arm of the accelerometer: it sits off the centre of mass and measures its own place's acceleration."""

from dataclasses import replace

from dynamics import symbolic as ca
from dynamics.effect import Effect, Parameter, Prior, Reading, Values
from dynamics.excitation import QUICK_TURNS, Excitation
from dynamics.kinematics import lever_arm_acceleration

AXES = ("x", "y", "z")


def measurement(reading: Reading, p: Values, _: int | None) -> Reading:
    """The measured specific force is the true one plus alpha x r + omega x (omega x r), r = (x, y, z)."""
    arm = ca.vertcat(*[p[axis] for axis in AXES])
    beyond = lever_arm_acceleration(arm, reading.rate_body, reading.angular_acceleration)
    return replace(reading, specific_force=reading.specific_force + beyond)


EFFECT = Effect(
    name="imu_lever_arm",
    summary="Accelerometer off the centre of mass",
    source="Titterton and Weston, Strapdown Inertial Navigation Technology, 2004, sec. 12.3 (size effect)",
    parameters=tuple(
        Parameter(axis, "m", f"along body {axis}, from the centre of mass", -1.0, 1.0, lambda _: Prior(0.0, 0.02))
        for axis in AXES
    ),
    measurement=measurement,
    confounded_with=("centre_of_mass",),
    excitation=Excitation(
        (("specific_force",), ("rate",)),
        measure="tilting_acceleration",
        weak=3.0,
        enough=10.0,
        flight=QUICK_TURNS,
        manoeuvre="quick alternating rolls and pitches, and a yaw spin",
    ),
)
