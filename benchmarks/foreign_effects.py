"""Forces and moments that no effect of the catalogue makes, to see whether diagnosis says so."""

from __future__ import annotations

import math
from collections.abc import Callable

import casadi as ca

from dynamics import quaternion
from dynamics.effect import Conditions, Effect, Expression, Hidden, Parameter, Prior, Values, Wrench

AMPLITUDE = Parameter("amplitude", "SI", "size", -1e3, 1e3, lambda _: Prior(1.0, 1.0))
LENGTH = 1.3  # m, over which the air's pattern repeats


def _nothing() -> Expression:
    return ca.SX.zeros(3)


def _clock(frequency: float) -> tuple[tuple[Hidden, ...], Callable[[Conditions, Values, Values, Values], Values]]:
    """Hidden states sine and cosine of a clock, Hz, and their derivative."""
    states = (Hidden("sine", "1", lambda _: 0.0), Hidden("cosine", "1", lambda _: 1.0))
    turning = 2 * math.pi * frequency

    def derivative(_: Conditions, __: Values, hidden: Values, ___: Values) -> Values:
        return {"sine": turning * hidden["cosine"], "cosine": -turning * hidden["sine"]}

    return states, derivative


def _made(name: str, summary: str, wrench: Callable[..., Wrench], frequency: float = 0.0) -> Effect:
    hidden, derivative = _clock(frequency) if frequency else ((), None)
    return Effect(name, summary, "made up", (AMPLITUDE,), hidden, wrench=wrench, derivative=derivative)


def shaking(_: Conditions, p: Values, hidden: Values) -> Wrench:
    """A vibration along body x and z."""
    return Wrench(p["amplitude"] * ca.vertcat(hidden["sine"], 0, 0.5 * hidden["cosine"]), _nothing())


def humming(_: Conditions, p: Values, hidden: Values) -> Wrench:
    """A torque at one frequency, roll and pitch."""
    return Wrench(_nothing(), p["amplitude"] * ca.vertcat(hidden["sine"], 0.6 * hidden["cosine"], 0))


def surging(c: Conditions, p: Values, hidden: Values) -> Wrench:
    """All thrust more and less by turns, in steps."""
    lift = p["amplitude"] * ca.sum1(c.rotor_thrust) * ca.tanh(20 * hidden["sine"])
    return Wrench(ca.vertcat(0, 0, lift), _nothing())


def swirling(c: Conditions, p: Values, _: Values) -> Wrench:
    """Standing air that pushes this way here and that way there."""
    x, y = (2 * math.pi / LENGTH * c.position[i] for i in (0, 1))
    push = p["amplitude"] * ca.vertcat(ca.sin(y), ca.sin(x + 1.0), 0)
    return Wrench(quaternion.rotate_inverse(c.attitude, push), _nothing())


def leaning(c: Conditions, p: Values, _: Values) -> Wrench:
    """A force by attitude times place."""
    up = quaternion.rotate_inverse(c.attitude, ca.vertcat(0, 0, 1))
    return Wrench(p["amplitude"] * ca.vertcat(up[0] * c.position[0], up[1] * c.position[1], 0), _nothing())


def sideways(c: Conditions, p: Values, _: Values) -> Wrench:
    """A lift across the direction of travel."""
    v = c.air_velocity_body
    return Wrench(p["amplitude"] * ca.vertcat(-v[1], v[0], 0), _nothing())


def curving(c: Conditions, p: Values, _: Values) -> Wrench:
    """A lift of the spinning body, rate x velocity."""
    return Wrench(p["amplitude"] * ca.cross(c.rate_body, c.air_velocity_body), _nothing())


def weathervaning(c: Conditions, p: Values, _: Values) -> Wrench:
    """A moment by the product of speeds along body x and y."""
    v = c.air_velocity_body
    return Wrench(_nothing(), p["amplitude"] * ca.vertcat(v[1] * v[2], -v[0] * v[2], v[0] * v[1]))


FOREIGN = {
    effect.name: effect
    for effect in (
        _made("shaking", "Vibration at 3.1 Hz", shaking, 3.1),
        _made("humming", "Torque at 4.3 Hz", humming, 4.3),
        _made("surging", "Thrust in steps", surging, 0.21),
        _made("swirling", "Standing swirl of the air", swirling),
        _made("leaning", "Force by attitude and place", leaning),
        _made("sideways", "Lift across the travel", sideways),
        _made("curving", "Lift of a spinning body", curving),
        _made("weathervaning", "Moment by products of speeds", weathervaning),
    )
}
