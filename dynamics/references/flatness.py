"""From position and yaw to the whole motion of a multirotor, by differential flatness.

Thrust direction and rates: Mellinger and Kumar, "Minimum snap trajectory generation and control for quadrotors"
(ICRA 2011); Faessler, Franchi and Scaramuzza (RA-L 2018) without drag. The heading follows Watterson and Kumar,
"Control of quadrotors using the Hopf fibration on SO(3)" (2017): attitude = smallest tilt that turns body z onto the
thrust, after a turn by yaw about body z. Unlike the construction from a horizontal heading vector it has no singular
point when the vehicle tilts by 90 degrees, only upside down, and its quaternion never jumps in sign.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dynamics.arrays import Floats
from dynamics.vehicle import GRAVITY, Vehicle

MIN_SPECIFIC_THRUST = 0.5  # m/s^2; below it the attitude is undefined (free fall), rates are held finite
_MIN_ONE_PLUS_COSINE = 0.02  # of the tilt; below it (tilt above 168 degrees) the heading is undefined


@dataclass(frozen=True, slots=True)
class ReferenceSamples:
    """A reference at n instants: world ENU, body FLU, SI units.

    time: (n,).
    position, velocity, acceleration, jerk, snap: (n, 3) world.
    yaw: (n,).
    attitude: (n, 4) body to world.
    rate_body, rate_acceleration: (n, 3) body.
    collective_thrust: (n,) N.
    rotor_thrust: (n, rotors) N, negative or beyond the limits where the vehicle cannot follow.
    rotor_speed: (n, rotors) rad/s.
    """

    time: Floats
    position: Floats
    velocity: Floats
    acceleration: Floats
    jerk: Floats
    snap: Floats
    yaw: Floats
    attitude: Floats
    rate_body: Floats
    rate_acceleration: Floats
    collective_thrust: Floats
    rotor_thrust: Floats
    rotor_speed: Floats


def flat_motion(time: Floats, flat: Floats, vehicle: Vehicle) -> ReferenceSamples:
    """The motion that belongs to flat outputs on a vehicle without aerodynamic effects (PI-TCN eq. 1 and 2).

    time: (n,) s. flat: (n, 5, 4) derivatives of x, y, z (m) and yaw (rad), orders 0 to 4.
    """
    yaw = flat[:, 0, 3]
    specific = flat[:, 2, :3] + np.array([0.0, 0.0, GRAVITY])
    specific_thrust = np.linalg.norm(specific, axis=1)
    axis = _thrust_axis(specific, flat[:, 3, :3], flat[:, 4, :3])
    rate, rate_acceleration = _body_rates(axis, flat[:, :3, 3])
    thrust = vehicle.body.mass * specific_thrust
    rotor_thrust = _rotor_thrust(thrust, rate, rate_acceleration, vehicle)
    speed = np.sqrt(np.maximum(rotor_thrust, 0.0) / vehicle.rotors.thrust_constant)
    return ReferenceSamples(
        time=time,
        position=flat[:, 0, :3],
        velocity=flat[:, 1, :3],
        acceleration=flat[:, 2, :3],
        jerk=flat[:, 3, :3],
        snap=flat[:, 4, :3],
        yaw=yaw,
        attitude=_attitude(axis[0], yaw),
        rate_body=rate,
        rate_acceleration=rate_acceleration,
        collective_thrust=thrust,
        rotor_thrust=rotor_thrust,
        rotor_speed=speed,
    )


def _thrust_axis(specific: Floats, jerk: Floats, snap: Floats) -> tuple[Floats, Floats, Floats]:
    """Body z in the world and its first two time derivatives. All: (n, 3)."""
    size = np.maximum(np.linalg.norm(specific, axis=1, keepdims=True), MIN_SPECIFIC_THRUST)
    axis = specific / size
    size_rate = np.sum(axis * jerk, axis=1, keepdims=True)
    axis_rate = (jerk - axis * size_rate) / size
    size_acceleration = np.sum(axis * snap + axis_rate * jerk, axis=1, keepdims=True)
    axis_acceleration = (snap - axis * size_acceleration - 2 * axis_rate * size_rate) / size
    return axis, axis_rate, axis_acceleration


def _attitude(axis: Floats, yaw: Floats) -> Floats:
    """Smallest tilt onto the thrust axis after a turn by yaw. axis: (n, 3) unit, yaw: (n,). Returns (n, 4)."""
    a, b, c = axis.T
    w = np.sqrt(np.maximum(1 + c, _MIN_ONE_PLUS_COSINE) / 2)
    x, y = -b / (2 * w), a / (2 * w)
    cos, sin = np.cos(yaw / 2), np.sin(yaw / 2)
    attitude = np.stack([w * cos, x * cos + y * sin, y * cos - x * sin, w * sin], axis=1)
    return np.asarray(attitude / np.linalg.norm(attitude, axis=1, keepdims=True))


def _body_rates(axis: tuple[Floats, Floats, Floats], yaw: Floats) -> tuple[Floats, Floats]:
    """Body rates and their time derivatives (Watterson and Kumar, eq. for omega on the Hopf chart).

    axis: body z and two derivatives, (n, 3) each. yaw: (n, 3), orders 0 to 2. Returns two (n, 3).
    """
    (a, b, c), (a1, b1, c1), (a2, b2, c2) = (part.T for part in axis)
    r = 1 / np.maximum(1 + c, _MIN_ONE_PLUS_COSINE)
    g, g_rate = c1 * r, c2 * r - (c1 * r) ** 2  # of ln(1 + c)
    tilt_rate = np.stack([b * g - b1, a1 - a * g, (b * a1 - a * b1) * r])
    tilt_acceleration = np.stack(
        [
            b1 * g + b * g_rate - b2,
            a2 - a1 * g - a * g_rate,
            (b * a2 - a * b2) * r - (b * a1 - a * b1) * r * g,
        ]
    )
    cos, sin = np.cos(yaw[:, 0]), np.sin(yaw[:, 0])
    x, y, z = tilt_rate
    x1, y1, z1 = tilt_acceleration
    rate = np.stack([cos * x + sin * y, cos * y - sin * x, z + yaw[:, 1]], axis=1)
    acceleration = np.stack(
        [
            cos * x1 + sin * y1 + yaw[:, 1] * rate[:, 1],
            cos * y1 - sin * x1 - yaw[:, 1] * rate[:, 0],
            z1 + yaw[:, 2],
        ],
        axis=1,
    )
    return rate, acceleration


def _rotor_thrust(thrust: Floats, rate: Floats, rate_acceleration: Floats, vehicle: Vehicle) -> Floats:
    """Thrust of every rotor, N, that gives the wrench with the smallest sum of squares. Returns (n, rotors)."""
    inertia = np.array(vehicle.body.inertia)
    torque = inertia * rate_acceleration + np.cross(rate, inertia * rate)
    x, y, _ = vehicle.body.centre_of_mass
    torque = torque + thrust[:, None] * np.array([y, -x, 0.0])  # about the origin of the rotors' positions
    wrench = np.column_stack([thrust, torque])
    squared_speed = wrench @ np.linalg.pinv(vehicle.rotors.allocation).T
    return np.asarray(vehicle.rotors.thrust_constant * squared_speed)
