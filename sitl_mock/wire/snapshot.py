"""Everything that one pass of the mavlink loop may put on the wire, in NED and FRD, computed once."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from dynamics.arrays import Floats
from dynamics.quaternion import nearest_sign
from sitl_mock.vehicle.clock import VehicleClock
from sitl_mock.vehicle.vehicle_interface import BatteryState, ControlSetpoint, MotionState, Vehicle
from sitl_mock.wire.estimate_fault import EstimateFault
from sitl_mock.wire.wire_axes import attitude_ned_frd, enu_from_ned, flu_from_frd

# where PX4's SITL puts its origin: near Zurich
ORIGIN_LATITUDE, ORIGIN_LONGITUDE, ORIGIN_ALTITUDE = 47.3977428, 8.5455967, 489.0  # deg, deg, m above the sea
METRES_PER_DEGREE = 111_194.93  # of latitude, on PX4's sphere of 6,371 km
PRESSURE_AT_SEA, SCALE_HEIGHT = 1013.25, 8434.0  # hPa, m
# SYS_STATUS bits as recorded from PX4: gyro, accelerometer, magnetometer, barometer, GPS, position control, logging
# and battery are there; a radio is enabled but absent; motors, attitude control, AHRS and airspeed only healthy
SENSORS = 1 | 2 | 4 | 8 | 32 | (1 << 14) | (1 << 24) | (1 << 25)
RADIO = 1 << 16
ALSO_HEALTHY = 16 | (1 << 11) | (1 << 15) | (1 << 21)
PREARM_CHECK = 1 << 28


@dataclass(frozen=True, slots=True)
class Motion:
    """The estimate in the autopilot's axes.

    position, velocity: NED, m and m/s.
    attitude: FRD to NED, w first.
    rate: FRD, rad/s.
    euler: roll, pitch, yaw of the attitude, rad.
    """

    position: list[float]
    velocity: list[float]
    attitude: list[float]
    rate: list[float]
    euler: tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class AttitudeSetpoint:
    """The setpoint of the inner loops, for ATTITUDE_TARGET.

    attitude: FRD to NED, w first.
    rate: FRD, rad/s.
    thrust: 0..1.
    """

    attitude: list[float]
    rate: list[float]
    thrust: float


class MotionEncoder:
    """Converts estimates to the autopilot's axes, with quaternions continuous in sign."""

    def __init__(self) -> None:
        self._last = np.array([1.0, 0.0, 0.0, 0.0])

    def encode(self, state: MotionState) -> Motion:
        """The wire's view of an estimate."""
        attitude = nearest_sign(attitude_ned_frd(state.attitude), self._last)
        if math.isfinite(float(attitude[0])):
            self._last = attitude
        return Motion(
            ned(state.position_world),
            ned(state.velocity_world),
            attitude.tolist(),
            frd(state.rate_body),
            _euler(*attitude.tolist()),
        )


@dataclass(frozen=True, slots=True)
class VehicleStatus:
    """The commander's and the navigator's part of a snapshot.

    base_mode, custom_mode, system_status, vehicle_type: as in HEARTBEAT.
    landed_state: MAV_LANDED_STATE.
    armable: arming would be allowed.
    child_frame: MAV_FRAME of ODOMETRY's velocity.
    epoch: unix time at boot, s.
    home: (3,) NED, m.
    setpoint: what is followed now.
    """

    base_mode: int
    custom_mode: int
    system_status: int
    landed_state: int
    armable: bool
    vehicle_type: int
    child_frame: int
    epoch: float
    home: list[float]
    setpoint: ControlSetpoint


