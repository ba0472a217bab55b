"""Ground effect: rotors lift more close to the ground."""

from collections.abc import Sequence

from dynamics import quaternion
from dynamics import symbolic as ca
from dynamics.effect import Conditions, Effect, Parameter, Prior, Span, Values, Wrench
from dynamics.excitation import FORCE, WRENCH, Excitation
from dynamics.vehicle import Vehicle


def usual_radius(vehicle: Vehicle) -> Prior:
    """The propeller's radius; that of rotors which help each other is larger."""
    return Prior(vehicle.rotors.disc_radius, 0.5 * vehicle.rotors.disc_radius)


def wrench(c: Conditions, p: Values, _: Values) -> Wrench:
    """T_i grows by gain (1 / (1 - (radius / 4 h_i)^2) - 1), h_i the height of rotor i.

    Below half a radius of height the formula is held at its value there: it has a pole under the ground.
    """
    force, moment = ca.SX.zeros(3), ca.SX.zeros(3)
    for i in range(c.physics.rotor_count):
        height = c.position[2] + quaternion.rotate(c.attitude, c.rotor_position[:, i])[2] - c.environment.ground_height
        ratio = p["radius"] / (4 * ca.fmax(height, 0.5 * p["radius"]))
        lift = ca.vertcat(0, 0, p["gain"] * c.rotor_thrust[i] * (1 / (1 - ratio**2) - 1))
        force, moment = force + lift, moment + ca.cross(c.rotor_position[:, i], lift)
    return Wrench(force, moment)


def grid(vehicle: Vehicle, _: Span) -> Sequence[dict[str, float]]:
    """Effective radii from 0.7 to 3 times the propeller's: the rotors of a vehicle help each other."""
    return [{"radius": ratio * vehicle.rotors.disc_radius} for ratio in (0.7, 1.0, 1.5, 2.0, 3.0)]


EFFECT = Effect(
    name="ground_effect",
    summary="More thrust close to the ground",
    source="Cheeseman and Bennett, ARC R&M 3021, 1955; Sanchez-Cuevas et al., IJAE 2017",
    parameters=(
        Parameter("gain", "1", "strength; 1 for a lone rotor", 0.0, 20.0, lambda _: Prior(1.0, 1.0)),
        Parameter("radius", "m", "effective rotor radius", 0.005, 2.0, usual_radius, neutral=0.1),
    ),
    wrench=wrench,
    grid=grid,
    assumed=("radius",),
    caveat="gain and radius cannot be told apart: high above the ground only gain x radius^2 shows, here "
    "{gain:.3g} x ({radius:.3g} m)^2; the radius is assumed from the propeller's, to within half of it",
    excitation=Excitation(
        (("position",), FORCE, WRENCH),
        measure="low_flight",
        weak=2.0,
        enough=10.0,
        flight="low_flight",
        manoeuvre="low passes between 0.1 and 1 m above flat ground",
    ),
)
