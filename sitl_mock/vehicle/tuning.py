"""Inner-loop gains for a vehicle: PX4's defaults for PX4's own quadrotor, scaled to any other.

PX4's defaults suit its SIH quadrotor; another vehicle is tuned until its body-rate loop is as fast as the motors
allow. The rule keeps the loop's shape: gains times authority over inertia, measured in units of the lag
of motor and gyro filter, stay what they are on the SIH quadrotor.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from dynamics.effect import Effect
from dynamics.effects import CATALOGUE
from dynamics.vehicle import EffectUse, Vehicle
from sitl_mock.vehicle.allocation import torque_authority
from sitl_mock.vehicle.vehicle_interface import Tuning

DEFAULT_MOTOR_LAG = 0.02  # s, for a vehicle that names none
ACTUATION_DELAY = 0.006  # from a gyro sample to the motors, s: PX4's cycle of 4 ms and half of the next one

# SIH: authority 2.83 N m over 0.025 kg m^2 = 113; x 0.15 (P) x 61.6 ms (motor 50, 40 Hz gyro filter 5.6, actuation 6)
TILT_SPEED = 1.046  # proportional rate gain in units of 1 / lag
TILT_DAMPING = 0.339  # derivative gain: 0.003 x 113
TILT_INTEGRAL = 0.0785  # integral over proportional gain, per proportional rate gain: 0.2 / 0.15 / 17
ATTITUDE_SPEED = 0.2357  # attitude gain per proportional rate gain: 4 / 17
DEFAULT_HOVER = 0.5  # MPC_THR_HOVER, kept where the hover thrust differs by less than 0.02
ATTITUDE_GAIN_MAX = 12.0  # PX4's own limit for MC_ROLL_P, 1/s
YAW_GAIN = 0.2  # a fifth of the yaw authority for 1 rad/s, PX4's default, where that is not too fast for the motors
MIN_YAW_FILTER = 0.016  # s: PX4 takes cutoffs up to 10 Hz (MC_YAW_TQ_CUTOFF)
YAW_SPEED = 0.3765  # yaw rate gain in units of 1 / (lag + torque filter)
GYRO_CUTOFF = 2.0  # Hz s: cutoff times motor time constant, 40 Hz at 50 ms


def motor_time_constant(effects: Sequence[EffectUse], catalogue: Mapping[str, Effect] = CATALOGUE) -> float:
    """Lag that the last effect on the rotors' speed gives the motors, s, or the default where none has a value."""
    lags = [
        sum(use.parameters[name] for name in catalogue[use.name].time_constants if name in use.parameters)
        for use in effects
        if catalogue[use.name].rotor_speed is not None
    ]
    return next((lag for lag in reversed(lags) if lag > 0), DEFAULT_MOTOR_LAG)


def default_tuning(
    vehicle: Vehicle, hidden: Sequence[EffectUse] = (), catalogue: Mapping[str, Effect] = CATALOGUE
) -> Tuning:
    """Gains derived from the vehicle; PX4's defaults for `vehicles/px4_sih.toml`.

    hidden: effects that the vehicle file does not name. The gains suit the real vehicle, slow motors included.
    """
    motor = motor_time_constant((*vehicle.effects, *hidden), catalogue)
    cutoff = min(max(GYRO_CUTOFF / motor, 30.0), 120.0)
    lag = motor + math.sqrt(2) / (2 * math.pi * cutoff) + ACTUATION_DELAY
    torque = torque_authority(vehicle) / np.array(vehicle.body.inertia)
    authority = [float(value) for value in torque]  # rad/s^2 for a unit of torque
    speed = TILT_SPEED / lag
    tilt_p = (speed / authority[0], speed / authority[1])
    yaw_p = min(YAW_GAIN, 0.5 * speed / max(authority[2], 1e-3))
    yaw_filter = max(YAW_SPEED / max(yaw_p * authority[2], 1e-3) - lag, MIN_YAW_FILTER)
    attitude = min(ATTITUDE_SPEED * speed, ATTITUDE_GAIN_MAX)
    return Tuning(
        attitude_gain=(attitude, attitude, 2.8),
        rate_gain_p=(*tilt_p, yaw_p),
        rate_gain_i=(TILT_INTEGRAL * speed * tilt_p[0], TILT_INTEGRAL * speed * tilt_p[1], 0.5 * yaw_p),
        rate_gain_d=(TILT_DAMPING / authority[0], TILT_DAMPING / authority[1], 0.0),
        thrust_model_factor=vehicle.rotors.thrust_curve,
        hover_thrust=vehicle.weight / vehicle.rotors.thrust_max,
        gyro_cutoff=cutoff,
        acceleration_cutoff=0.75 * cutoff,
        yaw_torque_cutoff=1 / (2 * math.pi * yaw_filter),
    )


def parameter_values(tuning: Tuning) -> dict[str, float]:
    """The tuning under PX4's parameter names and units, for the autopilot's parameter table."""
    values: dict[str, float] = {}
    for i, axis in enumerate(("ROLL", "PITCH", "YAW")):
        values[f"MC_{axis}_P"] = _rounded(tuning.attitude_gain[i])
        values[f"MC_{axis}RATE_P"] = _rounded(tuning.rate_gain_p[i])
        values[f"MC_{axis}RATE_I"] = _rounded(tuning.rate_gain_i[i])
        values[f"MC_{axis}RATE_D"] = _rounded(tuning.rate_gain_d[i])
        values[f"MC_{axis}RATE_MAX"] = math.degrees(tuning.rate_limit[i])
    values["THR_MDL_FAC"] = tuning.thrust_model_factor
    values["MPC_THR_HOVER"] = DEFAULT_HOVER if abs(tuning.hover_thrust - DEFAULT_HOVER) < 0.02 else tuning.hover_thrust
    values["IMU_GYRO_CUTOFF"] = tuning.gyro_cutoff
    values["IMU_DGYRO_CUTOFF"] = tuning.acceleration_cutoff
    values["MC_YAW_TQ_CUTOFF"] = tuning.yaw_torque_cutoff
    return values


def _rounded(gain: float) -> float:
    """A gain with three digits, which gives PX4's own quadrotor PX4's round numbers."""
    return float(f"{gain:.3g}")
