"""Segments that are not free flight (ground contact, impacts, crashes) or not measured, to be masked before any fit.

They are detected from what the log has: the land detector, effort of the rotors, specific force, motion. A log without
rotors, accelerometer and motion has no exclusions.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
import scipy
from numpy.typing import NDArray

from dynamics import quaternion
from dynamics.arrays import Floats
from dynamics.vehicle import GRAVITY
from flights.filters import runs
from flights.flight import MIN_SEGMENT, Flight

Reason = Literal["ground", "impact", "crash", "clipping"]
Rows = NDArray[np.bool_]

IDLE_EFFORT = 0.35  # of the usual effort, below which rotors do not carry the vehicle,
IDLE_TIME = 0.15  # s, and for how long
SMOOTHED = 0.2  # s over which specific force is averaged
RESTING_FORCE = 0.5  # g of specific force: less is free fall, not the ground
STILL_SPEED, STILL_RATE = 0.15, 0.3  # m/s, rad/s
DRIFTING_SPEED = 1.5  # m/s that an estimate may drift by while the vehicle stands
STEADY_FORCE = 1.5  # m/s^2 by which specific force may differ from gravity's reaction without acceleration
STEADY_TIME = 0.3  # s of that
CARRYING_EFFORT = 0.65  # of the weight; a vehicle that stays at a height with less stands on something
BORNE = 0.1  # of the weight by which the rotors' lift may differ from the force along body z that they alone make
SINKING_SPEED = 0.5  # m/s; in a faster descent the air carries a part
GROUND_HEIGHT = 0.07  # m
LIFT_OFF_SPEED = 0.3  # m/s upwards
MAX_SPOOL_UP = 3.0  # s from idling rotors to lift-off
GROUND_MARGIN = 0.3  # s before and after ground contact: spool-up, touch-down
IMPACT_FORCE = 20.0  # m/s^2 within an instant, and
IMPACT_SPREAD = 12.0  # times the usual scatter, to be an impact
IMPACT_MARGIN = 0.25  # s
BLOW_SPACING = 0.1  # s between jumps that are one blow, and on both sides of it, where the motion is compared
BLOW_SHARE = 0.5  # of a blow's impulse, which the velocity shows where something was hit
AFTERMATH = 1.5  # s after an impact in which a crash shows
LANDING_SPEED = 1.5  # m/s
FALL = 0.3  # m
TILT_FALLEN = np.deg2rad(75.0)
TILT_RESTING = np.deg2rad(30.0)  # no multirotor stands still in the air at such a tilt
RECOVERED = 1.0  # s of upright flight that end a crash
UPWARD = np.array([0.0, 0.0, GRAVITY])  # m/s^2, gravity's reaction in the world


@dataclass(frozen=True)
class Exclusion:
    """A segment that no fit may use.

    start, stop: s of the flight's time.
    detail: the evidence, for people.
    """

    reason: Reason
    start: float
    stop: float
    detail: str

    def __str__(self) -> str:
        return f"{self.reason} {self.start:.2f} to {self.stop:.2f} s: {self.detail}"


def find_exclusions(flight: Flight) -> tuple[Exclusion, ...]:
    """Every segment of a flight that is not free flight, in the order of time."""
    if len(flight) < 3:
        return ()
    indicators = _Indicators.of(flight)
    ground = indicators.ground()
    jumps = indicators.jumps()
    sensor = indicators.unfelt(jumps)
    impacts = (jumps > 0.0) & ~sensor
    crash = _crashes(indicators, ground, impacts)
    touching = _grown(indicators.until_lift_off(ground), indicators.rows(GROUND_MARGIN))
    bumps = _grown(impacts, indicators.rows(IMPACT_MARGIN)) & ~touching & ~crash
    clipping = _grown(sensor, indicators.rows(BLOW_SPACING)) & ~touching & ~crash & ~bumps
    if not indicators.flew(~(touching | crash)):  # what never left the ground has not crashed
        touching, crash = touching | crash, np.zeros_like(crash)
    exclusions = [
        *_named("crash", flight, crash, "hit something or fell over, and did not fly on"),
        *_named("ground", flight, touching & ~crash, "stood on the ground"),
        *_named("impact", flight, bumps, f"specific force jumped by {jumps[impacts].max(initial=0.0):.0f} m/s^2"),
        *_named(
            "clipping",
            flight,
            clipping,
            f"the accelerometer alone jumped by {jumps[sensor].max(initial=0.0):.0f} m/s^2: velocity and body rates "
            "are smooth, so it clips or fails and nothing was hit",
        ),
    ]
    return tuple(sorted(exclusions, key=lambda item: item.start))


def excluded_rows(flight: Flight, exclusions: Sequence[Exclusion]) -> Rows:
    """(n,) whether a row of the flight lies in any of the segments."""
    rows = np.zeros(len(flight), dtype=bool)
    for item in exclusions:
        rows |= (flight.time >= item.start) & (flight.time <= item.stop)
    return rows


def free_flight(flight: Flight, *, shortest: float = MIN_SEGMENT) -> tuple[Flight, ...]:
    """The segments of free flight: no gap, reset, disarmed vehicle, ground contact, impact or crash inside."""
    return flight.segments(exclude=excluded_rows(flight, find_exclusions(flight)), shortest=shortest)


def effort(flight: Flight) -> Floats | None:
    """(n,) collective thrust over its usual value in flight, from rotor speeds or commands; None without any.

    Thrust is taken for a power of each: of a speed the square, of a rotor command between linear and square.
    """
    for name, power in (
        ("rotor_speed", 2.0),
        ("rotor_speed_command", 2.0),
        ("rotor_thrust_command", 1.0),
        ("rotor_command", 1.5),
        ("collective_thrust_command", 1.0),
        ("thrust_setpoint", 1.0),
    ):
        if not flight.has(name):
            continue
        total = np.sum(np.abs(flight[name].reshape(len(flight), -1)) ** power, axis=1)
        finite = total[np.isfinite(total)]
        working = finite[finite > 0.2 * np.percentile(finite, 95)] if len(finite) else finite
        if len(working) and np.median(working) > 0:
            return np.asarray(total / np.median(working))
    return None


def _lift(used: Floats, vertical: Floats, tilt: Floats) -> Floats:
    """(n,) lift over weight, by the effort of the upright rows that have the usual ratio of force and effort.

    used: effort. vertical: specific force along body z, m/s^2. tilt: rad.
    """
    working = (used > IDLE_EFFORT) & (tilt < TILT_RESTING) & np.isfinite(vertical)
    ratio = float(np.median(vertical[working] / used[working])) / GRAVITY if working.any() else 1.0
    return np.asarray(np.nan_to_num(used, nan=1.0) * ratio)


@dataclass(frozen=True, eq=False)
class _Indicators:
    """The signals that decide, (n,) each, None where the log has none.

    unbalanced: difference of the specific force from gravity's reaction, in the world, m/s^2: the acceleration.
    lift: of the rotors over the weight, by their effort.
    upward_force: specific force along body z over gravity, averaged.
    acceleration, velocity: (n, 3) in the world, the acceleration by the specific force, m/s^2. rate: (n, 3), rad/s.
    """

    count: int
    period: float
    effort: Floats | None
    force: Floats | None
    speed: Floats | None
    climb: Floats | None
    turning: Floats | None
    tilt: Floats | None
    landed: Floats | None
    height: Floats | None
    unbalanced: Floats | None
    lift: Floats | None
    upward_force: Floats | None
    acceleration: Floats | None
    velocity: Floats | None
    rate: Floats | None

    @classmethod
    def of(cls, flight: Flight) -> _Indicators:
        def norm(name: str) -> Floats | None:
            return np.linalg.norm(flight[name], axis=1) if flight.has(name) else None

        tilt = None
        if flight.has("attitude"):
            upward = quaternion.rotate(flight["attitude"], np.array([0.0, 0.0, 1.0]))[:, 2]
            tilt = np.arccos(np.clip(upward, -1.0, 1.0))
        landed = flight["landed"] if flight.has("landed") else None
        height = flight["position"][:, 2] if flight.has("position") else None
        force, speed, turning = (norm(name) for name in ("specific_force", "velocity", "rate"))
        used, unbalanced, lift, upward, acceleration = effort(flight), None, None, None, None
        if force is not None and tilt is not None:
            width = max(1, round(SMOOTHED / flight.period))
            measured, attitude = np.nan_to_num(flight["specific_force"]), np.nan_to_num(flight["attitude"])
            body = scipy.ndimage.uniform_filter1d(measured, width, axis=0)
            unbalanced = np.linalg.norm(quaternion.rotate(attitude, body) - UPWARD, axis=1)
            acceleration = quaternion.rotate(attitude, measured) - UPWARD
            upward = body[:, 2] / GRAVITY
            lift = None if used is None else _lift(used, body[:, 2], tilt)
        climb = flight["velocity"][:, 2] if speed is not None else None
        motion = speed, climb, turning, tilt, landed, height
        vectors = (flight[name] if flight.has(name) else None for name in ("velocity", "rate"))
        return cls(len(flight), flight.period, used, force, *motion, unbalanced, lift, upward, acceleration, *vectors)

    def rows(self, seconds: float) -> int:
        return max(1, round(seconds / self.period))

    def idle(self) -> Rows | None:
        """Rows in which the rotors do not carry the vehicle for a while."""
        if self.effort is None:
            return None
        return _lasting(np.nan_to_num(self.effort, nan=1.0) < IDLE_EFFORT, self.rows(IDLE_TIME))

    def still(self) -> Rows | None:
        """Rows in which nothing moves, by the signals that there are."""
        parts = [(self.speed, STILL_SPEED), (self.turning, STILL_RATE)]
        below = [np.nan_to_num(values, nan=np.inf) < limit for values, limit in parts if values is not None]
        return None if self.speed is None else np.logical_and.reduce(below)

    def ground(self) -> Rows:
        """Standing on the ground: by the land detector, or idle rotors without a fall."""
        carried = self._carried()
        if self.landed is not None and np.any(np.isfinite(self.landed)):
            landed = np.asarray(np.nan_to_num(self.landed, nan=1.0) != 0.0)
            # detectors are seconds late after touch-down, and take a vehicle that fell over for a flying one
            return landed if self.force is None else landed | carried | self.resting()
        return carried | self._at_rest_on(carried, self.still()) | self.resting()

    def resting(self) -> Rows:
        """On the ground at any tilt: no acceleration, though the rotors carry too little or push to the side.

        What flies without acceleration at a great tilt is fast, or else air as fast blows at it; its rotors alone make
        the force along body z, which the ground has a part in otherwise.
        """
        if self.unbalanced is None or self.tilt is None or self.speed is None or self.climb is None:
            return np.zeros(self.count, dtype=bool)
        slow = np.nan_to_num(self.speed, nan=np.inf) < DRIFTING_SPEED
        steady = slow & (self.unbalanced < STEADY_FORCE) & np.isfinite(self.tilt)
        oblique = np.nan_to_num(self.tilt) > TILT_RESTING
        weak = np.zeros(self.count, dtype=bool)
        if self.lift is not None:
            weak = (self.lift < CARRYING_EFFORT) & (np.abs(np.nan_to_num(self.climb)) < SINKING_SPEED)
        return _lasting(steady & (oblique | weak) & ~self._borne(), self.rows(STEADY_TIME))

    def _borne(self) -> Rows:
        """Rows in which the rotors' lift is the whole force along body z."""
        if self.lift is None or self.upward_force is None:
            return np.zeros(self.count, dtype=bool)
        return (self.lift > IDLE_EFFORT) & (np.abs(self.lift - self.upward_force) < BORNE)

    def _carried(self) -> Rows:
        """Rows in which the ground carries the vehicle: idle rotors without free fall, dive or climb."""
        idle, still = self.idle(), self.still()
        if idle is None:
            return np.zeros(self.count, dtype=bool)
        if self.force is not None:
            smooth = scipy.ndimage.uniform_filter1d(np.nan_to_num(self.force, nan=GRAVITY), self.rows(0.1))
            idle = idle & (smooth > RESTING_FORCE * GRAVITY)
            if self.speed is not None:  # in a dive the air carries as much
                idle &= np.nan_to_num(self.speed) < DRIFTING_SPEED
        elif still is not None:
            idle = idle & still
        return _lasting(idle, self.rows(IDLE_TIME))

    def _at_rest_on(self, resting: Rows, still: Rows | None) -> Rows:
        """Standing with turning rotors: still, and as high as where the vehicle has rested with idle ones."""
        at_rest = np.zeros_like(resting)
        if self.height is None or still is None:
            return at_rest
        for start, stop in runs(resting):
            level = float(np.nanmedian(self.height[max(start, stop - self.rows(0.2)) : stop]))
            at_rest |= still & (np.abs(np.nan_to_num(self.height, nan=np.inf) - level) < GROUND_HEIGHT)
        return _lasting(at_rest, self.rows(IDLE_TIME))

    def until_lift_off(self, ground: Rows) -> Rows:
        """The ground's rows and those after each of its runs until the vehicle is higher than there, or climbs."""
        standing = ground.copy()
        if self.height is None or self.climb is None:
            return standing
        for _, stop in runs(ground):
            rows = slice(stop, stop + self.rows(MAX_SPOOL_UP))
            higher = np.nan_to_num(self.height[rows] - self.height[stop - 1], nan=np.inf) > GROUND_HEIGHT
            moving = np.nan_to_num(np.abs(self.climb[rows]), nan=np.inf) > LIFT_OFF_SPEED
            left = np.flatnonzero(higher | moving)
            standing[stop : stop + (int(left[0]) if len(left) else 0)] = True
        return standing

    def flew(self, free: Rows) -> bool:
        """Whether the rotors carried the vehicle in any of the free rows, as far as that shows."""
        return bool(free.any()) and (self.lift is None or bool(np.any(self.lift[free] > IDLE_EFFORT)))

    def jumps(self) -> Floats:
        """(n,) jump of the specific force where it is more than rotors can make, m/s^2; 0 elsewhere."""
        if self.force is None or not np.any(np.isfinite(self.force)):
            return np.zeros(self.count)
        force = np.nan_to_num(self.force, nan=GRAVITY)
        jump = np.abs(force - self._usual(force))
        return np.where(jump > max(IMPACT_FORCE, IMPACT_SPREAD * _scatter(jump)), jump, 0.0)

    def unfelt(self, jumps: Floats) -> Rows:
        """Rows of jumps that only the accelerometer shows: an impact changes the velocity or the body rates at once.

        A blow's impulse is its jumps over time. Where the scatter of the velocity would hide it, or attitude, velocity
        or body rates are missing, it is left for an impact.
        """
        unfelt = np.zeros(self.count, dtype=bool)
        if self.acceleration is None or self.velocity is None or self.rate is None or not jumps.any():
            return unfelt
        turning = np.linalg.norm(self.rate - self._usual(self.rate), axis=1)
        smooth_turning = turning < IMPACT_SPREAD * _scatter(turning)
        usual = np.cumsum(self._usual(self.acceleration), axis=0) * self.period
        strange = self.velocity - usual  # what the smooth acceleration does not explain of the velocity
        width = self.rows(BLOW_SPACING)
        for start, stop in runs(_grown(jumps > 0.0, width)):
            rows = slice(start, stop)
            span = min(stop - start, self.count - 1)
            differences = np.linalg.norm(strange[span:] - strange[:-span], axis=1)
            change = differences[min(start, len(differences) - 1)]
            impulse = float(jumps[rows].sum()) * self.period
            finite = differences[np.isfinite(differences)]
            shows = np.isfinite(change) and np.median(finite) < 0.5 * BLOW_SHARE * impulse
            if shows and change < BLOW_SHARE * impulse and smooth_turning[rows].all():
                unfelt[rows] = jumps[rows] > 0.0
        return unfelt

    def _usual(self, values: Floats) -> Floats:
        """Values without what lasts less than a tenth of a second, by the median of each column."""
        columns = np.nan_to_num(values).reshape(len(values), -1).T
        smooth = [scipy.ndimage.median_filter(column, size=2 * self.rows(0.1) + 1) for column in columns]  # 30 times
        return np.stack(smooth, axis=1).reshape(values.shape)  # as fast as one filter of the table

    def fallen(self) -> Rows:
        """Lying at an angle without moving."""
        still = self.still()
        if still is None or self.tilt is None:
            return np.zeros(self.count, dtype=bool)
        lying = (np.nan_to_num(self.tilt) > TILT_RESTING) & ~self._borne()
        return np.asarray(_lasting(still & lying, self.rows(0.5)) | (self.resting() & lying))

    def overturned(self) -> Rows:
        """Tilted further than in any normal flight."""
        return np.zeros(self.count, dtype=bool) if self.tilt is None else np.nan_to_num(self.tilt) > TILT_FALLEN


