"""The interface between the wire side and the flying vehicle, in ENU world and FLU body axes.

The autopilot's wire half (commander, streams, links) uses a `Vehicle` and nothing else of the plant; the vehicle
is independent of MAVLink.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal, Protocol

import numpy as np

from dynamics.arrays import Floats

ControlKind = Literal["idle", "rates", "attitude", "hold", "land", "rtl"]


def _unset() -> Floats:
    return np.full(3, np.nan)


def _level() -> Floats:
    return np.array([1.0, 0.0, 0.0, 0.0])


@dataclass(frozen=True, slots=True)
class ControlSetpoint:
    """Setpoint that the vehicle flies until it receives another one.

    kind: idle (armed, rotors at minimum speed), rates, attitude, or a position mode that the vehicle flies by itself:
        hold (to position_world where finite, by velocity_world where that is finite instead, otherwise where it was
        when the kind changed), land, rtl (climb to the return altitude above home, return, land).
    attitude: (4,) body to world, any sign, unit norm.
    rate_body: (3,) rad/s; a NaN leaves its axis without control; with kind attitude a feed-forward of which only the
        yaw rate is used.
    thrust: collective, 0..1 of the maximum, not clamped on the wire.
    position_world, velocity_world: (3,) m and m/s, for kind hold; NaN for axes without a setpoint.
    acceleration_world: (3,) m/s^2, for kind hold: added to the position and velocity control, and followed alone where
        neither has a setpoint.
    yaw, yaw_rate: rad and rad/s, for kind hold; NaN for the present heading.
    """

    kind: ControlKind
    attitude: Floats = field(default_factory=_level)
    rate_body: Floats = field(default_factory=lambda: np.zeros(3))
    thrust: float = 0.0
    position_world: Floats = field(default_factory=_unset)
    velocity_world: Floats = field(default_factory=_unset)
    acceleration_world: Floats = field(default_factory=_unset)
    yaw: float = float("nan")
    yaw_rate: float = float("nan")


@dataclass(frozen=True, slots=True)
class MotionState:
    """Rigid-body state of the vehicle.

    time: simulated, s.
    position_world: (3,) m.
    velocity_world: (3,) m/s.
    attitude: (4,) body to world.
    rate_body: (3,) rad/s.
    """

    time: float
    position_world: Floats
    velocity_world: Floats
    attitude: Floats
    rate_body: Floats


@dataclass(frozen=True, slots=True)
class ImuSample:
    """One inertial measurement.

    time: simulated, s.
    specific_force_body: (3,) m/s^2.
    rate_body: (3,) rad/s.
    """

    time: float
    specific_force_body: Floats
    rate_body: Floats


@dataclass(frozen=True, slots=True)
class BatteryState:
    """State of the battery.

    voltage: at the terminals, V.
    current: A.
    remaining: charge, 0..1.
    """

    voltage: float
    current: float
    remaining: float


@dataclass(frozen=True, slots=True)
class Tuning:
    """The autopilot parameters that the inner loops use, under PX4's names and units.

    The defaults are PX4's; `sitl_mock.vehicle.tuning.default_tuning` derives those of a vehicle file.

    attitude_gain: MC_ROLL_P, MC_PITCH_P, MC_YAW_P, 1/s.
    rate_gain_p, rate_gain_i, rate_gain_d, rate_gain_ff: MC_{ROLL,PITCH,YAW}RATE_{P,I,D,FF}.
    rate_limit: MC_{ROLL,PITCH,YAW}RATE_MAX, rad/s.
    thrust_model_factor: THR_MDL_FAC.
    hover_thrust: MPC_THR_HOVER.
    return_altitude: RTL_RETURN_ALT, m.
    land_speed: MPC_LAND_SPEED, m/s.
    integral_limit: MC_{RR,PR,YR}_INT_LIM.
    yaw_weight: MC_YAW_WEIGHT.
    gyro_cutoff: IMU_GYRO_CUTOFF, Hz.
    acceleration_cutoff: IMU_DGYRO_CUTOFF, Hz.
    yaw_torque_cutoff: MC_YAW_TQ_CUTOFF, Hz.
    """

    attitude_gain: tuple[float, float, float] = (4.0, 4.0, 2.8)
    rate_gain_p: tuple[float, float, float] = (0.15, 0.15, 0.2)
    rate_gain_i: tuple[float, float, float] = (0.2, 0.2, 0.1)
    rate_gain_d: tuple[float, float, float] = (0.003, 0.003, 0.0)
    rate_limit: tuple[float, float, float] = (3.839724354387525, 3.839724354387525, 3.490658503988659)
    thrust_model_factor: float = 0.0
    hover_thrust: float = 0.5
    return_altitude: float = 30.0
    land_speed: float = 0.7
    rate_gain_ff: tuple[float, float, float] = (0.0, 0.0, 0.0)
    integral_limit: tuple[float, float, float] = (0.3, 0.3, 0.3)
    yaw_weight: float = 0.4
    gyro_cutoff: float = 40.0
    acceleration_cutoff: float = 30.0
    yaw_torque_cutoff: float = 2.0


class Vehicle(Protocol):
    """A vehicle with its inner loops, plant, sensors and battery. Bit-reproducible for a seed."""

    @property
    def time(self) -> float:
        """Simulated time, s."""

    @property
    def truth(self) -> MotionState:
        """The plant's state."""

    @property
    def estimate(self) -> MotionState:
        """The estimator's output: delayed (see its time) and noisy."""

    @property
    def imu(self) -> ImuSample:
        """The newest inertial measurement."""

    @property
    def rotor_speed(self) -> Floats:
        """(rotors,) rad/s, in the vehicle file's order."""

    @property
    def motor_signal(self) -> Floats:
        """(rotors,) 0..1, in the vehicle file's order."""

    @property
    def rotor_position(self) -> Floats:
        """(rotors, 3) m, body FLU."""

    @property
    def battery(self) -> BatteryState:
        """The battery now."""

    @property
    def on_ground(self) -> bool:
        """Whether the vehicle's land detector has detected a landing."""

    @property
    def ground_force(self) -> float:
        """Share of the weight that the ground carries now."""

    @property
    def has_position(self) -> bool:
        """Whether the estimator calls its horizontal position and velocity valid."""

    def hold(self, held: bool) -> None:
        """Let a hand hold the vehicle where it is, or let go of it."""

    def knock(self, rate_body: Floats) -> None:
        """Turn the vehicle by a blow. rate_body: (3,) rad/s that it adds."""

    def change(self, values: Mapping[str, float]) -> None:
        """Change constants of the flight model from now on, by name."""

    def use_gnss(self, available: bool) -> None:
        """Take satellite navigation from the estimator, or give it back."""

    def advance(self, setpoint: ControlSetpoint, armed: bool, duration: float) -> None:
        """Simulate a duration (s) under a setpoint; rotors stand still when not armed."""

    def tune(self, tuning: Tuning) -> None:
        """Use other inner-loop parameters from now on."""
