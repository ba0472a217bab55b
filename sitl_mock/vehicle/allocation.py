"""From normalised torques and thrust to motor signals, as PX4's control allocator does it.

Source: PX4-Autopilot, ControlAllocationSequentialDesaturation.cpp (saturation, airmode off), MixingOutput
(THR_MDL_FAC). All in FLU axes; `dynamics.allocation` has the mixer.
"""

from __future__ import annotations

from dynamics import symbolic as ca
from dynamics.effect import Expression

YAW_MARGIN = 0.15  # demand of yaw beyond full signal, at the expense of thrust


def allocate(mix: Expression, demand: Expression) -> Expression:
    """Motor thrusts of 0..1 for a demand: roll and pitch before thrust, thrust before yaw, and never more thrust.

    mix: (rotors, 4). demand: (4,) torque x, y, z and thrust, normalised.
    """
    roll, pitch, yaw, thrust = (mix[:, i] for i in range(4))
    motors = roll * demand[0] + pitch * demand[1] + thrust * demand[3]
    motors = _desaturate(motors, -thrust, only_forward=True)
    motors = _desaturate(motors, roll)
    motors = _desaturate(motors, pitch)
    motors = motors + yaw * demand[2]
    motors = _desaturate(motors, yaw, upper=1 + YAW_MARGIN)
    motors = _desaturate(motors, -thrust, only_forward=True)
    return ca.fmin(ca.fmax(motors, 0), 1)


def _desaturate(
    motors: Expression, direction: Expression, *, upper: float = 1.0, only_forward: bool = False
) -> Expression:
    """Move motors along a direction until as little as possible is out of range: once fully, once by half."""
    gain = _desaturation_gain(motors, direction, upper)
    step = ca.fmax(gain, 0) if only_forward else gain
    moved = motors + step * direction
    again = moved + 0.5 * _desaturation_gain(moved, direction, upper) * direction
    return ca.if_else(gain < 0, motors, again) if only_forward else again


def _desaturation_gain(motors: Expression, direction: Expression, upper: float) -> Expression:
    smallest, largest = ca.SX(0), ca.SX(0)
    for i in range(motors.shape[0]):
        excess = ca.fmin(ca.fmax(motors[i], 0), upper) - motors[i]
        usable = ca.fabs(direction[i]) > 1e-7
        gain = excess * ca.if_else(usable, 1 / ca.if_else(usable, direction[i], 1), 0)  # one division for all calls
        smallest, largest = ca.fmin(smallest, gain), ca.fmax(largest, gain)
    return smallest + largest


def signal_for_thrust(thrust: Expression, model_factor: Expression) -> Expression:
    """Motor signal of a motor thrust of 0..1: the inverse of f s^2 + (1 - f) s, f being THR_MDL_FAC."""
    linear = 1 - model_factor
    safe = ca.fmax(model_factor, 1e-6)
    root = (-linear + ca.sqrt(linear**2 + 4 * safe * ca.fmax(thrust, 0))) / (2 * safe)
    return ca.if_else(model_factor > 1e-6, root, thrust)


def rotor_speed_command(signal: Expression, *, curve: Expression, speed_max: Expression) -> Expression:
    """Rotor speed that a motor settles at under a signal: thrust/thrust_max = c s^2 + (1 - c) s. rad/s."""
    return speed_max * ca.sqrt(ca.fmax(curve * signal**2 + (1 - curve) * signal, 0))
