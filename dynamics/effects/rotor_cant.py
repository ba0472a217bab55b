"""Rotor cant: one rotor does not thrust along body z."""

from dynamics import symbolic as ca
from dynamics.effect import Conditions, Effect, Parameter, Prior, Values, Wrench
from dynamics.excitation import DRIVE, Excitation


def wrench(c: Conditions, p: Values, _: Values) -> Wrench:
    """F = T_i (tangential t + radial r), with its moment; small angles, T_i along body z staying as it is.

    r points from the centre of mass to the rotor, t = e_z x r counter-clockwise seen from above.
    """
    rotor = c.rotor or 0
    arm = c.rotor_position[:, rotor]
    outwards = ca.vertcat(arm[0:2], 0) / ca.norm_2(arm[0:2])
    around = ca.vertcat(-outwards[1], outwards[0], 0)
    force = c.rotor_thrust[rotor] * (p["tangential"] * around + p["radial"] * outwards)
    return Wrench(force, ca.cross(arm, force))


EFFECT = Effect(
    name="rotor_cant",
    summary="One rotor's axis is tilted",
    source="PI-TCN eq. 2 with one rotor's thrust turned by small angles",
    parameters=(
        Parameter("tangential", "rad", "tilt along the circle of rotors", -0.5, 0.5, lambda _: Prior(0.05, 0.05)),
        Parameter("radial", "rad", "tilt outwards", -0.5, 0.5, lambda _: Prior(0.0, 0.05)),
    ),
    wrench=wrench,
    per_rotor=True,
    excitation=Excitation(
        (("rate",), DRIVE),
        measure="thrust_range",
        weak=0.05,
        enough=0.15,
        flight="climbs and descents: bob",
        manoeuvre="thrust steps in hover and slow yaw turns",
    ),
)
