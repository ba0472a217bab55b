"""Wall effect: a nearby wall pulls or pushes the vehicle."""

import math
from collections.abc import Sequence

from dynamics import quaternion
from dynamics import symbolic as ca
from dynamics.effect import Conditions, Effect, Parameter, Prior, Span, Values, Wrench
from dynamics.excitation import FORCE, Excitation
from dynamics.vehicle import Vehicle

HEADINGS = (0.0, math.pi / 2, math.pi, -math.pi / 2)
SCALES = (0.14, 0.22, 0.33, 0.5)


def wrench(c: Conditions, p: Values, _: Values) -> Wrench:
    """F = gain T exp((n . position - distance) / scale) n, n the horizontal direction towards the wall.

    T is the thrust of all rotors. Behind the wall the formula is held at its value there.
    """
    towards = ca.vertcat(ca.cos(p["heading"]), ca.sin(p["heading"]), 0)
    gap = ca.fmax(p["distance"] - ca.dot(towards, c.position), 0)
    force = p["gain"] * ca.sum1(c.rotor_thrust) * ca.exp(-gap / p["scale"]) * towards
    return Wrench(quaternion.rotate_inverse(c.attitude, force), ca.SX.zeros(3))


def grid(_: Vehicle, span: Span) -> Sequence[dict[str, float]]:
    """A wall at the boundary of the flights' box, in each of the four directions of the axes."""
    distances = (span.highest[0], span.highest[1], -span.lowest[0], -span.lowest[1])
    return [
        {"heading": heading, "distance": distance, "scale": scale}
        for heading, distance in zip(HEADINGS, distances, strict=True)
        for scale in SCALES
    ]


EFFECT = Effect(
    name="wall_effect",
    summary="Sideways force close to a wall",
    source="exponential fit to Robinson, Chung, Ryan, Numerical investigation of wall effect on a quadrotor, 2014",
    parameters=(
        Parameter("gain", "1", "force over thrust at the wall; positive pulls", -1.0, 1.0, lambda _: Prior(-0.05, 0.1)),
        Parameter(
            "heading", "rad", "direction of the wall from east", -math.pi, math.pi, lambda _: Prior(0.0, 2.0), 0.0
        ),
        Parameter("distance", "m", "of the wall from the origin", -1e3, 1e3, lambda _: Prior(2.0, 2.0), 0.0),
        Parameter("scale", "m", "distance over which the force fades to 37 %", 0.05, 5.0, lambda _: Prior(0.3, 0.2), 1),
    ),
    wrench=wrench,
    grid=grid,
    refine=("scale",),
    excitation=Excitation(
        (("position",), FORCE),
        unlogged="where walls are",
        flight="slow passes along the wall",
        manoeuvre="slow passes at several distances from each wall",
    ),
)
