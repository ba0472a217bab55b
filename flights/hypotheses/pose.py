"""Readings of a pose joint an IMU: order and sense of the attitude, axes of world, body and sensors.

For every way to read the four numbers of an attitude, Wahba's problem gives the turns between the pose's axes and the
sensors', whatever their angle, and the share of the motion that then closes. The way that closes most, with the fewest
turns, is the reading.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from dynamics import frames, quaternion
from dynamics.arrays import Floats
from dynamics.vehicle import GRAVITY
from flights.agreement import both, rms
from flights.hypotheses.hypothesis import is_better
from flights.hypotheses.motion import MIN_ROWS, Motion, change
from flights.hypotheses.rotation import (
    ALIKE,
    FRD,
    NED,
    Fit,
    fitted,
    fitted_with_up,
    is_none,
    is_whole,
    shortest_turn,
    snapped,
)

_NEAREST = np.deg2rad(60.0)  # beyond any turn's distance from the nearest whole axes about one axis
_HEADING = np.deg2rad(15.0)  # by which an estimator's north may be off motion capture's axes: 9 degrees in NanoBench
MIN_TURNING = 0.1  # rad/s rms, below which attitude and rates cannot be compared
MIN_ACCELERATION = 0.3  # m/s^2 rms about its mean, below which acceleration and specific force cannot be compared
MIN_LATERAL = 0.25  # m/s^2 rms along body x and y, below which a turn of the accelerometer about z does not show
_CLEAR_LATERAL = 0.6  # correlation of lateral force and what the pose needs, at the best turn,
_CLEARER = 0.25  # and by which it must exceed that without a turn
COST = 0.02  # of the share that closes, for an assumption that a reading adds to what was declared
_AXES, _ANY, _MIRRORED = 1.5, 2.0, 2.5  # assumptions that a turn of whole axes, any other, a left-handed one are
CLOSES = 0.5  # share of motion beyond which a pair closes
UPRIGHT = np.deg2rad(20.0)  # between a direction and an axis that count as one


@dataclass(frozen=True, eq=False)
class Reading:
    """A way to read pose and IMU.

    order, conjugate: of the attitude, as `StreamRepair`.
    rate: turn and gain from the attitude's body axes to the gyro's; None where the motion does not tell.
    world: turn and gain from the attitude's world to the position's, of acceleration; None where it does not tell.
    force_turn: (3, 3) from the attitude's body axes to the accelerometer's.
    """

    order: str
    conjugate: bool
    rate: Fit | None
    world: Fit | None
    force_turn: Floats = field(default_factory=lambda: np.eye(3))
    up_attitude: Floats = field(default_factory=lambda: np.array([0.0, 0.0, 1.0]))
    up_sensor: Floats = field(default_factory=lambda: np.array([0.0, 0.0, 1.0]))

    @property
    def closures(self) -> tuple[float, ...]:
        """Share of each pair's motion that closes."""
        return tuple(fit.closed for fit in (self.rate, self.world) if fit is not None)

    @property
    def assumptions(self) -> float:
        """The number of things that are other than declared; turns count as more than a usual convention."""
        turns = [fit.turn for fit in (self.rate, self.world) if fit is not None]
        sensor = np.eye(3) if self.rate is None else self.rate.turn
        is_down = self.up_attitude[2] < -np.cos(UPRIGHT) and np.array_equal(self.force_turn, FRD)  # NED and FRD
        is_down = is_down and not any(map(_odd, turns))
        if not is_none(self.force_turn @ sensor.T) and not is_down:
            turns.append(self.force_turn)
        conventions = (self.order == "xyzw") + self.conjugate + (not upright(self.up_attitude))
        return conventions + sum(map(_odd, turns))

    @property
    def score(self) -> float:
        """Mean share that closes, less the cost of its assumptions."""
        return float(np.mean(self.closures)) - COST * self.assumptions if self.closures else 0.0

    def attitude(self, logged: Floats) -> Floats:
        """An attitude (n, 4) as it is read."""
        read = frames.quaternion_from_xyzw(logged) if self.order == "xyzw" else logged
        return quaternion.conjugate(read) if self.conjugate else read


def _odd(turn: Floats) -> float:
    if is_none(turn):
        return 0.0
    if np.linalg.det(turn) < 0:
        return _MIRRORED
    return _AXES if is_whole(turn) else _ANY


def upright(direction: Floats) -> bool:
    """Whether a unit vector (3,) points along z."""
    return bool(direction[2] > np.cos(UPRIGHT))


def declared(motion: Motion) -> Reading | None:
    """The reading that the log declares, with the turns that the motion shows."""
    if not motion.has("attitude"):
        return None
    return max(_read(motion, "wxyz", conjugate=False), key=lambda one: one.score)


