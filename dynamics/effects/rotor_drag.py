"""Rotor drag: the in-plane H-force of every rotor, linear in its speed and in the air that crosses it."""

from dynamics import symbolic as ca
from dynamics.effect import Conditions, Effect, Parameter, Prior, Values, Wrench
from dynamics.excitation import DRIVE, FORCE, POSE, Excitation
from dynamics.vehicle import Vehicle


def usual(vehicle: Vehicle) -> Prior:
    """A lateral drag of 0.3 1/s in hover, as measured on small quadrotors."""
    mean = 0.3 * vehicle.body.mass / (vehicle.rotors.count * vehicle.hover_speed)
    return Prior(mean, mean)


def wrench(c: Conditions, p: Values, _: Values) -> Wrench:
    """F = -coefficient sum_i Omega_i v_xy,i at the rotor hubs, moments included."""
    force, moment = ca.SX.zeros(3), ca.SX.zeros(3)
    for i in range(c.physics.rotor_count):
        crossing = ca.vertcat(c.rotor_air_velocity[0:2, i], 0)
        drag = -p["coefficient"] * c.rotor_speed[i] * crossing
        force, moment = force + drag, moment + ca.cross(c.rotor_position[:, i], drag)
    return Wrench(force, moment)


EFFECT = Effect(
    name="rotor_drag",
    summary="In-plane drag of the rotors, linear in rotor speed and airspeed",
    source="Svacha et al., ICUAS 2017; Faessler et al., RA-L 2018; Gazebo rotorDragCoefficient",
    parameters=(
        Parameter(
            "coefficient", "N s^2/(rad m)", "force per rotor speed and per airspeed across the rotor", 0.0, 1e-2, usual
        ),
    ),
    wrench=wrench,
    resists_air=True,
    followed=True,
    excitation=Excitation(
        (FORCE, *POSE, DRIVE),
        measure="lateral_speed",
        weak=0.3,
        enough=1.0,
        flight="yaw spins while flying sideways, fast circles",
        manoeuvre="yaw spins while flying circles at 2 to 4 m/s",
    ),
)
