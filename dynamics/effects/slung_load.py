"""Slung load: a weight that swings on a line below the centre of mass."""

from collections.abc import Sequence

import numpy as np

from dynamics import quaternion
from dynamics import symbolic as ca
from dynamics.effect import Conditions, Effect, Expression, Hidden, Parameter, Prior, Span, Values, Wrench
from dynamics.excitation import FORCE, Excitation
from dynamics.vehicle import Vehicle

AXES = ("x", "y", "z")
AIR_DAMPING = 0.1  # 1/s, of the swing
START_TILT, START_SWING = 0.3, 1.5  # 1 and 1/s, of a load that swings when a log starts


def derivative(c: Conditions, p: Values, hidden: Values, _: Values) -> Values:
    """L d'' = -f_perp - L |d'|^2 d - damping L d', d the unit vector from vehicle to load, world.

    f is the rotors' specific force: the attachment's acceleration less gravity and less the line's own pull. Length of
    the line's state and the part of the swing's that lies along d mean nothing: neither turns d.
    """
    line, swing = _raw(hidden)
    d, d_dot = _line(hidden)
    f = _specific_force(c)
    f_perp = f - ca.dot(f, d) * d
    d_ddot = -f_perp / p["length"] - ca.sumsqr(d_dot) * d - AIR_DAMPING * d_dot
    turned, changed = ca.norm_2(line) * d_dot, d_ddot + ca.dot(swing, d) * d_dot
    return {f"line_{axis}": turned[i] for i, axis in enumerate(AXES)} | {
        f"swing_{axis}": changed[i] for i, axis in enumerate(AXES)
    }


def wrench(c: Conditions, p: Values, hidden: Values) -> Wrench:
    """F = T d with T (1 + m_load / m) = m_load (L |d'|^2 - d . f); a slack line does not push."""
    d, d_dot = _line(hidden)
    pull = p["length"] * ca.sumsqr(d_dot) - ca.dot(d, _specific_force(c))
    tension = p["mass"] * ca.fmax(pull, 0) / (1 + p["mass"] / c.physics.mass)
    return Wrench(quaternion.rotate_inverse(c.attitude, tension * d), ca.SX.zeros(3))


def grid(_: Vehicle, __: Span) -> Sequence[dict[str, float]]:
    """Lines of 0.2 to 1.2 m."""
    return [{"length": float(length)} for length in np.geomspace(0.2, 1.2, 8)]


def _line(hidden: Values) -> tuple[Expression, Expression]:
    """d and d': the unit vector along the line, and its rate of change."""
    line, swing = _raw(hidden)
    d = line / ca.norm_2(line)
    return d, swing - ca.dot(swing, d) * d


def _raw(hidden: Values) -> tuple[Expression, Expression]:
    """The states of line and swing."""
    line, swing = (ca.vertcat(*[hidden[f"{name}_{axis}"] for axis in AXES]) for name in ("line", "swing"))
    return line, swing


def _specific_force(c: Conditions) -> Expression:
    return quaternion.rotate(c.attitude, ca.vertcat(0, 0, ca.sum1(c.rotor_thrust) / c.physics.mass))


EFFECT = Effect(
    name="slung_load",
    summary="A weight swinging on a line",
    source="Sreenath, Lee, Kumar, Geometric control of a quadrotor with a cable-suspended load, CDC 2013, eq. 1-5",
    parameters=(
        Parameter("mass", "kg", "of the load", 0.0, 20.0, lambda v: Prior(0.1 * v.body.mass, 0.1 * v.body.mass)),
        Parameter("length", "m", "of the line", 0.05, 20.0, lambda _: Prior(0.5, 0.3), neutral=0.5),
    ),
    hidden=(
        Hidden("line_x", "1", lambda _: 0.0, start_std=START_TILT),
        Hidden("line_y", "1", lambda _: 0.0, start_std=START_TILT),
        Hidden("line_z", "1", lambda _: -1.0),
        Hidden("swing_x", "1/s", lambda _: 0.0, start_std=START_SWING),
        Hidden("swing_y", "1/s", lambda _: 0.0, start_std=START_SWING),
        Hidden("swing_z", "1/s", lambda _: 0.0),
    ),
    wrench=wrench,
    derivative=derivative,
    grid=grid,
    refine=("length",),
    confounded_with=("mass", "thrust_constant"),
    excitation=Excitation(
        (FORCE, ("attitude",)),
        measure="acceleration",
        weak=0.5,
        enough=1.5,
        flight="stops and starts: line",
        manoeuvre="a stop from 3 m/s, then hover while the load swings out",
    ),
)
