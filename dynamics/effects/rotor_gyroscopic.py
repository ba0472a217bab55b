"""Rotor gyroscopics: spinning rotors resist tilting, and twist the body when they speed up."""

from dynamics import symbolic as ca
from dynamics.effect import Conditions, Effect, Parameter, Prior, Values, Wrench
from dynamics.excitation import DRIVE, Excitation
from dynamics.vehicle import Vehicle


def usual(vehicle: Vehicle) -> Prior:
    """A thousandth of the vehicle's yaw inertia a rotor."""
    return Prior(1e-3 * vehicle.body.inertia[2], 1e-3 * vehicle.body.inertia[2])


def wrench(c: Conditions, p: Values, _: Values) -> Wrench:
    """M = -omega x H - dH/dt with H = -inertia sum_i spin_i Omega_i e_z.

    A rotor turns against the reaction torque that it exerts on the body, hence the sign of H.
    """
    momentum = -p["inertia"] * ca.dot(c.physics.spin, c.rotor_speed)
    spin_up = p["inertia"] * ca.dot(c.physics.spin, c.rotor_acceleration)
    moment = ca.vertcat(-c.rate_body[1] * momentum, c.rate_body[0] * momentum, spin_up)
    return Wrench(ca.SX.zeros(3), moment)


EFFECT = Effect(
    name="rotor_gyroscopic",
    summary="Gyroscopic and spin-up moments of the rotors",
    source="Bouabdallah, Design and control of quadrotors, EPFL 2007, eq. 2.30",
    parameters=(Parameter("inertia", "kg m^2", "of a rotor about its axis", 0.0, 1e-2, usual),),
    wrench=wrench,
    excitation=Excitation(
        (("rate",), DRIVE),
        measure="tilting_rate",
        weak=0.8,
        enough=2.0,
        flight="quick rolls while yawing",
        manoeuvre="fast rolls and pitches during strong yaw accelerations",
    ),
)
