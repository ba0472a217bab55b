"""A component of what is random: named hyperparameters with priors, a linear state space, its spectrum, a source.

A component is one module with a `COMPONENT` in it. Its outputs say where it enters, by the names of `CHANNELS`: forces,
torques, the air's velocity and rotor speeds act on the vehicle; readings of gyro, accelerometer and pose add to what
the vehicle's true motion gives. A noise that another component defines is named `component.noise`: so an estimator
that integrates the logged gyro errs by the very noise that is in the gyro's readings.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from diagnosis.noise.linear_model import LinearModel
from dynamics.arrays import Floats
from dynamics.vehicle import Vehicle

AXES = ("x", "y", "z")
Values = Mapping[str, float]

CHANNELS: Mapping[str, str] = {
    "force": "N, body FLU",
    "torque": "N m, body FLU about the centre of mass",
    "air": "m/s, its velocity, world ENU",
    "rotor_speed": "rad/s, of each rotor, from 0",
    "speed_reading": "rad/s, error of each rotor's reading, from 0",
    "gyro": "rad/s, error of the reading",
    "accelerometer": "m/s^2, error of the reading",
    "attitude": "rad, error as a rotation vector in body axes",
    "velocity": "m/s, error in body axes",
    "position": "m, error in body axes",
}
OF_ROTORS = ("rotor_speed", "speed_reading")  # channels with one output a rotor, the others have one an axis


@dataclass(frozen=True)
class LogNormal:
    """A hyperparameter's distribution before any flight: its median and the standard deviation of its logarithm."""

    median: float
    spread: float

    def log_density(self, value: float) -> float:
        """Logarithm of the density of the logarithm of a value."""
        deviation = (np.log(value) - np.log(self.median)) / self.spread
        return float(-(deviation**2 + np.log(2 * np.pi)) / 2 - np.log(self.spread))


@dataclass(frozen=True)
class Hyperparameter:
    """One number of a component, above 0.

    unit: SI.
    meaning: in a few words.
    lower, upper: bounds.
    prior: its distribution on a vehicle.
    """

    name: str
    unit: str
    meaning: str
    lower: float
    upper: float
    prior: Callable[[Vehicle], LogNormal]


@dataclass(frozen=True, eq=False)
class FlightConditions:
    """The point about which a component is linear.

    period: of a row, s.
    specific_force, rate_body: (3,) body FLU, m/s^2 and rad/s.
    air_velocity: (3,) of the vehicle relative to the air, world ENU, m/s.
    rotor_thrust: (n,) N.
    pose_rate, command_rate: readings of the pose a second, and commands a second that the controller gives, Hz.
    """

    vehicle: Vehicle
    period: float
    specific_force: Floats
    rate_body: Floats
    air_velocity: Floats
    rotor_thrust: Floats
    pose_rate: float
    command_rate: float


def hover(vehicle: Vehicle, period: float, pose_rate: float, command_rate: float) -> FlightConditions:
    """Hover in still air."""
    lift, count = np.array([0.0, 0.0, vehicle.weight / vehicle.body.mass]), vehicle.rotors.count
    thrust = np.full(count, vehicle.weight / count)
    return FlightConditions(vehicle, period, lift, np.zeros(3), np.zeros(3), thrust, pose_rate, command_rate)


@dataclass(frozen=True, eq=False)
class Component:
    """One kind of noise.

    name: as in a composition.
    summary: what it is, in a few words.
    source: where its formula comes from.
    parameters: its numbers.
    model: the state space at values. The values of all components that it is composed with are there as
        `component.parameter`, its own under their names alone as well.
    spectrum: (f,) two-sided power density of each output at frequencies, Hz, in hover, in closed form: (values,
        conditions, frequencies). It is compared with the transfer function of `model`.
    needs: components whose noises it shares.

    Raises ValueError when it contradicts itself.
    """

    name: str
    summary: str
    source: str
    parameters: tuple[Hyperparameter, ...]
    model: Callable[[Values, FlightConditions], LinearModel]
    spectrum: Callable[[Values, FlightConditions, Floats], Mapping[str, Floats]]
    needs: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        for contradiction in _contradictions(self):
            raise ValueError(f"noise component {self.name!r}: {contradiction}.")


def _contradictions(component: Component) -> Iterator[str]:
    """Contradictions between a component's fields, one sentence each."""
    names = [parameter.name for parameter in component.parameters]
    if not component.name.isidentifier():
        yield "a name is letters, digits and underscores"
    if not names:
        yield "it has no parameter, so that nothing of it could be fitted"
    for name in sorted({name for name in names if names.count(name) > 1}):
        yield f"two parameters are called {name!r}"
    for parameter in component.parameters:
        if not 0 < parameter.lower < parameter.upper:
            yield f"{parameter.name}: bounds {parameter.lower} and {parameter.upper} are not above 0 and in this order"


def fixed_prior(median: float, spread: float) -> Callable[[Vehicle], LogNormal]:
    """A prior that is one on every vehicle."""
    return lambda _: LogNormal(median, spread)
