"""Thrust exponent: thrust and reaction torque do not grow with the square of the rotor's speed."""

from dynamics import symbolic as ca
from dynamics.effect import Conditions, Effect, Expression, Parameter, Prior, Values, Wrench
from dynamics.excitation import FORCE, WRENCH, Excitation
from dynamics.vehicle import GRAVITY

MIN_RATIO = 1e-3  # of a rotor's speed over that of hover: the power of a rotor at rest has no slope


def wrench(c: Conditions, p: Values, _: Values) -> Wrench:
    """T_i = k_f Omega_h^2 (Omega_i / Omega_h)^exponent, with Omega_h the speed at which the rotors carry the weight.

    The reaction torque has k_tau and torque_exponent in their places.
    """
    force, moment = ca.SX.zeros(3), ca.SX.zeros(3)
    hover = ca.sqrt(c.physics.mass * GRAVITY / ca.sum1(c.physics.thrust_constant))
    for i in range(c.physics.rotor_count):
        ratio = ca.fmax(c.rotor_speed[i] / hover, MIN_RATIO)
        lift = ca.vertcat(0, 0, c.rotor_thrust[i] * _change(ratio, p["exponent"]))
        reaction = c.physics.spin[i] * c.physics.torque_constant[i] * c.rotor_speed[i] ** 2
        twist = ca.vertcat(0, 0, reaction * _change(ratio, p["torque_exponent"]))
        force, moment = force + lift, moment + ca.cross(c.rotor_position[:, i], lift) + twist
    return Wrench(force, moment)


def _change(ratio: Expression, exponent: Expression) -> Expression:
    """Relative change of the square of a ratio by another exponent."""
    return ca.exp((exponent - 2) * ca.log(ratio)) - 1


EFFECT = Effect(
    name="thrust_exponent",
    summary="Thrust grows with another power of rotor speed than the square",
    source="Reynolds number of small propellers; Deters, Ananda, Selig, AIAA 2014-2151",
    parameters=(
        Parameter(
            "exponent", "1", "power of the rotor speed in its thrust", 1.0, 3.0, lambda _: Prior(1.9, 0.2), neutral=2.0
        ),
        Parameter(
            "torque_exponent",
            "1",
            "power of the rotor speed in its reaction torque",
            0.0,
            4.0,
            lambda _: Prior(2.0, 0.2),
            neutral=2.0,
        ),
    ),
    wrench=wrench,
    acts_on="command_gain",
    confounded_with=("thrust_constant",),
    excitation=Excitation(
        (FORCE, WRENCH),
        measure="thrust_range",
        weak=0.1,
        enough=0.3,
        flight="climbs and descents: bob",
        manoeuvre="thrust steps from half to twice the weight",
    ),
)
