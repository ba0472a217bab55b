"""An uninterrupted segment of flight as diagnosis needs it: measured motion, smoothed motion, rotors."""

from __future__ import annotations

import hashlib
import math
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from diagnosis.data.decimating_filter import filtered_rows
from diagnosis.data.filters import (
    advanced,
    decimated_rows,
    decimation,
    mean_of_held,
    rate_of_change,
    simpson_inverse,
)
from diagnosis.data.pose import pose_source
from diagnosis.data.workspace import Workspace
from diagnosis.thresholds import DEFAULT, FilterThresholds, SegmentThresholds, Thresholds
from dynamics import quaternion
from dynamics.arrays import Floats
from dynamics.errors import DataError
from dynamics.vehicle import Vehicle
from flights import Flight
from flights.exclusion import excluded_rows, find_exclusions
from flights.filters import zero_phase
from flights.pose_source import PoseSource
from flights.quality.frozen import frozen_rows
from flights.quality.inspection import MIN_ROTOR_RATE
from flights.quality.rotor_balance import dropout_rows
from flights.rotors import RotorSource, rotor_speeds


@dataclass(frozen=True, eq=False)
class Segment:
    """An uninterrupted part of a flight, n rows.

    flight: the log that it is of.
    start: s in the log's time.
    rate: of the rows, Hz.
    position, velocity: (n, 3) world, m and m/s.
    attitude: (n, 4) quaternion w, x, y, z, body to world.
    gyro: (n, 3) rad/s, None if not logged.
    specific_force: (n, 3) m/s^2, None if not logged.
    rotor_speed: (n, rotors) rad/s.
    rotor_source: what the rotor speeds were taken from.
    rotor_share: of the later row in the mean of measured rotor speeds between two rows, where these hold a value or
        settle within the period; None where they change smoothly through the rows.
    battery_ratio: (n,) voltage over the full battery's, None if not logged.
    pose_source: whether the pose is motion capture's or an estimator's, which used the accelerometer.
    lacks: which of position, velocity and attitude were not logged; their values are zero and upright.
    filters: of the residuals, on both sides of the equation.
    carried_mass: mass over the vehicle file's body, with which rotor speeds were taken from commands.
    without_noise: the segment itself where noise was added to it; hidden states begin as there.
    workspace: what was computed of it.
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
    pose_source: PoseSource = "unknown"
    filters: FilterThresholds = DEFAULT.filters
    carried_mass: float = 1.0
    without_noise: Segment | None = None
    rotor_share: float | None = None
    workspace: Workspace = field(default_factory=Workspace, init=False, repr=False)

    def __len__(self) -> int:
        return len(self.position)

    @property
    def duration(self) -> float:
        """Seconds."""
        return len(self) / self.rate

    @property
    def has_pose(self) -> bool:
        """Whether velocity and attitude were logged, and with them the acceleration of the pose in body axes."""
        return not self.lacks & {"velocity", "attitude"}

    @property
    def has_attitude(self) -> bool:
        """Whether the attitude was logged."""
        return "attitude" not in self.lacks

    @property
    def decimated_rate(self) -> float:
        """Of the residuals' rows, Hz."""
        return self.rate / decimation(self.rate, self.filters)

    @property
    def decimated(self) -> slice:
        """The residuals' rows among the segment's."""
        return decimated_rows(len(self), self.rate, self.filters)

    @property
    def decimated_times(self) -> Floats:
        """(m,) s in the log's time, of the residuals' rows."""
        count = len(range(*self.decimated.indices(len(self))))
        return np.asarray(self.start + self.filters.edge + np.arange(count) / self.decimated_rate)

    def low_pass(self, values: Floats) -> Floats:
        """The residuals' low-pass over values (n, ...)."""
        return zero_phase(values, self.rate, self.filters.cutoff)

    def filtered(self, values: Floats, *, products: bool = False) -> Floats:
        """(m, ...) the same at the residuals' rows. products: with Simpson's weights first."""
        return filtered_rows(values, self.rate, self.filters, products=products)

    @cached_property
    def digest(self) -> bytes:
        """Of its rows and of how they are read: equal for equal segments."""
        scalars = (self.flight, self.start, self.rate, self.rotor_source, sorted(self.lacks), self.pose_source)
        digest = hashlib.blake2b(repr((*scalars, self.filters, self.carried_mass, self.rotor_share)).encode())
        logged = (self.position, self.velocity, self.attitude, self.gyro, self.specific_force)
        for values in (*logged, self.rotor_speed, self.battery_ratio):
            digest.update(b"none" if values is None else np.ascontiguousarray(values).tobytes())
        return digest.digest()

    @cached_property
    def to_world(self) -> Floats:
        """(n, 3, 3) rotation from body to world."""
        return np.asarray(quaternion.rotation_matrix(self.attitude))

    @cached_property
    def axes_in_world(self) -> Floats:
        """(3, 3, n) the body's axes in the world, one after another."""
        return np.ascontiguousarray(self.to_world.transpose(2, 1, 0))

    @cached_property
    def rate_from_attitude(self) -> Floats:
        """(n, 3) body rate from the attitude, rad/s: half the rotation between neighbouring rows, times the rate."""
        turned = quaternion.multiply(quaternion.conjugate(self.attitude[:-2]), self.attitude[2:])
        turned = np.where(turned[:, :1] < 0, -turned, turned)
        inner = quaternion.logarithm(turned) * (self.rate / 2)
        return np.concatenate([inner[:1], inner, inner[-1:]])

    @cached_property
    def body_rate(self) -> Floats:
        """(n, 3) rad/s: the gyro's, or the attitude's where there is no gyro."""
        return simpson_inverse(self.rate_from_attitude) if self.gyro is None else self.gyro

    @cached_property
    def smooth(self) -> Floats:
        """(n, 13) state; position, velocity and rate below the cutoff, to keep their noise out of products."""
        position, velocity, rate = map(self.low_pass, (self.position, self.velocity, self.body_rate))
        return np.vstack([position.T, velocity.T, self.attitude.T, rate.T]).T

    @cached_property
    def driving(self) -> Floats:
        """(n, 13 + rotors + 2) what drives hidden states: smooth state, rotor speeds and environment."""
        return np.vstack([self.smooth.T, self.rotor_speed.T, self.environment.T]).T

    @cached_property
    def mean_rotor_speed(self) -> Floats:
        """(n, rotors) speeds by which velocities and rates change: their Simpson average is the mean speed, rad/s."""
        return self.rotor_speed if self.rotor_share is None else mean_of_held(self.rotor_speed, self.rotor_share)

    @cached_property
    def rotor_acceleration(self) -> Floats:
        """(n, rotors) rad/s^2."""
        return rate_of_change(self.rotor_speed, self.rate)

    @cached_property
    def angular_acceleration(self) -> Floats:
        """(n, 3) of the body rate, rad/s^2."""
        return rate_of_change(self.body_rate, self.rate)

    @cached_property
    def environment(self) -> Floats:
        """(n, 2) ground height m, battery ratio; the ground is where z is 0."""
        ratio = np.ones(len(self)) if self.battery_ratio is None else self.battery_ratio
        return np.column_stack([np.zeros(len(self)), ratio])

    def with_rotors_later(self, age: float) -> Segment:
        """The segment with the rotors' speeds that were logged `age` s later; its motion is not computed again."""
        moved = replace(self, rotor_speed=advanced(self.rotor_speed, self.rate, age))
        moved.__dict__.update({name: getattr(self, name) for name in _OF_MOTION})  # where cached properties are kept
        return moved

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


