"""An uninterrupted stretch of flight as diagnosis needs it: measured motion, smoothed motion, rotors."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np

from diagnosis.filters import CUTOFF, Floats, difference, low_pass
from dynamics import quaternion
from dynamics.errors import DataError
from dynamics.vehicle import Vehicle
from flights import Flight

RotorSource = Literal["measured", "command"]
SLOWEST, FASTEST = 40.0, 500.0  # Hz
SHORTEST = 3.0  # s
FULL_CELL = 4.2  # V
TURNING_SHARE = 0.25  # of hover speed below which the rotors do not fly
MARGIN = 0.5  # s left out around ground and contact
CONTACT = 60.0  # m/s^2 of specific force that only a crash or a landing has


@dataclass(frozen=True, eq=False)
class Stretch:
    """n rows at `rate` Hz. position, velocity: (n, 3) world. attitude: (n, 4). gyro: (n, 3) rad/s, None if not logged.

    specific_force: (n, 3) m/s^2, None if not logged. rotor_speed: (n, rotors) rad/s. battery_ratio: (n,) voltage over
    the full battery's, None if not logged. flight: the log that it is of. start: s in the log's time.
    """

    flight: str
    start: float
    rate: float
    position: Floats
    velocity: Floats
    attitude: Floats
    gyro: Floats | None
    specific_force: Floats | None
    rotor_speed: Floats
    rotor_source: RotorSource
    battery_ratio: Floats | None

    def __len__(self) -> int:
        return len(self.position)

    @property
    def duration(self) -> float:
        """Seconds."""
        return len(self) / self.rate

    @cached_property
    def to_world(self) -> Floats:
        """(n, 3, 3) rotation from body to world."""
        return np.asarray(quaternion.rotation_matrix(self.attitude))

    @cached_property
    def turning(self) -> Floats:
        """(n, 3) body rate by which the attitude turns, rad/s: half the turn between the neighbours, times the rate."""
        turned = quaternion.multiply(quaternion.conjugate(self.attitude[:-2]), self.attitude[2:])
        turned = np.where(turned[:, :1] < 0, -turned, turned)
        inner = quaternion.logarithm(turned) * (self.rate / 2)
        return np.concatenate([inner[:1], inner, inner[-1:]])

    @cached_property
    def body_rate(self) -> Floats:
        """(n, 3) rad/s: the gyro's, or the attitude's turning where there is no gyro."""
        return self.turning if self.gyro is None else self.gyro

    @cached_property
    def smooth(self) -> Floats:
        """(n, 13) state, position, velocity and rate below the cutoff, to keep their noise out of products."""
        parts = [low_pass(x, self.rate) for x in (self.position, self.velocity, self.body_rate)]
        return np.hstack([parts[0], parts[1], self.attitude, parts[2]])

    @cached_property
    def rotor_acceleration(self) -> Floats:
        """(n, rotors) rad/s^2."""
        return difference(self.rotor_speed, self.rate)

    @cached_property
    def environment(self) -> Floats:
        """(n, 2) ground height m, battery ratio; the ground is where z is 0."""
        ratio = np.ones(len(self)) if self.battery_ratio is None else self.battery_ratio
        return np.column_stack([np.zeros(len(self)), ratio])

    def between(self, start: int, stop: int) -> Stretch:
        """The rows from start to before stop."""

        def cut(values: Floats | None) -> Floats | None:
            return None if values is None else values[start:stop]

        return Stretch(
            self.flight, self.start + start / self.rate, self.rate, self.position[start:stop],
            self.velocity[start:stop], self.attitude[start:stop], cut(self.gyro), cut(self.specific_force),
            self.rotor_speed[start:stop], self.rotor_source, cut(self.battery_ratio),
        )  # fmt: skip


def stretches(flight: Flight, vehicle: Vehicle) -> tuple[Stretch, ...]:
    """The parts of a flight in the air without gaps, each at least 3 s long.

    Raises DataError when the flight lacks motion, attitude or rotors, or is too slow to tell.
    """
    name = flight.provenance.path
    if not flight.has("attitude") or not (flight.has("velocity") or flight.has("position")):
        raise DataError(
            f"{name} has {', '.join(flight.quantities)}. Wanted attitude and position or velocity; log them."
        )
    if flight.rate < SLOWEST:
        raise DataError(
            f"{name} has {flight.rate:.0f} rows a second. Wanted {SLOWEST:.0f} Hz or more of gyro and pose."
        )
    speed, _ = rotor_speeds(flight, vehicle)
    parts = flight.segments(exclude=_on_ground(flight, speed, vehicle), shortest=SHORTEST)
    return tuple(_stretch(part, vehicle) for part in parts)


def rotor_speeds(flight: Flight, vehicle: Vehicle) -> tuple[Floats, RotorSource]:
    """(n, rotors) rad/s, measured if there are such, else commanded.

    Raises DataError when there are neither, or none is logged fast enough.
    """
    name, rotors, slow = flight.provenance.path, vehicle.rotors, ""
    for quantity in ("rotor_speed", "rotor_speed_command", "rotor_command"):
        if not flight.has(quantity):
            continue
        origin = flight.origins.get(quantity)
        if origin is not None and origin.rate < SLOWEST:
            slow = slow or f"{quantity} at {origin.rate:.0f} Hz"
            continue
        values = flight[quantity]
        if values.shape[1] != rotors.count:
            raise DataError(f"{name} has {values.shape[1]} rotors, the vehicle file {rotors.count}. Give its own file.")
        if quantity == "rotor_command":
            curve = rotors.thrust_curve
            values = rotors.speed_max * np.sqrt(np.maximum(curve * values**2 + (1 - curve) * values, 0.0))
        return values, "measured" if quantity == "rotor_speed" else "command"
    if flight.has("collective_thrust_command", "torque_command"):
        return _allocated(flight, vehicle), "command"
    if slow:
        raise DataError(
            f"{name} has {slow}. Wanted {SLOWEST:.0f} Hz or more: with PX4, set SDLOG_PROFILE to 17 (default and high "
            "rate) and fly again."
        )
    raise DataError(f"{name} has {', '.join(flight.quantities)}. Wanted rotor speeds or motor commands; log them.")


def _allocated(flight: Flight, vehicle: Vehicle) -> Floats:
    """(n, rotors) rad/s that give the commanded thrust and torque, where the log knows no rotors."""
    thrust = flight["collective_thrust_command"].reshape(-1, 1)
    wanted = np.hstack([thrust, flight["torque_command"]])
    squares = wanted @ np.linalg.pinv(vehicle.rotors.allocation).T
    return np.asarray(np.sqrt(np.maximum(squares, 0.0)))


def _on_ground(flight: Flight, speed: Floats, vehicle: Vehicle) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
    ground = ~np.isfinite(speed).all(axis=1)
    ground |= np.nanmean(np.where(np.isfinite(speed), speed, 0.0), axis=1) < TURNING_SHARE * vehicle.hover_speed
    if flight.has("landed"):
        ground |= flight["landed"] != 0
    if flight.has("specific_force"):
        ground |= np.linalg.norm(np.nan_to_num(flight["specific_force"]), axis=1) > CONTACT
    width = 2 * round(MARGIN * flight.rate) + 1
    return np.asarray(np.convolve(ground, np.ones(width), mode="same") > 0)


def _stretch(part: Flight, vehicle: Vehicle) -> Stretch:
    rate = part.rate
    speed, source = rotor_speeds(part, vehicle)
    position = part["position"] if part.has("position") else np.zeros((len(part), 3))
    velocity = part["velocity"] if part.has("velocity") else difference(position, rate)
    attitude = quaternion.normalise(part["attitude"])
    return Stretch(
        flight=part.provenance.path,
        start=float(part.time[0]),
        rate=rate,
        position=position,
        velocity=velocity,
        attitude=np.asarray(attitude),
        gyro=part["rate"] if part.has("rate") else None,
        specific_force=part["specific_force"] if part.has("specific_force") else None,
        rotor_speed=speed,
        rotor_source=source,
        battery_ratio=_battery_ratio(part),
    )


def _battery_ratio(part: Flight) -> Floats | None:
    """Voltage over that of as many full cells as the highest voltage needs, smoothed over a second."""
    if not part.has("battery_voltage"):
        return None
    volts = part["battery_voltage"].reshape(-1)
    known = np.isfinite(volts)
    if not known.all() or volts.max() < 2.5:
        return None
    cells = math.ceil(float(np.quantile(volts, 0.99)) / (FULL_CELL + 0.2))
    return np.asarray(low_pass(volts, part.rate, min(1.0, CUTOFF), 2)) / (cells * FULL_CELL)
