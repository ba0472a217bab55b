"""What a physical effect is: named parameters, a wrench, hidden states, a source. Written once, in CasADi.

An effect is one module with an `EFFECT` in it. The same object is what the mock's plant adds, diagnosis regresses
and fits, the controller compiles in and the training prior contains. Hooks are pure functions of CasADi
expressions; an effect gives only those that it needs:

physics       changes the constants of body and rotors (mass, one rotor's thrust constant, ...)
rotor_speed   what the rotors do with a commanded speed
wind          velocity of the air, world ENU, m/s
wrench        force (body FLU, N) and moment about the centre of mass (N m) added to the rigid body's
derivative    time derivative of the effect's hidden states; `noise` is unit white noise, one entry a hidden state
measurement   what a sensor says of the truth: faults of sensors are effects that change readings, not motion
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from dynamics.vehicle import Vehicle

Expression = Any  # casadi.SX or casadi.MX
Values = Mapping[str, Expression]


@dataclass(frozen=True)
class Prior:
    """What is believed of a parameter before any flight: its usual value and a standard deviation, in its unit."""

    mean: float
    std: float


@dataclass(frozen=True)
class Parameter:
    """One number of an effect. lower, upper: physical bounds. neutral: the value at which the effect vanishes."""

    name: str
    unit: str
    meaning: str
    lower: float
    upper: float
    prior: Callable[[Vehicle], Prior]
    neutral: float = 0.0


@dataclass(frozen=True)
class Hidden:
    """A hidden state of an effect. initial: its value in hover, given the vehicle. per_rotor: one for each rotor."""

    name: str
    unit: str
    initial: Callable[[Vehicle], float]
    per_rotor: bool = False


@dataclass(frozen=True)
class Physics:
    """Constants of body and rotors as expressions. rotor_position: (3, n) m; per-rotor constants: (n,)."""

    mass: Expression
    inertia: Expression
    centre_of_mass: Expression
    rotor_position: Expression
    spin: Expression
    thrust_constant: Expression
    torque_constant: Expression
    rotor_radius: Expression

    @property
    def rotor_count(self) -> int:
        """Number of rotors."""
        return int(self.rotor_position.shape[1])


@dataclass(frozen=True)
class Environment:
    """What surrounds the vehicle. ground_height: world z, m. battery_ratio: voltage over its nominal value."""

    ground_height: Expression
    battery_ratio: Expression


@dataclass(frozen=True)
class Conditions:
    """All that a hook may look at, in SI and our frames; derived quantities are worked out once by the model.

    air_velocity_body: velocity of the body relative to the air, body FLU. rotor_air_velocity: (3, n) the same at each
    rotor hub. rotor_thrust: (n,) N, before this effect. command: commanded rotor speeds; rotor_speed: real ones.
    wind_body: the air's own velocity, body FLU. has_drag: another effect of the model already resists the air.
    rotor: the rotor that a single-rotor effect sits on.
    """

    position: Expression
    velocity_world: Expression
    attitude: Expression
    rate_body: Expression
    command: Expression
    rotor_speed: Expression
    rotor_acceleration: Expression
    rotor_position: Expression
    rotor_thrust: Expression
    air_velocity_body: Expression
    rotor_air_velocity: Expression
    wind_body: Expression
    physics: Physics
    environment: Environment
    has_drag: bool = False
    rotor: int | None = None


@dataclass(frozen=True)
class Reading:
    """What the sensors say. specific_force: body FLU, m/s^2. rate_body: rad/s. rotor_speed: (n,) rad/s.

    pose_age: s by which position, velocity and attitude are older than their stamps.
    """

    specific_force: Expression
    rate_body: Expression
    rotor_speed: Expression
    pose_age: Expression


@dataclass(frozen=True)
class Span:
    """The corners of the box in which flights took place, world ENU, m."""

    lowest: tuple[float, float, float]
    highest: tuple[float, float, float]


@dataclass(frozen=True)
class Wrench:
    """Force, body FLU, N, and moment about the centre of mass, body FLU, N m."""

    force: Expression
    moment: Expression


@dataclass(frozen=True)
class Effect:
    """One physical effect. source: where its formula comes from. per_rotor: it sits on one rotor, named by index.

    resists_air: it is a drag, through which wind acts on the vehicle. variants: values of the parameters in which the
    effect is not linear, for diagnosis to try; the others are then found by linear regression, and an effect whose
    parameters are all held is regressed as a whole.
    """

    name: str
    summary: str
    source: str
    parameters: tuple[Parameter, ...]
    hidden: tuple[Hidden, ...] = ()
    physics: Callable[[Physics, Values, Environment, int | None], Physics] | None = None
    rotor_speed: Callable[[Expression, Values], Expression] | None = None
    wind: Callable[[Values, Values], Expression] | None = None
    wrench: Callable[[Conditions, Values, Values], Wrench] | None = None
    derivative: Callable[[Conditions, Values, Values, Values], Values] | None = None
    measurement: Callable[[Reading, Values, int | None], Reading] | None = None
    variants: Callable[[Vehicle, Span], Sequence[Mapping[str, float]]] | None = None
    per_rotor: bool = False
    resists_air: bool = False

    def defaults(self, vehicle: Vehicle) -> dict[str, float]:
        """The usual value of each parameter on this vehicle."""
        return {p.name: min(max(p.prior(vehicle).mean, p.lower), p.upper) for p in self.parameters}
