"""Multi-step prediction: the model runs from a measured state; one right at one step can be wrong at fifty."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import casadi as ca
import msgspec
import numpy as np

from diagnosis.filters import Floats
from diagnosis.prediction import Predictor
from diagnosis.stretch import Stretch
from dynamics import quaternion
from dynamics.effect import Effect
from dynamics.integrators import step_function
from dynamics.vehicle import Vehicle

HORIZONS = (0.1, 0.5, 1.0)  # s
EVERY = 0.5  # s between starts


class HorizonError(msgspec.Struct, frozen=True):
    """RMS error after a horizon (s) of open loop: position m, velocity m/s, attitude rad, rate rad/s."""

    horizon: float
    position: float
    velocity: float
    attitude: float
    rate: float


def open_loop_errors(
    vehicle: Vehicle, catalogue: Mapping[str, Effect], stretches: Sequence[Stretch]
) -> tuple[HorizonError, ...]:
    """Prediction errors of a vehicle's model over 0.1, 0.5 and 1 s, from starts all along the stretches."""
    measured = stretches[0].rotor_source == "measured"
    predictor = Predictor(vehicle, vehicle.effects, catalogue, speed_measured=measured)
    found: dict[float, list[Floats]] = {horizon: [] for horizon in HORIZONS}
    for stretch in stretches:
        for horizon, errors in _errors(predictor, stretch).items():
            found[horizon].append(errors)
    return tuple(_summary(horizon, np.vstack(errors)) for horizon, errors in found.items())


def _errors(predictor: Predictor, stretch: Stretch) -> dict[float, Floats]:
    """(starts, 12) errors of position, velocity, attitude (rotation vector) and rate at each horizon."""
    model, rate = predictor.model, stretch.rate
    steps = round(HORIZONS[-1] * rate)
    starts = np.arange(0, len(stretch) - steps, max(1, round(EVERY * rate)))
    advance = step_function(model)
    states = predictor.states(stretch)
    states[:, 10:13] = stretch.smooth[:, 10:13]
    x = ca.DM(states[starts].T)
    p, still = ca.DM(predictor.values()), ca.DM.zeros(model.hidden_count)
    result = {}
    for step in range(1, steps + 1):
        speed = (stretch.rotor_speed[starts + step - 1] + stretch.rotor_speed[starts + step]) / 2
        x = advance(x, speed.T, p, stretch.environment[starts + step - 1].T, still, 1 / rate)
        horizon = next((h for h in HORIZONS if round(h * rate) == step), None)
        if horizon is not None:
            result[horizon] = _difference(x.full().T, stretch.smooth[starts + step])
    return result


def _difference(said: Floats, was: Floats) -> Floats:
    turned = quaternion.multiply(quaternion.conjugate(was[:, 6:10]), said[:, 6:10])
    turned = np.where(turned[:, :1] < 0, -turned, turned)
    attitude = quaternion.logarithm(turned)
    return np.hstack([said[:, :6] - was[:, :6], attitude, said[:, 10:13] - was[:, 10:13]])


def _summary(horizon: float, errors: Floats) -> HorizonError:
    norms = [float(np.sqrt(np.mean(np.sum(errors[:, 3 * i : 3 * i + 3] ** 2, axis=1)))) for i in range(4)]
    return HorizonError(horizon, *norms)
