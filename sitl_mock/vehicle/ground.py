"""The ground: a plane, which may slope and move, under legs and hull of the vehicle or, as in SIH, under one point.

Each contact point carries a share of a spring-damper and Coulomb friction. Forces are computed for a unit of mass,
so that every vehicle sinks in equally; the stiffness is soft enough for 1 ms steps. PX4's own simulation (SIH) stops
the vehicle's position instead and lets it turn freely: nothing rights a vehicle that tilts.
"""

from __future__ import annotations

import math
from typing import Literal

import msgspec
import numpy as np
from numpy.typing import NDArray

from dynamics import quaternion
from dynamics import symbolic as ca
from dynamics.arrays import Floats
from dynamics.effect import Expression, Values
from dynamics.errors import RequestError
from dynamics.state import ATTITUDE, POSITION, RATE, VELOCITY
from dynamics.vehicle import GRAVITY, Vehicle

NATURAL_FREQUENCY = 60.0  # of the vehicle on its legs, rad/s
DAMPING_RATIO = 0.7
FRICTION = 0.7
STICTION_SPEED = 0.02  # below it friction grows with speed instead of sliding, m/s
STICKING_RATE = 200.0  # at which SIH's ground stops the vehicle, 1/s
HAND_FREQUENCY, HAND_MAX = 10.0, 3 * GRAVITY  # of a hand that holds the vehicle, rad/s, m/s^2
SLOPE_MAX, SPEED_MAX, HEAVE_MAX, HEAVE_PERIOD_MIN = 1.0, 20.0, 2.0, 1.0  # rad, m/s, m, s
SINKAGE = GRAVITY / NATURAL_FREQUENCY**2  # under the vehicle's own weight, m


GroundKind = Literal["legs", "sih"]


