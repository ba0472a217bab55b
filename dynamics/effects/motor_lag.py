"""Motor lag: rotors follow their command as a first-order system."""

from collections.abc import Sequence

from dynamics.effect import Conditions, Effect, Expression, Hidden, Parameter, Prior, Span, Values
from dynamics.excitation import COMMAND, QUICK_TURNS, Excitation
from dynamics.vehicle import EffectUse, Vehicle


def rotor_speed(_: Expression, hidden: Values) -> Expression:
    """The real rotor speed is the hidden state, not the command."""
    return hidden["rotor_speed"]


def derivative(c: Conditions, p: Values, hidden: Values, _: Values) -> Values:
    """dOmega/dt = (command - Omega) / time_constant."""
    return {"rotor_speed": (c.command - hidden["rotor_speed"]) / p["time_constant"]}


def grid(_: Vehicle, __: Span) -> Sequence[dict[str, float]]:
    """Time constants from 4 to 120 ms."""
    return [{"time_constant": seconds} for seconds in (0.004, 0.01, 0.018, 0.03, 0.045, 0.07, 0.12)]


EFFECT = Effect(
    name="motor_lag",
    summary="Rotor speed lags its command by a first-order time constant",
    source="Eschmann, Albani, Loianno, Data-Driven System Identification of Quadrotors Subject to Motor Delays, 2024",
    parameters=(
        Parameter("time_constant", "s", "time to 63 % of a step", 1e-3, 0.5, prior=lambda _: Prior(0.035, 0.03)),
    ),
    hidden=(Hidden("rotor_speed", "rad/s", initial=lambda vehicle: vehicle.hover_speed, per_rotor=True),),
    rotor_speed=rotor_speed,
    derivative=derivative,
    grid=grid,
    min_detectable=0.0025,  # s; smaller ones are within the clocks' errors
    time_constants=("time_constant",),
    excitation=Excitation(
        (("rate", "specific_force"), COMMAND),
        measure="tilting_acceleration",
        weak=2.0,
        enough=8.0,
        flight=QUICK_TURNS,
        manoeuvre="quick steps in thrust and body rates",
    ),
)


def rotor_lag(seconds: float) -> EffectUse:
    """This lag with a time constant."""
    return EffectUse(EFFECT.name, {"time_constant": seconds})