class Snapshot:
    """The state of the vehicle for one pass of the loop; parts that no message needs are never computed."""

    def __init__(
        self,
        time: float,
        vehicle: Vehicle,
        clock: VehicleClock,
        fault: EstimateFault,
        encoder: MotionEncoder,
        order: list[int],
        status: VehicleStatus,
    ):
        self.now = clock.at(time)
        self.status = status
        self.reset_counter = fault.reset_counter
        self.estimate_valid = not fault.invalid
        self.position_valid, self.gnss_glitch = fault.has_position, fault.gnss_glitch
        self._vehicle, self._clock, self._fault, self._encoder, self._order = vehicle, clock, fault, encoder, order

    @cached_property
    def _estimate(self) -> MotionState:
        return self._fault.reported(self._vehicle.estimate)

    @cached_property
    def motion(self) -> Motion:
        """The estimate in the autopilot's axes."""
        return self._encoder.encode(self._estimate)

    @cached_property
    def estimate_time(self) -> float:
        """Vehicle time at which the estimate held, s."""
        return self._clock.at(self._estimate.time) + self._fault.lead

    @cached_property
    def imu(self) -> tuple[int, list[float], list[float]]:
        """Microseconds, specific force and rates in FRD."""
        sample = self._vehicle.imu
        return int(self._clock.at(sample.time) * 1e6), frd(sample.specific_force_body), frd(sample.rate_body)

    @cached_property
    def rotor_speed(self) -> list[float]:
        """rad/s in PX4's motor order."""
        return [float(speed) for speed in self._vehicle.rotor_speed[self._order]]

    @cached_property
    def motor_signal(self) -> list[float]:
        """0..1 in PX4's motor order."""
        return [float(signal) for signal in self._vehicle.motor_signal[self._order]]

    @cached_property
    def battery(self) -> BatteryState:
        """The battery."""
        return self._vehicle.battery

    @cached_property
    def setpoint(self) -> AttitudeSetpoint:
        """The setpoint of the inner loops; in the modes that have none, the vehicle's own attitude and thrust."""
        active = self.status.setpoint
        if active.kind in ("rates", "attitude"):
            return AttitudeSetpoint(attitude_ned_frd(active.attitude).tolist(), frd(active.rate_body), active.thrust)
        thrust = sum(self.motor_signal) / len(self.motor_signal)
        return AttitudeSetpoint(self.motion.attitude, [0.0, 0.0, 0.0], thrust)

    @cached_property
    def target_position(self) -> list[float] | None:
        """Where a position mode flies to, NED, m."""
        active = self.status.setpoint
        return ned(active.position_world) if active.kind == "hold" else None

    @property
    def boot_ms(self) -> int:
        """The estimate's time as time_boot_ms."""
        return int(self.estimate_time * 1e3) & 0xFFFFFFFF

    @property
    def estimate_us(self) -> int:
        """The estimate's time in microseconds."""
        return int(self.estimate_time * 1e6)

    @property
    def now_us(self) -> int:
        """The time of the pass in microseconds."""
        return int(self.now * 1e6)


def ned(vector_enu: Floats) -> list[float]:
    """A world vector (3,) as the wire carries it."""
    numbers: list[float] = enu_from_ned(vector_enu).tolist()
    return numbers


def frd(vector_flu: Floats) -> list[float]:
    """A body vector (3,) as the wire carries it."""
    numbers: list[float] = flu_from_frd(vector_flu).tolist()
    return numbers


def _euler(w: float, x: float, y: float, z: float) -> tuple[float, float, float]:
    # plain floats, because this runs in every pass and dynamics.quaternion.to_euler is made for whole logs
    roll = math.atan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))
    sine = 2 * (w * y - z * x)
    pitch = math.asin(max(-1.0, min(1.0, sine))) if sine == sine else math.nan
    return roll, pitch, math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))


def motor_order(rotor_position: Floats) -> list[int]:
    """For each of PX4's motors, the index of ours.

    PX4's quadrotor: 1 front right, 2 back left, 3 front left, 4 back right. Other layouts keep the vehicle file's
    order. rotor_position: (rotors, 3) m, body FLU.
    """
    if len(rotor_position) == 4:
        corners = [(1, -1), (-1, 1), (1, 1), (-1, -1)]
        signs = [(int(np.sign(x)), int(np.sign(y))) for x, y in rotor_position[:, :2]]
        if sorted(signs) == sorted(corners):
            return [signs.index(corner) for corner in corners]
    return list(range(len(rotor_position)))


def latitude_longitude(position_ned: list[float]) -> tuple[int, int]:
    """Position (m from the origin) as MAVLink's 1e-7 degrees."""
    north, east = position_ned[0], position_ned[1]
    latitude = ORIGIN_LATITUDE + north / METRES_PER_DEGREE
    longitude = ORIGIN_LONGITUDE + east / (METRES_PER_DEGREE * math.cos(math.radians(ORIGIN_LATITUDE)))
    return round(latitude * 1e7), round(longitude * 1e7)


def local_from_global(latitude_e7: float, longitude_e7: float) -> tuple[float, float]:
    """North and east of the origin, m, of a position in MAVLink's 1e-7 degrees."""
    scale = METRES_PER_DEGREE * math.cos(math.radians(ORIGIN_LATITUDE))
    return (
        (latitude_e7 * 1e-7 - ORIGIN_LATITUDE) * METRES_PER_DEGREE,
        (longitude_e7 * 1e-7 - ORIGIN_LONGITUDE) * scale,
    )
