"""Mass: the vehicle is heavier or lighter than in its file."""

from dataclasses import replace

from dynamics.effect import Effect, Environment, Parameter, Physics, Prior, Values
from dynamics.excitation import FORCE, WRENCH, Excitation


def physics(body: Physics, p: Values, _: Environment, __: int | None) -> Physics:
    """The mass times ratio; the inertia keeps its value."""
    return replace(body, mass=body.mass * p["ratio"])


EFFECT = Effect(
    name="mass",
    summary="Another mass than the vehicle file's",
    source="PI-TCN eq. 1",
    parameters=(
        Parameter("ratio", "1", "real mass over the file's", 0.3, 3.0, lambda _: Prior(1.1, 0.15), neutral=1.0),
    ),
    physics=physics,
    acts_on="weight",
    confounded_with=("thrust_constant",),
    excitation=Excitation(
        (FORCE, WRENCH),
        measure="duration",
        weak=5.0,
        enough=15.0,
        flight="hover",
        manoeuvre="fast rolls and pitches, and the vehicle on a scale",
    ),
)