_OF_MOTION = ("to_world", "axes_in_world", "body_rate", "smooth", "angular_acceleration", "environment")


def segments(flight: Flight, vehicle: Vehicle, thresholds: Thresholds = DEFAULT) -> tuple[Segment, ...]:
    """The parts of a flight in the air without gaps.

    Raises DataError when the flight lacks motion or rotors, or was logged too slowly.
    """
    if len(flight) < 2:
        return ()
    if flight.rate < thresholds.segment.min_rate_share * MIN_ROTOR_RATE:
        raise DataError(
            f"{flight.provenance.path} has {flight.rate:.0f} rows a second. Wanted {MIN_ROTOR_RATE:.0f} Hz or more "
            "of gyro and pose."
        )
    limits = thresholds.segment
    posed = fast(flight, "attitude", limits) and (fast(flight, "velocity", limits) or fast(flight, "position", limits))
    if not posed and not (fast(flight, "rate", limits) and fast(flight, "specific_force", limits)):
        raise DataError(lacking(flight, limits))
    speed, _ = rotor_speeds(flight, vehicle)
    parts = flight.segments(exclude=_unusable(flight, speed, limits), shortest=limits.min_duration)
    source = pose_source(flight, thresholds)
    return tuple(replace(_segment(part, vehicle, thresholds), pose_source=source) for part in parts)


def fast(flight: Flight, quantity: str, thresholds: SegmentThresholds = DEFAULT.segment) -> bool:
    """Whether a quantity was logged, and often enough for what it is used for."""
    origin = flight.origins.get(quantity)
    return flight.has(quantity) and (origin is None or origin.rate >= thresholds.min_rate_share * MIN_ROTOR_RATE)


