"""Effects of your own: alula diagnose LOG... --vehicle V.toml --effects examples/my_effects.py

One file, one `EFFECT` or a list of them, `EFFECTS`. Each formula is written once, in CasADi; diagnosis regresses and
fits it from here. The first effect below has only what every effect needs. The second has a hidden state and the
fields that determine how diagnosis treats it.
"""

from collections.abc import Sequence

import casadi as ca

from dynamics import quaternion
from dynamics.effect import Conditions, Effect, Hidden, Parameter, Prior, Span, Values, Wrench
from dynamics.excitation import DRIVE, FORCE, POSE, Excitation
from dynamics.vehicle import Vehicle


def tether(c: Conditions, p: Values, _: Values) -> Wrench:
    """F = -stiffness (x, y, 0) in world axes, turned into body axes; no moment."""
    pull = -p["stiffness"] * ca.vertcat(c.position[0:2], 0)
    return Wrench(quaternion.rotate_inverse(c.attitude, pull), ca.SX.zeros(3))


TETHER = Effect(
    name="tether",
    summary="A spring that pulls towards the origin",
    source="Hooke's law",
    parameters=(
        # name, unit, meaning, lower and upper bound, usual value with its standard deviation; it vanishes at 0
        Parameter("stiffness", "N/m", "pull per metre of distance", 0.0, 10.0, lambda _: Prior(0.05, 0.1)),
    ),
    wrench=tether,
)


def late_drag(_: Conditions, p: Values, hidden: Values) -> Wrench:
    """F = -coefficient w, w the airspeed as the wake has followed it; no moment."""
    wake = ca.vertcat(*[hidden[f"wake_{axis}"] for axis in "xyz"])
    return Wrench(-p["coefficient"] * wake, ca.SX.zeros(3))


def wake(c: Conditions, p: Values, hidden: Values, _: Values) -> Values:
    """dw/dt = (v - w) / tau, v the velocity relative to the air in body axes."""
    return {
        f"wake_{axis}": (c.air_velocity_body[i] - hidden[f"wake_{axis}"]) / p["tau"] for i, axis in enumerate("xyz")
    }


def wake_times(_: Vehicle, __: Span) -> Sequence[dict[str, float]]:
    """Time constants from 0.1 to 0.4 s: the force is not linear in tau, so diagnosis tries these one by one."""
    return [{"tau": seconds} for seconds in (0.1, 0.2, 0.4)]


LATE_DRAG = Effect(
    name="late_drag",
    summary="Drag that follows the airspeed with a delay",
    source="first-order wake behind a bluff body",
    parameters=(
        Parameter("coefficient", "N s/m", "force per airspeed", 0.0, 5.0, lambda v: Prior(0.2 * v.body.mass, 0.1)),
        Parameter("tau", "s", "time in which the wake follows", 0.02, 2.0, lambda _: Prior(0.2, 0.2), neutral=0.2),
    ),
    hidden=tuple(Hidden(f"wake_{axis}", "m/s", lambda _: 0.0) for axis in "xyz"),
    wrench=late_drag,
    derivative=wake,
    grid=wake_times,
    refine=("tau",),  # fitted at the end, from the best value of the grid
    time_constants=("tau",),  # the controller and the mock integrate in steps that are short enough for it
    resists_air=True,  # wind acts through it
    caveat="coefficient and tau were fitted together; the airspeed must change within {tau:.2g} s to separate them",
    excitation=Excitation(  # for `alula inspect`, and for what to fly next
        (FORCE, *POSE, DRIVE),
        measure="lateral_speed",
        weak=0.3,
        enough=1.0,
        flight="starts and stops along a line",
        manoeuvre="starts and stops, against steady circles",
    ),
    confounded_with=("linear_drag",),
)

EFFECTS = [TETHER, LATE_DRAG]