def untouched(motion: Motion, reading: Reading) -> Reading:
    """The reading with the accelerometer along the axes of the attitude's body, as logged."""
    attitude = reading.attitude(motion.values["attitude"])
    return _with_world(motion, attitude, replace(reading, world=None, force_turn=np.eye(3)))


def others(motion: Motion) -> list[Reading]:
    """Readings by another order or sense of the attitude, the best first."""
    ways = [("wxyz", True), ("xyzw", False), ("xyzw", True)]
    read = [reading for order, conjugate in ways for reading in _read(motion, order, conjugate=conjugate)]
    return sorted((one for one in read if one.closures), key=lambda one: -one.score)


def _read(motion: Motion, order: str, *, conjugate: bool) -> list[Reading]:
    attitude = Reading(order, conjugate, None, None).attitude(motion.values["attitude"])
    ways: list[tuple[Fit | None, Floats]] = []
    for rate in _rates(motion, attitude):
        # without an accelerometer the thrust's direction stands for it
        ways += [(rate, np.eye(3)), (rate, FRD)]
        if rate is not None and rate.is_turned and np.linalg.det(rate.turn) > 0:
            ways.append((rate, rate.turn))
    return [_with_world(motion, attitude, Reading(order, conjugate, rate, None, force)) for rate, force in ways]


def _rates(motion: Motion, attitude: Floats) -> list[Fit | None]:
    """Turns from the attitude's body axes to the gyro's: by motion alone, and as one with the accelerometer."""
    pair = both(motion.turning(attitude), motion.rate) if motion.has("rate") else None
    if pair is None or len(pair[0]) < MIN_ROWS or rms(pair[0]) < MIN_TURNING:
        return [None]
    alone = _closing(fitted(*pair, mirrored=True))
    if not motion.has("specific_force"):
        return [alone]
    joint = fitted_with_up(*pair, np.array([0.0, 0.0, 1.0]), _usual_force(motion))
    as_well = joint.closed > CLOSES and joint.closed > alone.closed - ALIKE and joint.is_turned
    return [alone, joint] if as_well and not np.allclose(joint.turn, alone.turn) else [alone]


def _usual_force(motion: Motion) -> Floats:
    force = motion.values["specific_force"]
    return _direction(force[np.isfinite(force).all(axis=1)])


def _closing(fit: Fit) -> Fit:
    """A fit, without the turn of one that does not close or that closes little better, which is that of noise."""
    clear = fit.closed > CLOSES and is_better(fit.closed, fit.plain)
    return fit if clear else Fit(np.eye(3), fit.gain, fit.plain, fit.plain)


def _with_world(motion: Motion, attitude: Floats, reading: Reading) -> Reading:
    force = motion.thrust_direction(attitude, reading.force_turn.T)
    finite = force[np.isfinite(force).all(axis=1)]
    up = _direction(finite)
    sensor = np.array([0.0, 0.0, 1.0])
    if motion.has("specific_force"):
        sensor = _usual_force(motion)
    world, acceleration = None, motion.acceleration
    pair = None if acceleration is None else both(force, acceleration)
    if pair is not None and len(pair[0]) >= MIN_ROWS:
        x, y = (values - values.mean(axis=0) for values in pair)
        if rms(y) > MIN_ACCELERATION:  # the same for all readings, as the force in the world is not
            is_measured = motion.has("specific_force")  # the thrust's direction lacks the drag, which turns a circle's
            world = _closing(fitted(x, y, mirrored=is_measured, snap=_HEADING if is_measured else _NEAREST))
            if not _along_an_axis(world.turn @ up):  # nobody's convention has a tilted up
                world = Fit(np.eye(3), world.gain, world.plain, world.plain)
    return Reading(reading.order, reading.conjugate, reading.rate, world, reading.force_turn, up, sensor)


def _along_an_axis(direction: Floats) -> bool:
    return bool(np.max(np.abs(direction)) > np.cos(UPRIGHT))


def _direction(vectors: Floats) -> Floats:
    """(3,) unit vector of the median of vectors (n, 3); z where there are none."""
    median = np.median(vectors, axis=0) if len(vectors) else np.zeros(3)
    size = float(np.linalg.norm(median))
    return np.asarray(median / size) if size > 0.0 else np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True, eq=False)
class Lateral:
    """Turn of the accelerometer about z by lateral force.

    turn: (3, 3) from the attitude's body to the accelerometer.
    agreed, declared: correlation of lateral force with what the motion needs, by this turn and as declared.
    """

    turn: Floats
    agreed: float
    declared: float


