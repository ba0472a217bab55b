"""Thrust constant: the thrust of all rotors differs from the vehicle file's."""

from dataclasses import replace

from dynamics.effect import Effect, Environment, Parameter, Physics, Prior, Values
from dynamics.excitation import FORCE, WRENCH, Excitation


def physics(body: Physics, p: Values, _: Environment, __: int | None) -> Physics:
    """k_f times ratio on every rotor."""
    return replace(body, thrust_constant=body.thrust_constant * p["ratio"])


EFFECT = Effect(
    name="thrust_constant",
    summary="Another thrust constant than the vehicle file's",
    source="PI-TCN eq. 2",
    parameters=(
        Parameter("ratio", "1", "real k_f over the file's", 0.3, 3.0, lambda _: Prior(0.92, 0.15), neutral=1.0),
    ),
    physics=physics,
    acts_on="command_gain",
    confounded_with=("mass",),
    excitation=Excitation(
        (FORCE, WRENCH),
        measure="duration",
        weak=5.0,
        enough=15.0,
        flight="hover",
        manoeuvre="fast rolls and pitches: a wrong thrust constant also shows in torque, a wrong mass does not",
    ),
)
