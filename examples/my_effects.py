"""An effect of your own: alula diagnose LOG... --vehicle V.toml --effects examples/my_effects.py

One file, one `EFFECT` (or a list of them, `EFFECTS`). Write the formula once, in CasADi; the mock, diagnosis and the
controller all use it from here. This one is a tether that pulls the vehicle towards the origin like a spring.
"""

import casadi as ca

from dynamics import quaternion
from dynamics.effect import Conditions, Effect, Parameter, Prior, Values, Wrench


def wrench(c: Conditions, p: Values, _: Values) -> Wrench:
    """F = -stiffness (x, y, 0) in world axes, turned into body axes; no moment."""
    pull = -p["stiffness"] * ca.vertcat(c.position[0:2], 0)
    return Wrench(quaternion.rotate_inverse(c.attitude, pull), ca.SX.zeros(3))


EFFECT = Effect(
    name="tether",
    summary="A spring that pulls towards the origin",
    source="Hooke's law",
    parameters=(
        # name, unit, meaning, least and greatest value, usual value with its standard deviation; it vanishes at 0
        Parameter("stiffness", "N/m", "pull per metre of distance", 0.0, 10.0, lambda _: Prior(0.05, 0.1)),
    ),
    wrench=wrench,
)