def lateral_turn(motion: Motion, reading: Reading) -> Lateral | None:
    """Turn from the attitude's body to the accelerometer, by lateral force; None where none is clear.

    Along body x and y a multirotor's accelerometer reads little but the drag, so that only brisk flights tell.
    """
    acceleration = motion.acceleration
    if acceleration is None or not motion.has("specific_force"):
        return None
    if reading.world is None or reading.world.closed < CLOSES:
        return None
    attitude = reading.attitude(motion.values["attitude"])
    middle = attitude[(len(attitude) - len(acceleration)) // 2 :][: len(acceleration)]
    up = reading.world.turn @ reading.up_attitude
    needed = acceleration / reading.world.gain + GRAVITY * up
    body = quaternion.rotate_inverse(middle, needed @ reading.world.turn)
    force = motion.force @ reading.force_turn
    finite = np.isfinite(body).all(axis=1) & np.isfinite(force).all(axis=1)
    if np.count_nonzero(finite) < MIN_ROWS:
        return None
    x, y = (_without_lever(motion, values, finite)[:, :2] for values in (body, force))
    size = np.sqrt(np.sum(x**2) * np.sum(y**2))
    if min(rms(x), rms(y)) < MIN_LATERAL or size == 0.0:
        return None
    product = y.T @ x / size
    proper = np.array([product[0, 0] + product[1, 1], product[1, 0] - product[0, 1]])  # cosine and sine of the turn
    mirrored = np.array([product[0, 0] - product[1, 1], product[1, 0] + product[0, 1]])
    best = max(float(np.linalg.norm(proper)), float(np.linalg.norm(mirrored)))
    if best < _CLEAR_LATERAL or best - proper[0] < _CLEARER:
        return None
    is_mirrored = float(np.linalg.norm(mirrored)) > float(np.linalg.norm(proper)) + _CLEARER
    cosine, sine = (mirrored if is_mirrored else proper) / np.linalg.norm(mirrored if is_mirrored else proper)
    hand = -1.0 if is_mirrored else 1.0
    turn = snapped(np.array([[cosine, -hand * sine, 0.0], [sine, hand * cosine, 0.0], [0.0, 0.0, 1.0]]))
    return Lateral(turn, best, float(proper[0]))


def _without_lever(motion: Motion, values: Floats, finite: NDArray[np.bool_]) -> Floats:
    """The finite rows (m, 3) of values (n, 3) less what angular acceleration explains, as on a lever arm."""
    if not motion.has("rate"):
        return values[finite] - np.median(values[finite], axis=0)
    rate, turned = motion.rate, change(motion.values["rate"])
    cut = (len(turned) - len(rate)) // 2
    columns = np.hstack([np.ones((len(rate), 1)), turned[cut : cut + len(rate)]])
    rows = np.nan_to_num(columns[finite])
    return np.asarray(values[finite] - rows @ np.linalg.lstsq(rows, values[finite], rcond=None)[0])


@dataclass(frozen=True, eq=False)
class Turns:
    """Turns that bring pose and sensors of a reading into ENU and FLU, (3, 3) each: new = turn @ old.

    world, body: of the attitude. place: of position and velocity. gyro, accelerometer: of the sensors.
    """

    world: Floats
    body: Floats
    place: Floats
    gyro: Floats
    accelerometer: Floats


def turns_of(reading: Reading, accelerometer: Floats | None) -> Turns:
    """The turns that mend a reading. accelerometer: its turn about z where lateral force showed one."""
    to_gyro = np.eye(3) if reading.rate is None else reading.rate.turn
    alone = np.eye(3) if accelerometer is None else accelerometer.T  # may be left-handed, as no attitude can be
    to_sensor = reading.force_turn
    if upright(to_sensor.T @ reading.up_sensor):  # the sensors are turned against the body
        body, gyro, force = np.eye(3), to_gyro.T, alone @ to_sensor.T
    else:
        body = (np.eye(3) if upright(reading.up_sensor) else _upright_body(reading.up_sensor)) @ to_sensor
        gyro, force = body @ to_gyro.T, body @ alone @ to_sensor.T
    mirrored_world = np.eye(3) if reading.world is None else reading.world.turn
    up_place = mirrored_world @ reading.up_attitude
    place = np.eye(3) if upright(up_place) else _upright_world(up_place)
    world = place @ mirrored_world
    if np.linalg.det(world) < 0 or (upright(reading.up_attitude) and not upright(up_place)):
        world = np.eye(3) if upright(reading.up_attitude) else _upright_world(reading.up_attitude)
        place = world @ mirrored_world.T
    return Turns(world, body, place, gyro, force)


def _upright_body(up: Floats) -> Floats:
    return FRD if up[2] < -np.cos(UPRIGHT) else snapped(shortest_turn(up, np.array([0.0, 0.0, 1.0])))


def _upright_world(up: Floats) -> Floats:
    return NED if up[2] < -np.cos(UPRIGHT) else snapped(shortest_turn(up, np.array([0.0, 0.0, 1.0])))
