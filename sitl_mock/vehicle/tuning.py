"""Inner-loop gains for a vehicle: PX4's defaults for PX4's own quadrotor, scaled to any other.

PX4's defaults suit its SIH quadrotor; another vehicle is tuned until its body-rate loop is as fast as the motors
allow. The rule keeps the loop's shape: gains times authority over inertia, in units of the lag of motor and gyro
filter, stay what they are on the SIH quadrotor.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from dynamics.autopilot_settings import AutopilotSettings
from dynamics.effect import Effect
from dynamics.effects import CATALOGUE
from dynamics.rate_loop import autopilot_gains, rate_controller, rate_loop
from dynamics.vehicle import EffectUse, Vehicle
from sitl_mock.vehicle.vehicle_interface import Tuning

# Shape of PX4's SIH quadrotor's loops; `dynamics.rate_loop` has the rates' gains
ATTITUDE_SPEED = 0.2357  # attitude gain per proportional rate gain: 4 / 17
DEFAULT_HOVER = 0.5  # MPC_THR_HOVER, kept where the hover thrust differs by less than 0.02
ATTITUDE_GAIN_MAX = 12.0  # PX4's own limit for MC_ROLL_P, 1/s


def default_tuning(
    vehicle: Vehicle, hidden: Sequence[EffectUse] = (), catalogue: Mapping[str, Effect] = CATALOGUE
) -> Tuning:
    """Gains of the vehicle file's [autopilot], else derived from the vehicle; PX4's for `vehicles/px4_sih.toml`.

    hidden: effects that the vehicle file does not name. Derived gains suit the real vehicle, slow motors included.
    """
    gains = autopilot_gains(vehicle, hidden, catalogue)
    inner = rate_controller(vehicle, gains)
    attitude = min(ATTITUDE_SPEED * rate_loop(vehicle, hidden, catalogue, gains).tilt_speed, ATTITUDE_GAIN_MAX)
    return Tuning(
        attitude_gain=(attitude, attitude, 2.8),
        rate_gain_p=inner.p,
        rate_gain_i=inner.i,
        rate_gain_d=inner.d,
        thrust_model_factor=vehicle.rotors.thrust_curve,
        hover_thrust=vehicle.weight / vehicle.rotors.thrust_max,
        gyro_cutoff=inner.gyro_cutoff,
        acceleration_cutoff=inner.acceleration_cutoff,
        yaw_torque_cutoff=inner.yaw_torque_cutoff,
    )


def rate_gains(tuning: Tuning) -> AutopilotSettings:
    """The gains of the rate loop, as a companion reads them from the autopilot."""
    return AutopilotSettings(tuning.rate_gain_p, tuning.gyro_cutoff, tuning.yaw_torque_cutoff)


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
