"""An uninterrupted segment of flight as diagnosis needs it: measured motion, smoothed motion, rotors."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from diagnosis.data.filters import difference, low_pass
from dynamics import quaternion
from dynamics.arrays import Floats
from dynamics.errors import DataError
from dynamics.vehicle import Vehicle
from flights import Flight
from flights.exclusion import excluded_rows, find_exclusions
from flights.quality.inspection import MIN_ROTOR_RATE
from flights.rotors import RotorSource, rotor_speeds

FASTEST = 500.0  # Hz
MIN_LOGGED = 0.95 * MIN_ROTOR_RATE  # Hz; clocks are not exact
SHORTEST = 3.0  # s
FULL_CELL = 4.2  # V
VOLTAGE_CUTOFF = 4.0  # Hz: voltage falls with every manoeuvre, and its noise would stand in the thrust
MARGIN = 0.5  # s left out around ground and contact
CONTACT = 60.0  # m/s^2 of specific force that only a crash or a landing has


@dataclass(frozen=True, eq=False)
class Segment:
    """n rows at `rate` Hz. position, velocity: (n, 3) world. attitude: (n, 4). gyro: (n, 3) rad/s, None if not logged.

    specific_force: (n, 3) m/s^2, None if not logged. rotor_speed: (n, rotors) rad/s. battery_ratio: (n,) voltage over
    the full battery's, None if not logged. flight: the log that it is of. start: s in the log's time.
    lacks: which of position, velocity and attitude were not logged; they stand at the origin, at rest, upright.
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
    lacks: frozenset[str] = frozenset()

    def __len__(self) -> int:
        return len(self.position)

    @property
    def duration(self) -> float:
        """Seconds."""
        return len(self) / self.rate

    @property
    def has_pose(self) -> bool:
        """Whether it tells the acceleration of the pose in body axes."""
        return not self.lacks & {"velocity", "attitude"}

    @property
    def has_attitude(self) -> bool:
        """Whether it tells how the attitude turns."""
        return "attitude" not in self.lacks

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

    def between(self, start: int, stop: int) -> Segment:
        """The rows from start to before stop."""

        def cut(values: Floats | None) -> Floats | None:
            return None if values is None else values[start:stop]

        return replace(
            self,
            start=self.start + start / self.rate,
            position=self.position[start:stop],
            velocity=self.velocity[start:stop],
            attitude=self.attitude[start:stop],
            gyro=cut(self.gyro),
            specific_force=cut(self.specific_force),
            rotor_speed=self.rotor_speed[start:stop],
            battery_ratio=cut(self.battery_ratio),
        )


def segments(flight: Flight, vehicle: Vehicle) -> tuple[Segment, ...]:
    """The parts of a flight in the air without gaps, each at least 3 s long.

    Raises DataError when the flight lacks motion or rotors, or is too slow to tell.
    """
    if flight.rate < MIN_ROTOR_RATE:
        raise DataError(
            f"{flight.provenance.path} has {flight.rate:.0f} rows a second. Wanted {MIN_ROTOR_RATE:.0f} Hz or more "
            "of gyro and pose."
        )
    posed = fast(flight, "attitude") and (fast(flight, "velocity") or fast(flight, "position"))
    if not posed and not (fast(flight, "rate") and fast(flight, "specific_force")):
        raise DataError(lacking(flight))
    speed, _ = rotor_speeds(flight, vehicle)
    parts = flight.segments(exclude=_on_ground(flight, speed), shortest=SHORTEST)
    return tuple(_segment(part, vehicle) for part in parts)


def fast(flight: Flight, quantity: str) -> bool:
    """Whether a quantity was logged, and often enough for what it is used for."""
    origin = flight.origins.get(quantity)
    return flight.has(quantity) and (origin is None or origin.rate >= MIN_LOGGED)


def slow_ones(flight: Flight) -> list[str]:
    """What was logged of motion, but too slowly to be used."""
    return [
        f"{name} at {flight.origins[name].rate:.0f} Hz"
        for name in ("attitude", "velocity", "rate", "specific_force")
        if flight.has(name) and not fast(flight, name)
    ]


def lacking(flight: Flight) -> str:
    """What a flight lacks that diagnosis cannot do without, and what can be done."""
    wanted = ("attitude", "velocity", "rate", "specific_force")
    names = {"rate": "gyro", "specific_force": "accelerometer"}
    missing = [names.get(name, name) for name in wanted if not flight.has(name)] + slow_ones(flight)
    return (
        f"{flight.provenance.path} has {', '.join(flight.quantities)}; it lacks {', '.join(missing)}. Wanted attitude "
        f"with velocity or position, or else gyro and accelerometer, at {MIN_ROTOR_RATE:.0f} Hz or more: log them and "
        "fly again. With other flights of this vehicle that were normal, `alula diagnose LOG --vehicle V --normal "
        "NORMAL` compares how the rotors share the load in hover, which needs the motor commands alone."
    )


def _on_ground(flight: Flight, speed: Floats) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
    ground = ~np.isfinite(speed).all(axis=1)
    if flight.has("landed"):
        ground |= flight["landed"] != 0
    if flight.has("specific_force"):
        ground |= np.linalg.norm(np.nan_to_num(flight["specific_force"]), axis=1) > CONTACT
    ground |= excluded_rows(flight, find_exclusions(flight))
    width = 2 * round(MARGIN * flight.rate) + 1
    return np.asarray(np.convolve(ground, np.ones(width), mode="same") > 0)


def _segment(part: Flight, vehicle: Vehicle) -> Segment:
    rate = part.rate
    speed, source = rotor_speeds(part, vehicle)
    position = part["position"] if part.has("position") else np.zeros((len(part), 3))
    moves = fast(part, "velocity") or fast(part, "position")
    velocity = np.zeros((len(part), 3))
    if moves:
        velocity = part["velocity"] if fast(part, "velocity") else difference(position, rate)
    upright = np.tile([1.0, 0.0, 0.0, 0.0], (len(part), 1))
    attitude = quaternion.normalise(part["attitude"]) if fast(part, "attitude") else upright
    known = {"position": part.has("position"), "velocity": moves, "attitude": fast(part, "attitude")}
    return Segment(
        flight=part.provenance.path,
        start=float(part.time[0]),
        rate=rate,
        position=position,
        velocity=velocity,
        attitude=np.asarray(attitude),
        gyro=part["rate"] if fast(part, "rate") else None,
        specific_force=part["specific_force"] if fast(part, "specific_force") else None,
        rotor_speed=speed,
        rotor_source=source,
        battery_ratio=_battery_ratio(part),
        lacks=frozenset(name for name, there in known.items() if not there),
    )


def _battery_ratio(part: Flight) -> Floats | None:
    """Voltage over that of as many full cells as the highest voltage needs, smoothed."""
    if not part.has("battery_voltage"):
        return None
    volts = part["battery_voltage"].reshape(-1)
    known = np.isfinite(volts)
    if not known.all() or volts.max() < 2.5:
        return None
    cells = math.ceil(float(np.quantile(volts, 0.99)) / (FULL_CELL + 0.2))
    return np.asarray(low_pass(volts, part.rate, VOLTAGE_CUTOFF, 2)) / (cells * FULL_CELL)
