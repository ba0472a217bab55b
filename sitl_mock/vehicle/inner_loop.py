"""PX4's attitude and body-rate controllers as CasADi expressions, in ENU world and FLU body axes.

Sources: PX4-Autopilot, AttitudeControl.cpp (Brescianini, Hehn, D'Andrea, Nonlinear Quadrocopter Attitude Control,
ETH Zurich 2013), rate_control.cpp and MulticopterRateControl.cpp, VehicleAngularVelocity.cpp (filters).
"""

from __future__ import annotations

import numpy as np

from dynamics import quaternion
from dynamics import symbolic as ca
from dynamics.effect import Expression, Values

INTEGRAL_FADES_AT = np.radians(400.0)  # rate error at which the integrator stops, rad/s


def rate_setpoint(
    attitude: Expression, setpoint: Expression, yaw_rate: Expression, *, gain: Expression, yaw_weight: Expression
) -> Expression:
    """Body rates that turn the vehicle to an attitude setpoint, tilt before yaw, rad/s, not yet limited.

    attitude, setpoint: (4,). yaw_rate: feed-forward about the world's z axis, rad/s. gain: (3,) 1/s, at full yaw.
    """
    current_z = quaternion.rotate(attitude, ca.SX([0, 0, 1]))
    setpoint_z = quaternion.rotate(setpoint, ca.SX([0, 0, 1]))
    tilt = _shortest_rotation(current_z, setpoint_z)
    opposite = ca.fmax(ca.fabs(tilt[1]), ca.fabs(tilt[2])) > 1 - 1e-5
    reduced = ca.if_else(opposite, setpoint, quaternion.multiply(tilt, attitude))
    yaw = _canonical(quaternion.multiply(quaternion.conjugate(reduced), setpoint))
    cosine, sine = (ca.fmin(ca.fmax(part, -1), 1) for part in (yaw[0], yaw[3]))
    weighted = ca.vertcat(ca.cos(yaw_weight * ca.acos(cosine)), 0, 0, ca.sin(yaw_weight * ca.asin(sine)))
    target = quaternion.multiply(reduced, weighted)
    error = _canonical(quaternion.multiply(quaternion.conjugate(attitude), target))
    compensated = ca.vertcat(gain[0], gain[1], gain[2] / ca.fmax(yaw_weight, 1e-4))
    world_z = quaternion.rotate_inverse(attitude, ca.SX([0, 0, 1]))
    return 2 * error[1:4] * compensated + world_z * yaw_rate


def _shortest_rotation(source: Expression, target: Expression) -> Expression:
    """Quaternion of the shortest rotation from one unit vector to another; any half turn when they are opposite."""
    cosine = ca.dot(source, target)
    half = ca.sqrt(ca.fmax(2 * (1 + cosine), 0))
    safe = ca.fmax(half, 1e-6)
    regular = ca.vertcat(half / 2, ca.cross(source, target) / safe)
    return ca.if_else(half > 1e-5, regular, ca.SX([0, 1, 0, 0]))


def _canonical(attitude: Expression) -> Expression:
    return ca.if_else(attitude[0] < 0, -attitude, attitude)


def rate_control(
    error: Expression, setpoint: Expression, acceleration: Expression, integral: Expression, gains: Values
) -> Expression:
    """Normalised torques of the rate PID with feed-forward. All (3,); gains: rate_gain_p, _d, _ff."""
    damping = gains["rate_gain_d"] * acceleration
    return gains["rate_gain_p"] * error + integral - damping + gains["rate_gain_ff"] * setpoint


def next_integral(
    integral: Expression, error: Expression, unallocated: Expression, gains: Values, dt: float
) -> Expression:
    """Integrators after dt: not wound further into a saturated axis, and hardly at large errors.

    unallocated: (3,) torque demand less allocated torque. gains: rate_gain_i, integral_limit.
    """
    usable = ca.if_else(unallocated > 1e-7, ca.fmin(error, 0), error)
    usable = ca.if_else(unallocated < -1e-7, ca.fmax(usable, 0), usable)
    fade = ca.fmax(0, 1 - (usable / INTEGRAL_FADES_AT) ** 2)
    limit = gains["integral_limit"]
    return ca.fmin(ca.fmax(integral + fade * gains["rate_gain_i"] * usable * dt, -limit), limit)


def butterworth(value: Expression, memory: Expression, cutoff: Expression, dt: float) -> tuple[Expression, Expression]:
    """Second-order Butterworth low-pass filter, one sample (PX4 LowPassFilter2p). memory: (2 n,) of values (n,).

    Returns the filtered value and the next memory. cutoff: Hz.
    """
    count = value.shape[0]
    ohm = ca.tan(np.pi * cutoff * dt)
    c = 1 + np.sqrt(2) * ohm + ohm**2
    b0 = ohm**2 / c
    a1, a2 = 2 * (ohm**2 - 1) / c, (1 - np.sqrt(2) * ohm + ohm**2) / c
    first, second = memory[:count], memory[count:]
    newest = value - first * a1 - second * a2
    return b0 * (newest + 2 * first + second), ca.vertcat(newest, first)


def low_pass(value: Expression, previous: Expression, cutoff: Expression, dt: float) -> Expression:
    """First-order low-pass filter, one sample (PX4 AlphaFilter); a cutoff of 0 Hz lets all through."""
    share = dt / (dt + 1 / (2 * np.pi * ca.fmax(cutoff, 1e-3)))
    return ca.if_else(cutoff > 0, previous + share * (value - previous), value)
