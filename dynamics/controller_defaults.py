"""Settings of the controller that follow from the vehicle: the lookaheads of its body-rate setpoints.

A rate loop of first order with time constant T behind a lag L follows a setpoint with the delay T + L. The controller
therefore commands the body rate that the vehicle would have at that later time under the acceleration that the plan's
first inputs command; the part of the delay that the model itself predicts (the rotors' lag) is subtracted.
`benchmarks/results/controller_defaults.md` compares this with one pair of lookaheads for all vehicles.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from dynamics.autopilot_settings import AutopilotSettings
from dynamics.controller_settings import ControllerSettings
from dynamics.effect import Effect
from dynamics.effects import CATALOGUE
from dynamics.errors import RequestError
from dynamics.own_effects import catalogue_of
from dynamics.rate_loop import ACTUATION_DELAY, RateLoop, modelled_motor_lag, rate_loop
from dynamics.vehicle import Vehicle

MIN_HORIZON = 2.0  # times the delay of the rate loop: a shorter prediction ends before a rate command has taken effect


@dataclass(frozen=True)
class Lookaheads:
    """Times along the prediction's slope at which body-rate setpoints are read, s: of roll and pitch, and of yaw."""

    rate: float
    yaw: float


def lookaheads(
    vehicle: Vehicle, catalogue: Mapping[str, Effect] = CATALOGUE, gains: AutopilotSettings | None = None
) -> Lookaheads:
    """The lookaheads of the vehicle file, else those derived from its rate loop; never beyond the horizon.

    gains: of the autopilot's rate loop; None for those of the vehicle file, else ones that suit its motors.
    Raises RequestError for a horizon that is too short for the vehicle's rate loop.
    """
    catalogue = catalogue_of(vehicle, catalogue)
    settings, loop = vehicle.controller, rate_loop(vehicle, catalogue=catalogue, gains=gains)
    _require_horizon(vehicle, loop)
    modelled = modelled_motor_lag(vehicle.effects, catalogue)
    rate, yaw = settings.rate_lookahead, settings.yaw_lookahead
    return Lookaheads(
        min(loop.tilt_time - modelled, settings.horizon) if rate is None else rate,
        min(loop.yaw_time - modelled, settings.horizon) if yaw is None else yaw,
    )


def unmodelled_thrust_lag(vehicle: Vehicle, catalogue: Mapping[str, Effect] = CATALOGUE) -> float:
    """Time by which thrust follows its setpoint later than the vehicle file's model predicts, s: motors, actuation."""
    catalogue = catalogue_of(vehicle, catalogue)
    lag = rate_loop(vehicle, catalogue=catalogue).motor_lag + ACTUATION_DELAY
    return lag - modelled_motor_lag(vehicle.effects, catalogue)


def _require_horizon(vehicle: Vehicle, loop: RateLoop) -> None:
    shortest = min(vehicle.controller.delay + MIN_HORIZON * loop.tilt_time, ControllerSettings().horizon)
    if vehicle.controller.horizon < shortest:
        raise RequestError(
            f"controller.horizon = {vehicle.controller.horizon:g} s is too short for {vehicle.name}: its body rates "
            f"follow their setpoints {1e3 * loop.tilt_time:.0f} ms late (motors lag by {1e3 * loop.motor_lag:.0f} ms). "
            f"Give at least {shortest:.2f} s."
        )
