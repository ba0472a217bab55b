"""Weak rotor: one rotor thrusts less than the others at the same speed (a damaged propeller)."""

from dataclasses import replace

from dynamics import symbolic as ca
from dynamics.effect import Effect, Environment, Expression, Parameter, Physics, Prior, Values
from dynamics.excitation import DRIVE, Excitation


def physics(body: Physics, p: Values, _: Environment, rotor: int | None) -> Physics:
    """k_f of one rotor times (1 - loss), its k_tau times (1 - torque_loss)."""

    def share(loss: Expression) -> Expression:
        factor = ca.SX.ones(body.rotor_count)
        factor[rotor or 0] = 1 - loss
        return factor

    return replace(
        body,
        thrust_constant=body.thrust_constant * share(p["loss"]),
        torque_constant=body.torque_constant * share(p["torque_loss"]),
    )


EFFECT = Effect(
    name="weak_rotor",
    summary="One rotor gives less thrust",
    source="PI-TCN eq. 2 with the thrust and torque constants of one rotor changed",
    parameters=(
        Parameter("loss", "1", "share of thrust lost", 0.0, 0.9, lambda _: Prior(0.1, 0.1)),
        # a broken blade is dragged less, a bent one more; zero by default, as before it was a parameter
        Parameter("torque_loss", "1", "share of reaction torque lost", -0.9, 0.9, lambda _: Prior(0.0, 0.1)),
    ),
    physics=physics,
    per_rotor=True,
    lost_thrust="loss",
    caveat="equal losses of thrust and torque are also what a speed sensor shows that reads too high",
    confounded_with=("centre_of_mass", "rotor_speed_fault"),
    excitation=Excitation(
        (("rate",), DRIVE),
        measure="duration",
        weak=5.0,
        enough=15.0,
        flight="hover",
        manoeuvre="thrust steps in hover, then the same with the payload moved and with the propellers exchanged",
    ),
)
