"""Battery sag: thrust falls with the battery's voltage where speed is not regulated."""

from collections.abc import Sequence
from dataclasses import replace

from dynamics.effect import Effect, Environment, Parameter, Physics, Prior, Span, Values
from dynamics.excitation import COMMAND, FORCE, Excitation
from dynamics.vehicle import Vehicle


def physics(body: Physics, p: Values, environment: Environment, _: int | None) -> Physics:
    """k_f and k_tau times (V / V0)^(2 gain), since rotor speed goes with the voltage to the power of gain.

    V0 is reference times the full battery's voltage.
    """
    factor = (environment.battery_ratio / p["reference"]) ** (2 * p["gain"])
    return replace(body, thrust_constant=body.thrust_constant * factor, torque_constant=body.torque_constant * factor)


def grid(_: Vehicle, __: Span) -> Sequence[dict[str, float]]:
    """Constants that hold at 4.2, 4.1 or 3.8 V a cell."""
    return [{"reference": volts / 4.2} for volts in (4.2, 4.1, 3.8)]


EFFECT = Effect(
    name="battery_sag",
    summary="Thrust falls with battery voltage",
    source="rotor speed proportional to voltage at fixed duty",
    parameters=(
        Parameter(
            "gain", "1", "1: speed follows the voltage; 0: speed is regulated", 0.0, 2.0, lambda _: Prior(1.0, 0.5)
        ),
        Parameter(
            "reference",
            "1",
            "voltage at which the file's constants hold, over the full battery's",
            0.6,
            1.2,
            lambda _: Prior(1.0, 0.05),
            neutral=1.0,
        ),
    ),
    physics=physics,
    grid=grid,
    caveat="the voltage at which the file's constants hold was tried, not fitted: {reference:.3g} of a full battery's",
    voltage_power="gain",
    confounded_with=("thrust_constant",),
    excitation=Excitation(
        (("battery_voltage",), COMMAND, FORCE),
        measure="voltage_drop",
        weak=0.03,
        enough=0.08,
        flight="a full battery until low",
        manoeuvre="the same manoeuvre with a full and with a nearly empty battery",
    ),
)
