"""Torque constant: the reaction torque of all rotors differs from the vehicle file's."""

from dataclasses import replace

from dynamics.effect import Effect, Environment, Parameter, Physics, Prior, Values
from dynamics.excitation import DRIVE, Excitation


def physics(body: Physics, p: Values, _: Environment, __: int | None) -> Physics:
    """k_tau times ratio on every rotor."""
    return replace(body, torque_constant=body.torque_constant * p["ratio"])


EFFECT = Effect(
    name="torque_constant",
    summary="Another torque constant than the vehicle file's",
    source="PI-TCN eq. 2",
    parameters=(
        Parameter("ratio", "1", "real k_tau over the file's", 0.2, 5.0, lambda _: Prior(1.2, 0.3), neutral=1.0),
    ),
    physics=physics,
    confounded_with=("inertia",),
    excitation=Excitation(
        (("rate",), DRIVE),
        measure="yaw_acceleration",
        weak=0.3,
        enough=1.0,
        flight="yaw_spin with quick starts",
        manoeuvre="yaw steps in both directions",
    ),
)
