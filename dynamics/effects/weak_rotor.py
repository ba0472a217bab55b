"""Weak rotor: one rotor thrusts less than the others at the same speed (a damaged propeller)."""

from dataclasses import replace

import casadi as ca

from dynamics.effect import Effect, Environment, Parameter, Physics, Prior, Values
from dynamics.excitation import DRIVE, Excitation


def physics(body: Physics, p: Values, _: Environment, rotor: int | None) -> Physics:
    """k_f of one rotor times (1 - loss); its reaction torque stays."""
    share = ca.SX.ones(body.rotor_count)
    share[rotor or 0] = 1 - p["loss"]
    return replace(body, thrust_constant=body.thrust_constant * share)


EFFECT = Effect(
    name="weak_rotor",
    summary="One rotor gives less thrust",
    source="PI-TCN eq. 2 with one thrust constant changed",
    parameters=(Parameter("loss", "1", "share of thrust lost", 0.0, 0.9, lambda _: Prior(0.1, 0.1)),),
    physics=physics,
    per_rotor=True,
    confounded_with=("centre_of_mass",),
    excitation=Excitation(
        (("rate",), DRIVE),
        measure="duration",
        weak=5.0,
        enough=15.0,
        flight="hover",
        manoeuvre="thrust steps in hover, then the same with the payload moved",
    ),
)
