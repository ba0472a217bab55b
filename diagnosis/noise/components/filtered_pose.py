"""Filtered pose: errors of velocity and attitude that last for some rows, as a tracker's own filter leaves them."""

from collections.abc import Mapping

from diagnosis.noise.component import AXES, Component, FlightConditions, Values
from diagnosis.noise.components.smooth_estimator import hyperparameters
from diagnosis.noise.linear_model import LinearModel, compose, gauss_markov, gauss_markov_density
from dynamics.arrays import Floats

KINDS = ("velocity", "attitude")


def sizes(p: Values) -> dict[str, tuple[float, float]]:
    """Standard deviation and time constant of each output; the heading's is its own, which no gravity shows."""
    made = {f"{kind}_{axis}": (p[f"{kind}_std"], p[f"{kind}_time"]) for kind in KINDS for axis in AXES}
    return {**made, "attitude_z": (p["heading_std"], p["attitude_time"])}


def model(p: Values, _: FlightConditions) -> LinearModel:
    """dx/dt = -x / time + std sqrt(2 / time) w in each axis."""
    return compose([gauss_markov(output, *size) for output, size in sizes(p).items()])


def spectrum(p: Values, _: FlightConditions, frequency: Floats) -> Mapping[str, Floats]:
    """2 std^2 time / (1 + (omega time)^2)."""
    return {output: gauss_markov_density(*size, frequency) for output, size in sizes(p).items()}


COMPONENT = Component(
    name="filtered_pose",
    summary="Pose whose errors last for some rows",
    source="Maybeck, Stochastic Models, Estimation, and Control, vol. 1, 1979, sec. 4.11 (first-order shaping filter)",
    parameters=(
        *hyperparameters("velocity", "m/s", 0.01, 0.1),
        *hyperparameters("attitude", "rad", 1e-3, 0.3),
        hyperparameters("heading", "rad", 1e-3, 0.3)[0],
    ),
    model=model,
    spectrum=spectrum,
)
