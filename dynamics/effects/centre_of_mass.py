"""Centre of mass: it is not where the vehicle file has it, so that thrust twists the body."""

from collections.abc import Sequence
from dataclasses import replace

from dynamics import symbolic as ca
from dynamics.effect import Effect, Environment, Expression, Parameter, Physics, Prior, Reading, Span, Values
from dynamics.excitation import DRIVE, Excitation
from dynamics.kinematics import lever_arm_acceleration
from dynamics.vehicle import Vehicle


def usual(vehicle: Vehicle) -> Prior:
    """A tenth of the mean arm."""
    arm = sum(abs(x) + abs(y) for x, y, _ in vehicle.rotors.position) / (2 * vehicle.rotors.count)
    return Prior(0.1 * arm, 0.1 * arm)


def level(vehicle: Vehicle) -> Prior:
    """Zero, with the same deviation: the usual offset is forward alone."""
    return Prior(0.0, usual(vehicle).std)


def physics(body: Physics, p: Values, _: Environment, __: int | None) -> Physics:
    """The centre of mass moves by (x, y, z); the state's position is that of the new centre."""
    return replace(body, centre_of_mass=body.centre_of_mass + _moved(p))


def measurement(reading: Reading, p: Values, _: int | None) -> Reading:
    """Accelerometer and pose stay where they were (sensors_stay 1), or are those of the new centre (0)."""
    arm = -p["sensors_stay"] * _moved(p)
    beyond = lever_arm_acceleration(arm, reading.rate_body, reading.angular_acceleration)
    return replace(reading, specific_force=reading.specific_force + beyond, pose_arm=reading.pose_arm + arm)


def _moved(p: Values) -> Expression:
    return ca.vertcat(p["x"], p["y"], p["z"])


def grid(_: Vehicle, __: Span) -> Sequence[dict[str, float]]:
    """At the vehicle file's height, with sensors that stay and with sensors at the new centre."""
    return [{"z": 0.0, "sensors_stay": stay} for stay in (1.0, 0.0)]


EFFECT = Effect(
    name="centre_of_mass",
    summary="Another centre of mass than the vehicle file's",
    source="PI-TCN eq. 2 with rotor arms taken from the centre of mass",
    parameters=(
        Parameter("x", "m", "forward", -0.5, 0.5, usual),
        Parameter("y", "m", "to the left", -0.5, 0.5, level),
        Parameter("z", "m", "upwards", -0.5, 0.5, level),
        Parameter(
            "sensors_stay",
            "1",
            "1: accelerometer and pose keep their places; 0: they are those of the new centre",
            0.0,
            1.0,
            lambda _: Prior(1.0, 0.5),
        ),
    ),
    physics=physics,
    measurement=measurement,
    grid=grid,
    confounded_with=("weak_rotor",),
    excitation=Excitation(
        (("rate",), DRIVE),
        measure="thrust_range",
        weak=0.05,
        enough=0.15,
        flight="climbs and descents: bob",
        manoeuvre="thrust steps in hover, then the same with swapped propellers",
    ),
)
