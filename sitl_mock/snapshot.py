"""Everything that one pass of the mavlink loop may put on the wire, in NED and FRD, computed once."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from dynamics.frames import attitude_ned_frd, enu_from_ned, flu_from_frd
from dynamics.quaternion import nearest_sign
from sitl_mock.vehicle_interface import MotionState, Vector

# where PX4's SITL puts its origin: near Zurich
ORIGIN_LATITUDE, ORIGIN_LONGITUDE, ORIGIN_ALTITUDE = 47.3977428, 8.5455967, 489.0  # deg, deg, m above the sea
METRES_PER_DEGREE = 111_194.93  # of latitude, on PX4's sphere of 6,371 km
PRESSURE_AT_SEA, SCALE_HEIGHT = 1013.25, 8434.0  # hPa, m
# SYS_STATUS bits of the sensors that are there and well, by PX4's recording: gyro, accelerometer, magnetometer, ...
SENSORS = 1 | 2 | 4 | 8 | 32 | (1 << 16) | (1 << 20) | (1 << 21) | (1 << 24) | (1 << 25)
PREARM_CHECK = 1 << 28


@dataclass(frozen=True, slots=True)
class Motion:
    """The estimate in the autopilot's axes. position, velocity: NED. attitude: FRD to NED, w first. rate: FRD."""

    position: list[float]
    velocity: list[float]
    attitude: list[float]
    rate: list[float]
    euler: tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class Setpoint:
    """What the inner loops follow, for ATTITUDE_TARGET. attitude: FRD to NED. rate: FRD, rad/s."""

    attitude: list[float]
    rate: list[float]
    thrust: float


@dataclass(frozen=True, slots=True)
class Snapshot:
    """The state of the vehicle for one pass of the loop.

    now, estimate_time: s of vehicle time, of the pass and of the estimate's validity. epoch: s, unix time at boot.
    rotor_speed (rad/s), motor_signal (0..1): in PX4's motor order.
    """

    now: float
    estimate_time: float
    epoch: float
    motion: Motion
    reset_counter: int
    child_frame: int
    specific_force: list[float]
    gyro: list[float]
    imu_time: float
    rotor_speed: list[float]
    motor_signal: list[float]
    voltage: float
    current: float
    remaining: float
    setpoint: Setpoint | None
    target_position: list[float] | None
    home: list[float]
    base_mode: int
    custom_mode: int
    system_status: int
    vehicle_type: int
    landed_state: int
    armable: bool
    estimate_valid: bool

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


class MotionEncoder:
    """Turns estimates into the autopilot's axes, the quaternion's sign following on from the last one's."""

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


def ned(vector_enu: Vector) -> list[float]:
    """A world vector (3,) as the wire carries it."""
    numbers: list[float] = enu_from_ned(vector_enu).tolist()
    return numbers


def frd(vector_flu: Vector) -> list[float]:
    """A body vector (3,) as the wire carries it."""
    numbers: list[float] = flu_from_frd(vector_flu).tolist()
    return numbers


def _euler(w: float, x: float, y: float, z: float) -> tuple[float, float, float]:
    # plain floats, because this runs in every pass and dynamics.quaternion.to_euler is made for whole logs
    roll = math.atan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))
    sine = 2 * (w * y - z * x)
    pitch = math.asin(max(-1.0, min(1.0, sine))) if sine == sine else math.nan
    return roll, pitch, math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))


def motor_order(rotor_position: Vector) -> list[int]:
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
