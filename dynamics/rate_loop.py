"""PX4's body-rate loop on a vehicle: the autopilot's gains, and the loop that they make with its rotors.

The gains are facts of the autopilot, the lag one of the vehicle: correcting the second leaves the first. They come from
the autopilot over a link, else from [autopilot] of the vehicle file, else from a rule: PX4's defaults suit its SIH
quadrotor; on another vehicle they are scaled so that the loop keeps its shape: gain times authority over inertia, in
units of the lag of motors, gyro filter and actuation, stays that of the SIH quadrotor. The mock's autopilot is tuned by
this rule, too, and the controller derives its lookaheads from the loop.

Source: PX4-Autopilot, defaults of MC_*RATE_P, IMU_GYRO_CUTOFF and MC_YAW_TQ_CUTOFF; SIH's motors lag by 50 ms. A
vehicle file without a lag gets the one of RotorS (Furrer et al. 2016) and of PX4's Gazebo models: 12.5 ms upwards and
25 ms downwards (timeConstantUp, timeConstantDown), 19 ms in the mean.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import msgspec
import numpy as np

from dynamics import symbolic
from dynamics.allocation import torque_authority
from dynamics.arrays import Floats
from dynamics.autopilot_settings import AutopilotSettings
from dynamics.effect import Effect
from dynamics.effects import CATALOGUE
from dynamics.effects.motor_lag import rotor_lag
from dynamics.model import build_model
from dynamics.own_effects import catalogue_of
from dynamics.trim import trim_authority
from dynamics.vehicle import EffectUse, Vehicle

DEFAULT_MOTOR_LAG = 0.02  # s, of a vehicle whose file has no motor lag; see above
ACTUATION_DELAY = 0.006  # s from a gyro sample to the motors: PX4's cycle of 4 ms and half of the next one
GYRO_CUTOFF = 2.0  # Hz s: cutoff times motor time constant, 40 Hz at 50 ms

# SIH: authority 2.83 N m over 0.025 kg m^2 = 113; x 0.15 (P) x 61.6 ms (motor 50, 40 Hz gyro filter 5.6, actuation 6)
TILT_SPEED = 1.046  # proportional rate gain in units of 1 / lag
YAW_GAIN = 0.2  # a fifth of the yaw authority for 1 rad/s, PX4's default, where that is not too fast for the motors
YAW_SPEED = 0.3765  # yaw rate gain in units of 1 / (lag + torque filter)
TILT_INTEGRAL = 0.0785  # integral over proportional gain, per proportional rate gain: 0.2 / 0.15 / 17
TILT_DAMPING = 0.339  # derivative gain times authority: 0.003 x 113
MIN_YAW_FILTER = 0.016  # s: PX4 takes cutoffs up to 10 Hz (MC_YAW_TQ_CUTOFF)


@dataclass(frozen=True)
class RateLoop:
    """The loop from body-rate setpoints to body rates.

    motor_lag: time constant of the rotors, s.
    gyro_cutoff: of the gyro filter, Hz.
    lag: of motors, gyro filter and actuation together, s.
    authority: angular acceleration of a unit of normalised torque, body x, y, z, rad/s^2.
    rate_gain: proportional gains, normalised torque for 1 rad/s about x, y, z.
    yaw_filter: time constant of the yaw torque's low-pass, s.
    """

    motor_lag: float
    gyro_cutoff: float
    lag: float
    authority: tuple[float, float, float]
    rate_gain: tuple[float, float, float]
    yaw_filter: float

    @property
    def tilt_speed(self) -> float:
        """Proportional gain of roll and pitch times authority, their geometric mean, 1/s."""
        return math.sqrt(math.prod(self.rate_gain[axis] * self.authority[axis] for axis in (0, 1)))

    @property
    def tilt_time(self) -> float:
        """Delay with which roll and pitch rates follow their setpoints, s: a loop of first order behind the lag."""
        return 1 / self.tilt_speed + self.lag

    @property
    def yaw_time(self) -> float:
        """Delay with which the yaw rate follows its setpoint, s; infinite without yaw authority."""
        speed = self.rate_gain[2] * self.authority[2]
        return 1 / speed + self.lag + self.yaw_filter if speed > 0 else math.inf


@dataclass(frozen=True)
class RateController:
    """PX4's PID of body rates: gains about x, y, z of normalised torque, and cutoffs of its filters, Hz."""

    p: tuple[float, float, float]
    i: tuple[float, float, float]
    d: tuple[float, float, float]
    gyro_cutoff: float
    acceleration_cutoff: float
    yaw_torque_cutoff: float


