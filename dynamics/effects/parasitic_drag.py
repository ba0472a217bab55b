"""Parasitic drag: the body's drag, quadratic in airspeed."""

from dynamics import symbolic as ca
from dynamics.effect import Conditions, Effect, Parameter, Prior, Values, Wrench
from dynamics.excitation import FORCE, POSE, Excitation
from dynamics.vehicle import Vehicle


def usual(vehicle: Vehicle) -> Prior:
    """A tenth of the weight at 5 m/s."""
    mean = 0.1 * vehicle.weight / 25.0
    return Prior(mean, mean)


def wrench(c: Conditions, p: Values, _: Values) -> Wrench:
    """F = -coefficient |v| v in the relative air, at the centre of mass."""
    speed = ca.sqrt(ca.sumsqr(c.air_velocity_body) + 1e-12)  # differentiable at rest
    return Wrench(-p["coefficient"] * speed * c.air_velocity_body, ca.SX.zeros(3))


EFFECT = Effect(
    name="parasitic_drag",
    summary="Drag of the body, quadratic in airspeed",
    source="Hoerner, Fluid-Dynamic Drag, 1965; Hattenberger et al., IJMAV 2022",
    parameters=(Parameter("coefficient", "N s^2/m^2", "half of air density x drag area", 0.0, 5.0, usual),),
    wrench=wrench,
    resists_air=True,
    followed=True,
    excitation=Excitation(
        (FORCE, *POSE),
        measure="speed",
        weak=2.0,
        enough=4.0,
        flight="straight accelerations to full speed: line:size=2",
        manoeuvre="straight accelerations to top speed and back along both axes",
    ),
)