class Ground(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The ground, and its motion if it is a deck.

    kind: legs (a rough surface under legs and hull) or sih (as in PX4's own simulation, without a righting moment);
        None for the one that suits the vehicle.
    slope: rad.
    uphill: direction in which it rises, rad from east.
    speed: of a deck, east and north, m/s.
    heave: amplitude of a deck's motion up and down, m.
    heave_period: s.
    """

    kind: GroundKind | None = None
    slope: float = 0.0
    uphill: float = 0.0
    speed: tuple[float, float] = (0.0, 0.0)
    heave: float = 0.0
    heave_period: float = 6.0

    def __post_init__(self) -> None:
        if not (abs(self.slope) <= SLOPE_MAX and math.isfinite(self.uphill)):
            raise RequestError(f"ground with a slope of {self.slope} rad: wanted -{SLOPE_MAX} to {SLOPE_MAX} rad.")
        if not (abs(self.heave) <= HEAVE_MAX and self.heave_period >= HEAVE_PERIOD_MIN):
            raise RequestError(
                f"ground that heaves by {self.heave} m every {self.heave_period} s: wanted at most {HEAVE_MAX} m and "
                f"at least {HEAVE_PERIOD_MIN} s."
            )
        if not math.hypot(*self.speed) <= SPEED_MAX:
            raise RequestError(f"ground that moves at {self.speed} m/s: wanted at most {SPEED_MAX} m/s.")

    @property
    def normal(self) -> Floats:
        """(3,) unit vector out of the ground, world."""
        sine = math.sin(self.slope)
        return np.array([-sine * math.cos(self.uphill), -sine * math.sin(self.uphill), math.cos(self.slope)])

    @property
    def moves(self) -> bool:
        """Whether it is a deck that moves."""
        return any((*self.speed, self.heave))

    def velocity(self, time: float) -> Floats:
        """(3,) of the deck at a simulated time (s), world, m/s."""
        frequency = 2 * math.pi / self.heave_period
        return np.array([*self.speed, self.heave * frequency * math.sin(frequency * time)])

    def standing(self, yaw: float) -> Floats:
        """(4,) attitude of a vehicle with a heading (rad from east) that stands on it."""
        axis = np.cross([0.0, 0.0, 1.0], self.normal)
        length = float(np.linalg.norm(axis))
        turn = axis * (abs(self.slope) / length) if length > 0.0 else np.zeros(3)
        return np.asarray(quaternion.multiply(quaternion.exponential(turn), quaternion.from_euler(0.0, 0.0, yaw)))


def leg_height(vehicle: Vehicle) -> float:
    """Height of the body's origin over its feet, m: 0.3 of the longest arm."""
    arms = np.linalg.norm(np.array(vehicle.rotors.position)[:, 0:2], axis=1)
    return 0.3 * float(arms.max())


def contact_points(vehicle: Vehicle) -> NDArray[np.float64]:
    """Feet below the rotors and hull points above them, body FLU, m. Returns (3, 2 rotors)."""
    hubs = np.array(vehicle.rotors.position).T
    height = leg_height(vehicle)
    feet, hull = hubs.copy(), hubs.copy()
    feet[2] = -height
    hull[2] = hubs[2] + 0.5 * height
    return np.hstack([feet, hull])


def contact_acceleration(
    x: Expression, points: Expression, mass_over_inertia: Expression, surface: Values
) -> tuple[Expression, Expression]:
    """Acceleration by the ground: linear in the world (3,), m/s^2, and angular about body axes (3,), rad/s^2.

    x: rigid-body state. points: (3, n) from the centre of mass, body FLU. mass_over_inertia: (3,) 1/m^2.
    surface: ground_point (3,) m, ground_normal (3,), ground_velocity (3,) m/s, ground_rights (1 for legs, 0 for SIH),
        leg_height m.
    """
    rotation, rate = quaternion.rotation_matrix(x[ATTITUDE]), x[RATE]
    normal = surface["ground_normal"]
    share = 2.0 / points.shape[1]  # half of the points touch in any rest position
    linear, moment = ca.SX.zeros(3), ca.SX.zeros(3)
    centre_depth = ca.dot(normal, surface["ground_point"] - x[POSITION])
    centre_velocity = x[VELOCITY] - surface["ground_velocity"]
    for i in range(points.shape[1]):
        depth = centre_depth - ca.dot(normal, rotation @ points[:, i])
        velocity = centre_velocity + rotation @ ca.cross(rate, points[:, i])
        force = share * _point_force(depth, velocity, normal)
        linear = linear + force
        moment = moment + ca.cross(points[:, i], rotation.T @ force)
    rights = surface["ground_rights"]
    stuck = _sticking_force(centre_depth + surface["leg_height"], centre_velocity, normal)
    return ca.if_else(rights, linear, stuck), ca.if_else(rights, mass_over_inertia * moment, 0)


def hand_acceleration(x: Expression, place: Expression) -> tuple[Expression, Expression]:
    """Acceleration by a hand at a place: linear in the world (3,), m/s^2, and angular about body axes (3,), rad/s^2."""
    pull = HAND_FREQUENCY**2 * (place - x[POSITION]) - 2 * HAND_FREQUENCY * x[VELOCITY]
    strength = ca.fmin(1, HAND_MAX / ca.fmax(ca.sqrt(ca.sumsqr(pull)), 1e-9))
    return strength * pull, -2 * HAND_FREQUENCY * x[RATE]


def _point_force(depth: Expression, velocity: Expression, normal: Expression) -> Expression:
    """Force on the whole weight's share of a point, per unit of mass, world axes, m/s^2."""
    rising = ca.dot(normal, velocity)
    pressure = _pressure(depth, rising)
    along = velocity - rising * normal
    sliding = ca.sqrt(ca.sumsqr(along))
    return pressure * normal - FRICTION * pressure / ca.fmax(sliding, STICTION_SPEED) * along


def _sticking_force(depth: Expression, velocity: Expression, normal: Expression) -> Expression:
    """Force of a ground to which the vehicle sticks while it is pressed down, per unit of mass, m/s^2."""
    rising = ca.dot(normal, velocity)
    pressure = _pressure(depth, rising)
    holds = ca.if_else(pressure > 0, STICKING_RATE, 0)
    return pressure * normal - holds * (velocity - rising * normal)


def _pressure(depth: Expression, rising: Expression) -> Expression:
    """Force out of the ground by depth (m) and speed (m/s), per unit of mass, m/s^2."""
    damping = 2 * DAMPING_RATIO * NATURAL_FREQUENCY * ca.fmin(1, ca.fmax(depth, 0) / SINKAGE)
    return ca.if_else(depth > 0, ca.fmax(0, NATURAL_FREQUENCY**2 * depth - damping * rising), 0)