def rate_loop(
    vehicle: Vehicle,
    hidden: Sequence[EffectUse] = (),
    catalogue: Mapping[str, Effect] = CATALOGUE,
    gains: AutopilotSettings | None = None,
) -> RateLoop:
    """The loop on a vehicle. hidden: effects that its file does not name.

    gains: the autopilot's; by default those of the vehicle file, else gains that suit the motors.
    """
    gains = gains or autopilot_gains(vehicle, hidden, catalogue)
    motor = motor_time_constant((*vehicle.effects, *hidden), catalogue_of(vehicle, catalogue))
    roll, pitch, yaw = (float(value) for value in angular_authority(vehicle, catalogue))
    return RateLoop(
        motor,
        gains.gyro_cutoff,
        _lag(motor, gains.gyro_cutoff),
        (roll, pitch, yaw),
        gains.rate_gain,
        1 / (2 * math.pi * gains.yaw_torque_cutoff),
    )


def autopilot_gains(
    vehicle: Vehicle, hidden: Sequence[EffectUse] = (), catalogue: Mapping[str, Effect] = CATALOGUE
) -> AutopilotSettings:
    """The gains of the vehicle file's [autopilot], else gains that suit its motors.

    hidden: effects that its file does not name; the gains suit the real motors.
    """
    if vehicle.autopilot is not None:
        return vehicle.autopilot
    motor = motor_time_constant((*vehicle.effects, *hidden), catalogue_of(vehicle, catalogue))
    cutoff = min(max(GYRO_CUTOFF / motor, 30.0), 120.0)
    lag = _lag(motor, cutoff)
    # without the effects on body and rotors: a correction of those does not turn the autopilot's gains
    roll, pitch, yaw = (float(value) for value in torque_authority(vehicle) / np.array(vehicle.body.inertia))
    speed = TILT_SPEED / lag
    yaw_gain = min(YAW_GAIN, 0.5 * speed / max(yaw, 1e-3))
    yaw_filter = max(YAW_SPEED / max(yaw_gain * yaw, 1e-3) - lag, MIN_YAW_FILTER)
    return AutopilotSettings((speed / roll, speed / pitch, yaw_gain), cutoff, 1 / (2 * math.pi * yaw_filter))


def rate_controller(vehicle: Vehicle, gains: AutopilotSettings) -> RateController:
    """The whole controller with these gains: integral and derivative gains in the shape of PX4's own.

    vehicle: as the autopilot's owner knows it, without effects.
    """
    authority = torque_authority(vehicle) / np.array(vehicle.body.inertia)
    speed = math.sqrt(math.prod(gains.rate_gain[axis] * float(authority[axis]) for axis in (0, 1)))
    roll, pitch, yaw = gains.rate_gain
    return RateController(
        p=gains.rate_gain,
        i=(TILT_INTEGRAL * speed * roll, TILT_INTEGRAL * speed * pitch, 0.5 * yaw),
        d=(TILT_DAMPING / speed * roll, TILT_DAMPING / speed * pitch, 0.0),
        gyro_cutoff=gains.gyro_cutoff,
        acceleration_cutoff=0.75 * gains.gyro_cutoff,
        yaw_torque_cutoff=gains.yaw_torque_cutoff,
    )


def with_gains_kept(before: Vehicle, after: Vehicle, catalogue: Mapping[str, Effect] = CATALOGUE) -> Vehicle:
    """A corrected vehicle with the gains of the file before the correction, where its motors' lag was corrected.

    A file that states a lag states what its autopilot was tuned for; the model's correction turns no gain. One without
    a lag states nothing: there the gains suit the first lag that is found.
    """
    catalogue = catalogue_of(after, catalogue)
    lags = [modelled_motor_lag(vehicle.effects, catalogue) for vehicle in (before, after)]
    if after.autopilot is not None or lags[0] == 0.0 or lags[0] == lags[1]:
        return after
    return msgspec.structs.replace(after, autopilot=autopilot_gains(before, catalogue=catalogue))


def angular_authority(vehicle: Vehicle, catalogue: Mapping[str, Effect] = CATALOGUE) -> Floats:
    """Angular acceleration of a unit of normalised torque about body x, y, z, rad/s^2, in hover. Returns (3,).

    With the effects on body and rotors, where CasADi is installed.
    """
    own = catalogue_of(vehicle, catalogue)
    changed = tuple(use for use in vehicle.effects if own[use.name].physics is not None)
    if not changed or not symbolic.is_installed():
        return np.asarray(torque_authority(vehicle) / np.array(vehicle.body.inertia))
    return trim_authority(build_model(vehicle, effects=changed, catalogue=catalogue))


def _lag(motor: float, cutoff: float) -> float:
    return motor + math.sqrt(2) / (2 * math.pi * cutoff) + ACTUATION_DELAY


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
