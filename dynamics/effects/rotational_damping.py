"""Rotational damping: the air brakes the body's turning."""

from dynamics import symbolic as ca
from dynamics.effect import Conditions, Effect, Parameter, Prior, Values, Wrench
from dynamics.excitation import DRIVE, QUICK_TURNS, Excitation
from dynamics.vehicle import Vehicle


def usual(vehicle: Vehicle) -> Prior:
    """A damping of 1 1/s about the roll axis."""
    return Prior(vehicle.body.inertia[0], vehicle.body.inertia[0])


def wrench(c: Conditions, p: Values, _: Values) -> Wrench:
    """M = -coefficient omega."""
    return Wrench(ca.SX.zeros(3), -p["coefficient"] * c.rate_body)


EFFECT = Effect(
    name="rotational_damping",
    summary="Moment against the body rates",
    source="Etkin and Reid, Dynamics of Flight, 1996 (rate derivatives); SIH_KDW of PX4's simulator",
    parameters=(Parameter("coefficient", "N m s/rad", "moment per body rate", 0.0, 1.0, usual),),
    wrench=wrench,
    excitation=Excitation(
        (("rate",), DRIVE),
        measure="tilting_rate",
        weak=0.3,
        enough=1.0,
        flight=QUICK_TURNS,
        manoeuvre="fast rolls, pitches and yaw turns without travelling",
    ),
)
