"""Inner-loop gains for a vehicle: PX4's defaults for PX4's own quadrotor, scaled to any other.

PX4's defaults suit its SIH quadrotor; another vehicle is tuned until its body-rate loop is as fast as the motors
allow. The rule keeps the loop's shape: gains times authority over inertia, in units of the lag of motor and gyro
filter, stay what they are on the SIH quadrotor.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from dynamics.effect import Effect
from dynamics.effects import CATALOGUE
from dynamics.rate_loop import rate_loop
from dynamics.vehicle import EffectUse, Vehicle
from sitl_mock.vehicle.vehicle_interface import Tuning

# Shape of PX4's SIH quadrotor's loops; `dynamics.rate_loop` has the proportional gains
TILT_DAMPING = 0.339  # derivative gain: 0.003 x 113
TILT_INTEGRAL = 0.0785  # integral over proportional gain, per proportional rate gain: 0.2 / 0.15 / 17
ATTITUDE_SPEED = 0.2357  # attitude gain per proportional rate gain: 4 / 17
DEFAULT_HOVER = 0.5  # MPC_THR_HOVER, kept where the hover thrust differs by less than 0.02
ATTITUDE_GAIN_MAX = 12.0  # PX4's own limit for MC_ROLL_P, 1/s


def default_tuning(
    vehicle: Vehicle, hidden: Sequence[EffectUse] = (), catalogue: Mapping[str, Effect] = CATALOGUE
) -> Tuning:
    """Gains derived from the vehicle; PX4's defaults for `vehicles/px4_sih.toml`.

    hidden: effects that the vehicle file does not name. The gains suit the real vehicle, slow motors included.
    """
    loop = rate_loop(vehicle, hidden, catalogue)
    speed, authority, yaw_p = loop.tilt_speed, loop.authority, loop.yaw_gain
    tilt_p = (speed / authority[0], speed / authority[1])
    attitude = min(ATTITUDE_SPEED * speed, ATTITUDE_GAIN_MAX)
    return Tuning(
        attitude_gain=(attitude, attitude, 2.8),
        rate_gain_p=(*tilt_p, yaw_p),
        rate_gain_i=(TILT_INTEGRAL * speed * tilt_p[0], TILT_INTEGRAL * speed * tilt_p[1], 0.5 * yaw_p),
        rate_gain_d=(TILT_DAMPING / authority[0], TILT_DAMPING / authority[1], 0.0),
        thrust_model_factor=vehicle.rotors.thrust_curve,
        hover_thrust=vehicle.weight / vehicle.rotors.thrust_max,
        gyro_cutoff=loop.gyro_cutoff,
        acceleration_cutoff=0.75 * loop.gyro_cutoff,
        yaw_torque_cutoff=1 / (2 * math.pi * loop.yaw_filter),
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
