"""Battery sag: thrust falls with the battery's voltage where speed is not regulated."""

from dataclasses import replace

from dynamics.effect import Effect, Environment, Parameter, Physics, Prior, Values


def physics(body: Physics, p: Values, environment: Environment, _: int | None) -> Physics:
    """k_f times 1 + 2 gain (V / V0 - 1), thrust going with the square of the voltage for small sags."""
    factor = 1 + 2 * p["gain"] * (environment.battery_ratio - 1)
    return replace(body, thrust_constant=body.thrust_constant * factor)


EFFECT = Effect(
    name="battery_sag",
    summary="Thrust falls with battery voltage",
    source="rotor speed proportional to voltage at fixed duty, linearised",
    parameters=(
        Parameter(
            "gain", "1", "1: speed follows the voltage; 0: speed is regulated", 0.0, 2.0, lambda _: Prior(1.0, 0.5)
        ),
    ),
    physics=physics,
)