def _crashes(indicators: _Indicators, ground: Rows, impacts: Rows) -> Rows:
    """From each crash until the vehicle flies again, if it does."""
    count, fallen = len(ground), indicators.fallen()
    bad_end = fallen | indicators.overturned() | ground
    flew = ~ground & ~fallen
    crash = np.zeros(count, dtype=bool)
    for start, _ in runs(impacts):
        before = flew[max(0, start - indicators.rows(AFTERMATH)) : start]
        after = bad_end[start : start + indicators.rows(AFTERMATH)]
        gentle = _touches_down(indicators, start)
        if len(before) and before.mean() > 0.9 and after.any() and not gentle:
            crash[max(0, start - indicators.rows(IMPACT_MARGIN)) : _recovery(indicators, ground, start)] = True
    for start, _ in runs(fallen & ~crash):
        crash[_loss_of_control(indicators, start) : _recovery(indicators, ground, start)] = True
    return crash


def _touches_down(indicators: _Indicators, row: int) -> bool:
    """Whether an impact is a landing: slow and upright before and after it, and nowhere to fall from."""
    before = slice(max(0, row - indicators.rows(0.2)), row)
    after = slice(row, row + indicators.rows(AFTERMATH))
    if indicators.tilt is None or indicators.speed is None:
        return False
    upright = bool(np.all(indicators.tilt[before] < TILT_RESTING) and np.all(indicators.tilt[after] < TILT_FALLEN))
    height = indicators.height
    fell = height is not None and float(height[row] - np.fmin.reduce(height[after])) > FALL
    return upright and bool(np.all(indicators.speed[before] < LANDING_SPEED)) and not fell


