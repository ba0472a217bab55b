"""Axial inflow: a rotor that climbs through the air thrusts less, one that sinks thrusts more."""

from dynamics import symbolic as ca
from dynamics.effect import Conditions, Effect, Parameter, Prior, Values, Wrench
from dynamics.excitation import FORCE, POSE, WRENCH, Excitation
from dynamics.vehicle import Vehicle


def usual(vehicle: Vehicle) -> Prior:
    """A vertical damping of 0.4 1/s in hover."""
    mean = 0.4 * vehicle.body.mass / (vehicle.rotors.count * vehicle.hover_speed)
    return Prior(mean, mean)


def wrench(c: Conditions, p: Values, _: Values) -> Wrench:
    """F_z = -coefficient sum_i Omega_i v_z,i at the rotor hubs, moments included."""
    force, moment = ca.SX.zeros(3), ca.SX.zeros(3)
    for i in range(c.physics.rotor_count):
        loss = ca.vertcat(0, 0, -p["coefficient"] * c.rotor_speed[i] * c.rotor_air_velocity[2, i])
        force, moment = force + loss, moment + ca.cross(c.rotor_position[:, i], loss)
    return Wrench(force, moment)


EFFECT = Effect(
    name="axial_inflow",
    summary="Thrust changes with the air's speed along the rotor axis",
    source="momentum theory linearised about hover; Powers et al., ISER 2013",
    parameters=(
        Parameter("coefficient", "N s^2/(rad m)", "thrust lost per rotor speed and climb speed", 0.0, 1e-2, usual),
    ),
    wrench=wrench,
    excitation=Excitation(
        (FORCE, *POSE, WRENCH),
        measure="climb_speed",
        weak=0.3,
        enough=0.8,
        flight="climbs and descents: bob, Parabola",
        manoeuvre="fast climbs and descents without tilt",
    ),
)
