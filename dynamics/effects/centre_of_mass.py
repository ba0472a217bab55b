"""Centre of mass: it is not where the vehicle file has it, so that thrust twists the body."""

from collections.abc import Sequence
from dataclasses import replace

import casadi as ca

from dynamics.effect import Effect, Environment, Parameter, Physics, Prior, Span, Values
from dynamics.excitation import DRIVE, Excitation
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
    return replace(body, centre_of_mass=body.centre_of_mass + ca.vertcat(p["x"], p["y"], p["z"]))


def grid(_: Vehicle, __: Span) -> Sequence[dict[str, float]]:
    """At the vehicle file's height."""
    return [{"z": 0.0}]


EFFECT = Effect(
    name="centre_of_mass",
    summary="Another centre of mass than the vehicle file's",
    source="PI-TCN eq. 2 with rotor arms taken from the centre of mass",
    parameters=(
        Parameter("x", "m", "forward", -0.5, 0.5, usual),
        Parameter("y", "m", "to the left", -0.5, 0.5, level),
        Parameter("z", "m", "upwards", -0.5, 0.5, level),
    ),
    physics=physics,
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
