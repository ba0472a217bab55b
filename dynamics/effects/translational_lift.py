"""Translational lift: a rotor in crossing air works on more air and thrusts more."""

from dynamics import symbolic as ca
from dynamics.effect import Conditions, Effect, Parameter, Prior, Values, Wrench
from dynamics.excitation import FORCE, POSE, WRENCH, Excitation
from dynamics.vehicle import Vehicle


def usual(vehicle: Vehicle) -> Prior:
    """Five per cent of the weight at 5 m/s."""
    mean = 0.05 * vehicle.weight / (25.0 * vehicle.rotors.count)
    return Prior(mean, mean)


def wrench(c: Conditions, p: Values, _: Values) -> Wrench:
    """F_z = coefficient sum_i |v_xy,i|^2 at the rotor hubs, moments included."""
    force, moment = ca.SX.zeros(3), ca.SX.zeros(3)
    for i in range(c.physics.rotor_count):
        lift = ca.vertcat(0, 0, p["coefficient"] * ca.sumsqr(c.rotor_air_velocity[0:2, i]))
        force, moment = force + lift, moment + ca.cross(c.rotor_position[:, i], lift)
    return Wrench(force, moment)


EFFECT = Effect(
    name="translational_lift",
    summary="More thrust in crossing air",
    source="momentum theory of forward flight linearised about hover; Leishman, Principles of Helicopter Aerodynamics",
    parameters=(Parameter("coefficient", "N s^2/m^2", "thrust per crossing airspeed squared", 0.0, 1.0, usual),),
    wrench=wrench,
    excitation=Excitation(
        (FORCE, *POSE, WRENCH),
        measure="lateral_speed",
        weak=1.0,
        enough=2.0,
        flight="fast level flight: circle, line",
        manoeuvre="level flight at several speeds",
    ),
)