def slow_quantities(flight: Flight, thresholds: SegmentThresholds = DEFAULT.segment) -> list[str]:
    """Quantities of motion that were logged too slowly to be used."""
    return [
        f"{name} at {flight.origins[name].rate:.0f} Hz"
        for name in ("attitude", "velocity", "rate", "specific_force")
        if flight.has(name) and not fast(flight, name, thresholds)
    ]


def lacking(flight: Flight, thresholds: SegmentThresholds = DEFAULT.segment) -> str:
    """The message for a flight without the motion that diagnosis needs: what it lacks and what to do."""
    names = {"attitude": "attitude", "velocity": "velocity", "rate": "gyro", "specific_force": "accelerometer"}
    missing = [text for name, text in names.items() if not flight.has(name)] + slow_quantities(flight, thresholds)
    return (
        f"{flight.provenance.path} has {', '.join(flight.quantities)}; it lacks {', '.join(missing)}. Wanted attitude "
        f"with velocity or position, or else gyro and accelerometer, at {MIN_ROTOR_RATE:.0f} Hz or more: log them and "
        "fly again. With other flights of this vehicle that were normal, `alula diagnose LOG --vehicle V --normal "
        "NORMAL` compares how the rotors share the load in hover, which needs the motor commands alone."
    )


def _unusable(flight: Flight, speed: Floats, thresholds: SegmentThresholds) -> NDArray[np.bool_]:
    """(n,) rows on the ground, in contact, excluded or without rotor speeds, with the margin around them."""
    unusable = ~np.isfinite(speed).all(axis=1)
    if flight.has("landed"):
        unusable |= flight["landed"] != 0
    if flight.has("specific_force"):
        force = np.linalg.norm(np.nan_to_num(flight["specific_force"]), axis=1)
        unusable |= force > thresholds.max_specific_force
    for rows in frozen_rows(flight).values():
        unusable |= rows
    if flight.has("rotor_speed"):
        unusable |= dropout_rows(flight)
    unusable |= excluded_rows(flight, find_exclusions(flight))
    margin = round(thresholds.margin * flight.rate)
    near = np.convolve(unusable, np.ones(2 * margin + 1))[margin : margin + len(unusable)]
    return np.asarray(near > 0)


def _segment(part: Flight, vehicle: Vehicle, thresholds: Thresholds) -> Segment:
    usable = {name for name in part.quantities if fast(part, name, thresholds.segment)}
    position = part["position"] if part.has("position") else np.zeros((len(part), 3))
    velocity = np.zeros((len(part), 3))
    if "velocity" in usable:
        velocity = part["velocity"]
    elif "position" in usable:
        velocity = rate_of_change(position, part.rate)
    upright = np.tile([1.0, 0.0, 0.0, 0.0], (len(part), 1))
    attitude = quaternion.normalise(part["attitude"]) if "attitude" in usable else upright
    logged = {
        "position": part.has("position"),
        "velocity": bool(usable & {"velocity", "position"}),
        "attitude": "attitude" in usable,
    }
    speed, source = rotor_speeds(part, vehicle)
    return Segment(
        flight=part.provenance.path,
        start=float(part.time[0]),
        rate=part.rate,
        position=position,
        velocity=velocity,
        attitude=np.asarray(attitude),
        gyro=part["rate"] if "rate" in usable else None,
        specific_force=part["specific_force"] if "specific_force" in usable else None,
        rotor_speed=speed,
        rotor_source=source,
        battery_ratio=_battery_ratio(part, thresholds.segment),
        lacks=frozenset(name for name, there in logged.items() if not there),
        filters=thresholds.filters,
    )


def _battery_ratio(part: Flight, thresholds: SegmentThresholds) -> Floats | None:
    """Voltage over that of as many full cells as the highest voltage needs, smoothed; None if no battery flies so."""
    if not battery_is_measured(part, thresholds):
        return None
    volts = part["battery_voltage"].reshape(-1)
    smooth = np.asarray(zero_phase(volts, part.rate, thresholds.voltage_cutoff, 2))
    return smooth / (_cells(volts, thresholds) * thresholds.full_cell)


def battery_is_measured(part: Flight, thresholds: SegmentThresholds = DEFAULT.segment) -> bool:
    """Whether a part of a flight has a voltage that a battery in flight can have."""
    if not part.has("battery_voltage"):
        return False
    volts = part["battery_voltage"].reshape(-1)
    if not np.isfinite(volts).all() or volts.max() < thresholds.min_voltage:
        return False
    lowest = float(np.quantile(volts, 1.0 - thresholds.full_quantile))
    return lowest >= thresholds.min_cell * _cells(volts, thresholds)


def _cells(volts: Floats, thresholds: SegmentThresholds) -> int:
    highest = float(np.quantile(volts, thresholds.full_quantile))
    return max(1, math.ceil(highest / (thresholds.full_cell + thresholds.cell_slack)))
