"""Smooth estimator: a pose whose error is smooth and independent of the logged sensors, of second order."""

from collections.abc import Mapping

import numpy as np

from diagnosis.noise.component import AXES, Component, FlightConditions, Hyperparameter, Values, fixed_prior
from diagnosis.noise.linear_model import LinearModel, chain, compose
from dynamics.arrays import Floats

KINDS = ("attitude", "velocity", "position")


def smooth(output: str, std: float, time: float, smoothing: float) -> LinearModel:
    """dx/dt = (u - x) / smoothing, du/dt = -u / time + std sqrt(2 (time + smoothing)) / time w."""
    F = np.array([[-1 / smoothing, 1 / smoothing], [0.0, -1 / time]])
    return chain(output, F, np.array([1.0, 0.0]), std * np.sqrt(2 * (time + smoothing)) / time)


def model(p: Values, _: FlightConditions) -> LinearModel:
    """An independent process of second order for each axis of attitude, velocity and position."""
    sizes = {f"{kind}_{axis}": (p[f"{kind}_std"], p[f"{kind}_time"]) for kind in KINDS for axis in AXES}
    return compose([smooth(output, std, time, p["smoothing"]) for output, (std, time) in sizes.items()])


def spectrum(p: Values, _: FlightConditions, frequency: Floats) -> Mapping[str, Floats]:
    """2 std^2 (time + smoothing) / ((1 + (omega time)^2) (1 + (omega smoothing)^2))."""
    omega, result = 2 * np.pi * frequency, dict[str, Floats]()
    for kind in KINDS:
        std, time, smoothing = p[f"{kind}_std"], p[f"{kind}_time"], p["smoothing"]
        density = 2 * std**2 * (time + smoothing) / ((1 + (omega * time) ** 2) * (1 + (omega * smoothing) ** 2))
        result |= {f"{kind}_{axis}": density for axis in AXES}
    return result


def hyperparameters(kind: str, unit: str, std: float, time: float) -> tuple[Hyperparameter, Hyperparameter]:
    """Size and time constant of one kind of error, by their usual values."""
    size = Hyperparameter(
        f"{kind}_std", unit, f"standard deviation of the {kind}'s error", 1e-3 * std, 1e2 * std, fixed_prior(std, 1.2)
    )
    return size, Hyperparameter(
        f"{kind}_time", "s", f"correlation time of the {kind}'s error", 0.02, 1e3, fixed_prior(time, 1.2)
    )


COMPONENT = Component(
    name="smooth_estimator",
    summary="Pose with a smooth error that is independent of the logged sensors",
    source="Maybeck, Stochastic Models, Estimation, and Control, vol. 1, 1979, sec. 4.11 (second-order shaping filter)",
    parameters=(
        *hyperparameters("attitude", "rad", 0.01, 1.0),
        *hyperparameters("velocity", "m/s", 0.05, 1.0),
        *hyperparameters("position", "m", 0.05, 1.0),
        Hyperparameter(
            "smoothing", "s", "time constant of the filter behind the error", 1e-3, 10.0, fixed_prior(0.3, 1.5)
        ),
    ),
    model=model,
    spectrum=spectrum,
)
