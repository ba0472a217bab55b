"""PX4's body-rate loop on a vehicle, with the gains that suit its motors.

PX4's default gains suit its SIH quadrotor. On another vehicle they are scaled so that the loop keeps its shape: gain
times authority over inertia, in units of the lag of motors, gyro filter and actuation, stays that of the SIH quadrotor.
The mock's autopilot is tuned by this rule, and the controller derives its lookaheads from it.

Source: PX4-Autopilot, defaults of MC_*RATE_P, IMU_GYRO_CUTOFF and MC_YAW_TQ_CUTOFF; SIH's motors lag by 50 ms. A
vehicle file without a lag gets the one of RotorS (Furrer et al. 2016) and of PX4's Gazebo models: 12.5 ms upwards and
25 ms downwards (timeConstantUp, timeConstantDown), 19 ms in the mean.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from dynamics.allocation import torque_authority
from dynamics.effect import Effect
from dynamics.effects import CATALOGUE
from dynamics.effects.motor_lag import rotor_lag
from dynamics.own_effects import catalogue_of
from dynamics.vehicle import EffectUse, Vehicle

DEFAULT_MOTOR_LAG = 0.02  # s, of a vehicle whose file has no motor lag; see above
ACTUATION_DELAY = 0.006  # s from a gyro sample to the motors: PX4's cycle of 4 ms and half of the next one
GYRO_CUTOFF = 2.0  # Hz s: cutoff times motor time constant, 40 Hz at 50 ms

# SIH: authority 2.83 N m over 0.025 kg m^2 = 113; x 0.15 (P) x 61.6 ms (motor 50, 40 Hz gyro filter 5.6, actuation 6)
TILT_SPEED = 1.046  # proportional rate gain in units of 1 / lag
YAW_GAIN = 0.2  # a fifth of the yaw authority for 1 rad/s, PX4's default, where that is not too fast for the motors
YAW_SPEED = 0.3765  # yaw rate gain in units of 1 / (lag + torque filter)
MIN_YAW_FILTER = 0.016  # s: PX4 takes cutoffs up to 10 Hz (MC_YAW_TQ_CUTOFF)


@dataclass(frozen=True)
class RateLoop:
    """The loop from body-rate setpoints to body rates.

    motor_lag: time constant of the rotors, s.
    gyro_cutoff: of the gyro filter, Hz.
    lag: of motors, gyro filter and actuation together, s.
    authority: angular acceleration of a unit of normalised torque, body x, y, z, rad/s^2.
    tilt_speed: proportional gain of roll and pitch times authority, 1/s.
    yaw_gain: proportional gain of yaw.
    yaw_filter: time constant of the yaw torque's low-pass, s.
    """

    motor_lag: float
    gyro_cutoff: float
    lag: float
    authority: tuple[float, float, float]
    tilt_speed: float
    yaw_gain: float
    yaw_filter: float

    @property
    def tilt_time(self) -> float:
        """Delay with which roll and pitch rates follow their setpoints, s: a loop of first order behind the lag."""
        return 1 / self.tilt_speed + self.lag

    @property
    def yaw_time(self) -> float:
        """Delay with which the yaw rate follows its setpoint, s; infinite without yaw authority."""
        speed = self.yaw_gain * self.authority[2]
        return 1 / speed + self.lag + self.yaw_filter if speed > 0 else math.inf


def rate_loop(
    vehicle: Vehicle, hidden: Sequence[EffectUse] = (), catalogue: Mapping[str, Effect] = CATALOGUE
) -> RateLoop:
    """The loop on a vehicle. hidden: effects that its file does not name; the gains suit the real vehicle."""
    motor = motor_time_constant((*vehicle.effects, *hidden), catalogue_of(vehicle, catalogue))
    cutoff = min(max(GYRO_CUTOFF / motor, 30.0), 120.0)
    lag = motor + math.sqrt(2) / (2 * math.pi * cutoff) + ACTUATION_DELAY
    torque = torque_authority(vehicle) / np.array(vehicle.body.inertia)
    roll, pitch, yaw = (float(value) for value in torque)
    speed = TILT_SPEED / lag
    yaw_gain = min(YAW_GAIN, 0.5 * speed / max(yaw, 1e-3))
    yaw_filter = max(YAW_SPEED / max(yaw_gain * yaw, 1e-3) - lag, MIN_YAW_FILTER)
    return RateLoop(motor, cutoff, lag, (roll, pitch, yaw), speed, yaw_gain, yaw_filter)


def motor_time_constant(effects: Sequence[EffectUse], catalogue: Mapping[str, Effect] = CATALOGUE) -> float:
    """Lag that the last effect on the rotors' speed gives the motors, s, or the default where none has a value."""
    return modelled_motor_lag(effects, catalogue) or DEFAULT_MOTOR_LAG


def with_motor_lag(uses: Sequence[EffectUse], catalogue: Mapping[str, Effect] = CATALOGUE) -> tuple[EffectUse, ...]:
    """These effects and, where none of them acts on the rotors' speed, the lag that every real motor has."""
    if any(catalogue[use.name].rotor_speed is not None for use in uses):
        return tuple(uses)
    return (*uses, rotor_lag(DEFAULT_MOTOR_LAG))


def modelled_motor_lag(effects: Sequence[EffectUse], catalogue: Mapping[str, Effect] = CATALOGUE) -> float:
    """The rotors' lag that a model with these effects predicts itself, s; 0 where none has a value."""
    lags = [
        sum(use.parameters[name] for name in catalogue[use.name].time_constants if name in use.parameters)
        for use in effects
        if catalogue[use.name].rotor_speed is not None
    ]
    return next((lag for lag in reversed(lags) if lag > 0), 0.0)
