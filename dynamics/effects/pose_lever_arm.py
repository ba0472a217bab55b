"""Lever arm of the pose: position and velocity are those of a point off the centre of mass."""

from dataclasses import replace

from dynamics import symbolic as ca
from dynamics.effect import Effect, Parameter, Prior, Reading, Values
from dynamics.excitation import POSE, QUICK_TURNS, Excitation

AXES = ("x", "y", "z")


def measurement(reading: Reading, p: Values, _: int | None) -> Reading:
    """The logged position and velocity are p + R r and v + R (omega x r), r = (x, y, z)."""
    return replace(reading, pose_arm=reading.pose_arm + ca.vertcat(*[p[axis] for axis in AXES]))


EFFECT = Effect(
    name="pose_lever_arm",
    summary="Position and velocity of a point off the centre of mass",
    source="kinematics of a rigid body; Groves, Principles of GNSS, Inertial and Multisensor Navigation, 2013, ch. 14",
    parameters=tuple(
        Parameter(axis, "m", f"along body {axis}, from the centre of mass", -1.0, 1.0, lambda _: Prior(0.0, 0.03))
        for axis in AXES
    ),
    measurement=measurement,
    confounded_with=("centre_of_mass",),
    excitation=Excitation(
        (("rate",), *POSE),
        measure="tilting_acceleration",
        weak=3.0,
        enough=10.0,
        flight=QUICK_TURNS,
        manoeuvre="quick alternating rolls and pitches, and a yaw spin",
    ),
)
