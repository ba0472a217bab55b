"""Linear drag: the body's drag at low speed, in proportion to airspeed and alike in all directions."""

from dynamics import symbolic as ca
from dynamics.effect import Conditions, Effect, Parameter, Prior, Values, Wrench
from dynamics.excitation import FORCE, POSE, Excitation
from dynamics.vehicle import Vehicle


def usual(vehicle: Vehicle) -> Prior:
    """A damping of 0.2 1/s."""
    return Prior(0.2 * vehicle.body.mass, 0.2 * vehicle.body.mass)


def wrench(c: Conditions, p: Values, _: Values) -> Wrench:
    """F = -coefficient v in the relative air, at the centre of mass."""
    return Wrench(-p["coefficient"] * c.air_velocity_body, ca.SX.zeros(3))


EFFECT = Effect(
    name="linear_drag",
    summary="Drag of the body, linear in airspeed",
    source="Hattenberger et al., Evaluation of drag coefficient for a quadrotor model, IJMAV 2022",
    parameters=(Parameter("coefficient", "N s/m", "force per airspeed", 0.0, 20.0, usual),),
    wrench=wrench,
    resists_air=True,
    excitation=Excitation(
        (FORCE, *POSE),
        measure="lateral_speed",
        weak=0.3,
        enough=1.0,
        flight="straight lines and circles",
        manoeuvre="straight accelerations to top speed and back along both axes, level and vertical",
    ),
)
