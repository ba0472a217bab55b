"""Gust: wind that changes at random, a first-order Gauss-Markov process in each world axis."""

from dynamics import symbolic as ca
from dynamics.effect import Conditions, Effect, Expression, Hidden, Parameter, Prior, Values, Wrench
from dynamics.effects.wind import COEFFICIENT, push
from dynamics.excitation import FORCE, Excitation

AXES = ("x", "y", "z")
VERTICAL_SHARE = 0.5  # of the horizontal intensity


def wind(_: Values, hidden: Values) -> Expression:
    """The gust's velocity, world ENU, m/s."""
    return ca.vertcat(*[hidden[f"wind_{axis}"] for axis in AXES])


def derivative(_: Conditions, p: Values, hidden: Values, noise: Values) -> Values:
    """dw/dt = -w / correlation_time + intensity sqrt(2 / correlation_time) white noise, half as strong vertically."""
    rates = {}
    for axis in AXES:
        gain = p["intensity"] * ca.sqrt(2 / p["correlation_time"]) * (VERTICAL_SHARE if axis == "z" else 1.0)
        rates[f"wind_{axis}"] = -hidden[f"wind_{axis}"] / p["correlation_time"] + gain * noise[f"wind_{axis}"]
    return rates


def wrench(c: Conditions, p: Values, hidden: Values) -> Wrench:
    """The gust's own push where no drag effect of the model feels the air (see `wind`)."""
    return push(c, p, wind(p, hidden))


EFFECT = Effect(
    name="gust",
    summary="Random wind with a standard deviation and a correlation time",
    source="Gauss-Markov form of the Dryden gust, MIL-F-8785C",
    parameters=(
        Parameter(
            "intensity", "m/s", "standard deviation of the horizontal gust", 0.0, 15.0, lambda _: Prior(1.0, 1.0)
        ),
        Parameter("correlation_time", "s", "time over which a gust lasts", 0.05, 20.0, lambda _: Prior(1.0, 1.0), 1.0),
        COEFFICIENT,
    ),
    hidden=tuple(Hidden(f"wind_{axis}", "m/s", initial=lambda _: 0.0) for axis in AXES),
    wind=wind,
    wrench=wrench,
    derivative=derivative,
    time_constants=("correlation_time",),
    stochastic=True,
    excitation=Excitation(
        (FORCE,),
        measure="duration",
        weak=20.0,
        enough=60.0,
        flight="a minute of any flight",
        manoeuvre="a minute of hover in one place",
    ),
)
