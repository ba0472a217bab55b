"""Blade flapping: rotors tilt in crossing air and twist the body."""

from dynamics import symbolic as ca
from dynamics.effect import Conditions, Effect, Parameter, Prior, Values, Wrench
from dynamics.excitation import DRIVE, POSE, Excitation
from dynamics.vehicle import Vehicle


def usual(vehicle: Vehicle) -> Prior:
    """An angular acceleration of 1 rad/s^2 at 1 m/s in hover; negative on the vehicles it was measured on."""
    size = vehicle.body.inertia[0] / (vehicle.rotors.count * vehicle.hover_speed)
    return Prior(-size, 2 * size)


def wrench(c: Conditions, p: Values, _: Values) -> Wrench:
    """M = coefficient sum_i Omega_i (-v_y,i, v_x,i, 0).

    Flapping proper tilts the rotors back and raises the nose in forward flight: the coefficient is negative. So is
    that of drag at a height h above the centre of mass, -c h with rotor_drag's c, which has the same regressor; drag
    below it is positive (docs/effects.md).
    """
    moment = ca.SX.zeros(3)
    for i in range(c.physics.rotor_count):
        across = ca.vertcat(-c.rotor_air_velocity[1, i], c.rotor_air_velocity[0, i], 0)
        moment = moment + p["coefficient"] * c.rotor_speed[i] * across
    return Wrench(ca.SX.zeros(3), moment)


EFFECT = Effect(
    name="blade_flapping",
    summary="Pitching and rolling moment of the rotors in crossing air",
    source="Mahony, Kumar, Corke, IEEE RAM 2012; Hoffmann et al., Quadrotor helicopter flight dynamics, AIAA 2007",
    parameters=(
        Parameter("coefficient", "N s^2/rad", "moment per rotor speed and crossing airspeed", -1e-3, 1e-3, usual),
    ),
    wrench=wrench,
    caveat="drag that acts above the centre of mass, where the vehicle file has the rotors too low, is the same moment",
    excitation=Excitation(
        (("rate",), *POSE, DRIVE),
        measure="lateral_speed",
        weak=0.5,
        enough=1.5,
        flight="aggressive level flight: Lemniscate",
        manoeuvre="aggressive horizontal accelerations along both axes",
    ),
)
