"""Steady wind: the air moves over the ground at a constant velocity.

The wind acts through the drag effects of the model. In a model without drag it would have no effect, so it has a drag
coefficient of its own there; a flight shows only the product of the two.
"""

from collections.abc import Sequence

from dynamics import quaternion
from dynamics import symbolic as ca
from dynamics.effect import Conditions, Effect, Expression, Parameter, Prior, Span, Values, Wrench
from dynamics.effects import rotor_drag
from dynamics.excitation import FORCE, POSE, Excitation
from dynamics.vehicle import EffectUse, Vehicle

COEFFICIENT = Parameter(
    "coefficient",
    "N s^2/(rad m)",
    "rotor drag through which the wind acts when the model has no drag effect",
    0.0,
    1e-2,
    rotor_drag.usual,
)


def push(c: Conditions, p: Values, wind_world: Expression) -> Wrench:
    """F = coefficient sum_i Omega_i w_xy, the rotor drag of the moving air alone; none where a drag effect feels it."""
    none = ca.SX.zeros(3)
    if c.has_drag:
        return Wrench(none, none)
    wind_body = quaternion.rotate_inverse(c.attitude, wind_world)
    force = p["coefficient"] * ca.sum1(c.rotor_speed) * ca.vertcat(wind_body[0:2], 0)
    return Wrench(force, none)


def wind(p: Values, _: Values) -> Expression:
    """The wind's velocity, world ENU, m/s."""
    return ca.vertcat(p["x"], p["y"], p["z"])


def wrench(c: Conditions, p: Values, hidden: Values) -> Wrench:
    """The wind's own push where no drag effect of the model feels the air."""
    return push(c, p, wind(p, hidden))


def grid(vehicle: Vehicle, _: Span) -> Sequence[dict[str, float]]:
    """Level wind through a usual drag: without a drag in the model only the product of the two shows."""
    return [{"z": 0.0, "coefficient": rotor_drag.usual(vehicle).mean}]


EFFECT = Effect(
    name="wind",
    summary="Steady wind, felt through drag",
    source="rotor drag of the relative air, Faessler et al., RA-L 2018",
    parameters=(
        Parameter("x", "m/s", "air velocity to the east", -30.0, 30.0, lambda _: Prior(2.0, 3.0)),
        Parameter("y", "m/s", "air velocity to the north", -30.0, 30.0, lambda _: Prior(0.0, 3.0)),
        Parameter("z", "m/s", "air velocity upwards", -10.0, 10.0, lambda _: Prior(0.0, 1.0)),
        COEFFICIENT,
    ),
    wind=wind,
    wrench=wrench,
    grid=grid,
    caveat="in a model without drag only velocity x coefficient shows: the coefficient is that of a usual rotor drag",
    followed=True,
    excitation=Excitation(
        (FORCE, *POSE),
        measure="duration",
        weak=20.0,
        enough=60.0,
        flight="hover and slow circles for a minute",
        manoeuvre="hover with the nose turned to four directions, and known drag in the vehicle file",
    ),
)


def steady_wind(east: float, north: float, up: float) -> EffectUse:
    """This wind with a velocity, world ENU, m/s."""
    return EffectUse(EFFECT.name, {"x": east, "y": north, "z": up})