def _loss_of_control(indicators: _Indicators, row: int) -> int:
    """The last upright row before a vehicle lies on its side."""
    assert indicators.tilt is not None
    upright = np.flatnonzero(indicators.tilt[:row] < TILT_RESTING)
    last = int(upright[-1]) if len(upright) else 0
    return max(0, last - indicators.rows(IMPACT_MARGIN))


def _recovery(indicators: _Indicators, ground: Rows, row: int) -> int:
    """The first row after a crash from which on it flies upright for a while; the end if it never does."""
    idle = indicators.idle()
    flies = ~ground & ~indicators.fallen() & ~indicators.overturned()
    if idle is not None:
        flies &= ~idle
    for start, stop in runs(flies[row:]):
        if stop - start >= indicators.rows(RECOVERED) and start > 0:
            return row + start
    return len(ground)


def _named(reason: Reason, flight: Flight, rows: Rows, detail: str) -> list[Exclusion]:
    return [Exclusion(reason, float(flight.time[a]), float(flight.time[b - 1]), detail) for a, b in runs(rows)]


def _scatter(jumps: Floats) -> float:
    """Standard deviation of the usual jumps, by their median."""
    return 1.4826 * float(np.median(jumps))


def _lasting(rows: Rows, min_rows: int) -> Rows:
    """Rows without runs shorter than `min_rows`."""
    lasting = np.zeros_like(rows)
    for start, stop in runs(rows):
        if stop - start >= min_rows:
            lasting[start:stop] = True
    return lasting


def _grown(rows: Rows, margin: int) -> Rows:
    return np.asarray(scipy.ndimage.binary_dilation(rows, iterations=margin)) if rows.any() else rows
