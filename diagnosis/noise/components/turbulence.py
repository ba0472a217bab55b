"""Turbulence: force and torque of one time scale, a first-order Gauss-Markov process in each body axis."""

from collections.abc import Mapping

from diagnosis.noise.component import AXES, Component, FlightConditions, Hyperparameter, LogNormal, Values
from diagnosis.noise.linear_model import LinearModel, compose, gauss_markov, gauss_markov_density
from dynamics.arrays import Floats
from dynamics.vehicle import Vehicle

ACCELERATION = 0.05  # m/s^2, usual standard deviation of the force over the mass
ANGULAR_ACCELERATION = 0.5  # rad/s^2, of the torque over the inertia
SPREAD = 1.5  # of a level's logarithm: small vehicles and gusty rooms differ by a factor of 20


def level(p: Values, output: str) -> tuple[float, float]:
    """Standard deviation and time constant of an output: of the force or torque, level or along body z."""
    kind, axis = output.split("_")
    return p[f"{kind}_z" if axis == "z" else f"{kind}_xy"], p[f"{kind}_time"]


OUTPUTS = tuple(f"{kind}_{axis}" for kind in ("force", "torque") for axis in AXES)


def model(p: Values, _: FlightConditions) -> LinearModel:
    """dx/dt = -x / time + std sqrt(2 / time) w in each axis of force and torque."""
    return compose([gauss_markov(output, *level(p, output)) for output in OUTPUTS])


def spectrum(p: Values, _: FlightConditions, frequency: Floats) -> Mapping[str, Floats]:
    """2 std^2 time / (1 + (omega time)^2)."""
    return {output: gauss_markov_density(*level(p, output), frequency) for output in OUTPUTS}


def usual_force(vehicle: Vehicle) -> LogNormal:
    """A force by the mass."""
    return LogNormal(ACCELERATION * vehicle.body.mass, SPREAD)


def usual_torque(axis: int) -> Hyperparameter:
    """A torque by the inertia about body x or z."""
    return Hyperparameter(
        "torque_z" if axis == 2 else "torque_xy",
        "N m",
        "standard deviation of the torque " + ("about body z" if axis == 2 else "about body x and y"),
        *(1e-9, 10.0),
        lambda vehicle: LogNormal(ANGULAR_ACCELERATION * vehicle.body.inertia[axis], SPREAD),
    )


LEVELS = (
    Hyperparameter("force_xy", "N", "standard deviation of the force along body x and y", 1e-7, 1e3, usual_force),
    Hyperparameter("force_z", "N", "standard deviation of the force along body z", 1e-7, 1e3, usual_force),
    usual_torque(0),
    usual_torque(2),
)


def times(force: LogNormal, torque: LogNormal, lower: float, upper: float) -> tuple[Hyperparameter, ...]:
    """The time constants of force and torque."""
    return (
        Hyperparameter("force_time", "s", "correlation time of the force", lower, upper, lambda _: force),
        Hyperparameter("torque_time", "s", "correlation time of the torque", lower, upper, lambda _: torque),
    )


COMPONENT = Component(
    name="turbulence",
    summary="Force and torque of rotor turbulence, one time scale",
    source="Uhlenbeck and Ornstein, On the theory of the Brownian motion, Phys. Rev. 36, 1930",
    parameters=(*LEVELS, *times(LogNormal(0.1, 0.8), LogNormal(0.05, 0.8), 0.005, 0.3)),
    model=model,
    spectrum=spectrum,
)
