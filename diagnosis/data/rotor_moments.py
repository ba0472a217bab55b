"""Whether the rotors turn the vehicle as the vehicle file says: their order, their clock, their turning directions.

The angular acceleration is compared with the rotors' moments after everything else that turns a vehicle is removed
from both by regression: the air on a vehicle that travels (blade flapping, drag off the centre of mass), damping, a
centre of mass beside the thrust, and each segment's mean. Without that, rotors that hold a travelling vehicle against
the air correlate little with its rotation: by 0.25 in fast flights of real Crazyflies, with it by 0.67.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from diagnosis.data.command_curve import lagged
from diagnosis.data.filters import difference
from diagnosis.data.segment import Segment
from diagnosis.thresholds import DEFAULT, RotorMomentChecks
from dynamics.arrays import Floats
from dynamics.errors import DataError
from dynamics.state import VELOCITY
from dynamics.vehicle import Vehicle
from flights.quality.findings import Finding

DEGREES = 180 / np.pi


@dataclass(frozen=True, eq=False)
class RotorMoments:
    """Rotation and rotors, what air, damping and centre of mass explain removed from both. m rows, k rotors.

    acceleration: (m, 3) angular acceleration, body, with the gyroscopic term, rad/s^2.
    squares: (m, k) squared rotor speeds behind a lag, (rad/s)^2.
    rows: (3, k) moment of a unit of each, of the vehicle file.
    axes: which of roll and pitch accelerate enough to be judged.
    """

    acceleration: Floats
    squares: Floats
    rows: Floats
    axes: tuple[int, ...]

    @property
    def explained(self) -> float:
        """Share of the angular acceleration that any mixture of the rotors explains, whatever their order."""
        shares = []
        for axis in self.axes:
            y = self.acceleration[:, axis]
            residual = y - self.squares @ np.linalg.lstsq(self.squares, y, rcond=None)[0]
            shares.append(1.0 - float(residual @ residual) / max(float(y @ y), 1e-30))
        return float(np.mean(shares)) if shares else 0.0

    def correlations(self, order: Sequence[int]) -> Floats:
        """(3,) of acceleration and moments. order: the log's column of each rotor of the file."""
        moments = self.squares[:, list(order)] @ self.rows.T
        sizes = np.sqrt(np.sum(moments**2, axis=0) * np.sum(self.acceleration**2, axis=0))
        return np.asarray(np.sum(moments * self.acceleration, axis=0) / np.maximum(sizes, 1e-30))

    def agreement(self, order: Sequence[int]) -> float:
        """Share of the angular acceleration that an order explains; an opposite axis counts negatively."""
        values = self.correlations(order)[list(self.axes)]
        return float(np.mean(values * np.abs(values)))


def rotor_gains(moments: RotorMoments, vehicle: Vehicle) -> Floats:
    """(k,) moment of each rotor over what the file gives for its speed, over the median rotor's."""
    columns, targets = [], []
    for axis in moments.axes:
        columns.append(moments.squares * moments.rows[axis] / vehicle.body.inertia[axis])
        targets.append(moments.acceleration[:, axis])
    if not columns:
        return np.ones(vehicle.rotors.count)
    gains = np.linalg.lstsq(np.vstack(columns), np.concatenate(targets), rcond=None)[0]
    usual = float(np.median(gains))
    return np.asarray(gains / usual) if usual > 0.0 else np.ones(vehicle.rotors.count)


def require_rotor_moments(
    segments: Sequence[Segment], vehicle: Vehicle, limits: RotorMomentChecks = DEFAULT.rotor_moments
) -> tuple[Finding, ...]:
    """Raise DataError when the rotors do not turn the vehicle as it turns, naming an order, units or clock that fit.

    Returns a finding where the rotors explain little of the rotation, so that torques are hardly visible.
    """
    moments = compared_moments(segments, vehicle, limits)
    findings: tuple[Finding, ...] = ()
    if moments.axes:
        findings = _require_relation(moments, segments, vehicle, limits)
        _require_order(moments, limits)
        _require_proportion(moments, limits)
        _require_scale(moments, vehicle, limits)
    _require_spin(moments, vehicle, limits)
    for flight in dict.fromkeys(s.flight for s in segments):
        own = [s for s in segments if s.flight == flight]
        if sum(s.duration for s in own) >= limits.min_flight and len(own) < len(segments):
            _require_same_order(flight, compared_moments(own, vehicle, limits), limits)
    return findings


def compared_moments(
    segments: Sequence[Segment], vehicle: Vehicle, limits: RotorMomentChecks = DEFAULT.rotor_moments
) -> RotorMoments:
    """With the lag behind commands that explains most; measured speeds have none."""
    lags = limits.response_times if segments[0].rotor_source != "measured" else (0.0,)
    motion = [(_rotation(s, vehicle), _others(s)) for s in segments]
    at_lags = [_compared(motion, _squares(segments, lag), vehicle, limits) for lag in lags]
    return max(at_lags, key=lambda moments: moments.explained)


def _squares(segments: Sequence[Segment], lag: float) -> list[Floats]:
    """(m, rotors) squared rotor speeds of each segment behind a lag in s, (rad/s)^2."""
    return [s.low_pass(lagged(s.rotor_speed, s.rate, lag) ** 2)[s.decimated] for s in segments]


def _compared(
    motion: Sequence[tuple[Floats, Floats]],
    squares: Sequence[Floats],
    vehicle: Vehicle,
    limits: RotorMomentChecks,
    *,
    shift: int = 0,
) -> RotorMoments:
    """motion: of each segment, rotation and what else turns it. shift: rows by which the rotors are taken later."""
    rotors, nuisances, rotations = [], [], []
    for (rotation, others), speeds in zip(motion, squares, strict=True):
        early, late = (
            slice(max(-shift, 0), len(speeds) - max(shift, 0)),
            slice(max(shift, 0), len(speeds) - max(-shift, 0)),
        )
        if len(speeds[late]) > limits.min_rows:
            rotors.append(_centred(speeds[late]))
            nuisances.append(_centred(np.column_stack([others[early], speeds[late].sum(axis=1)])))
            rotations.append(_centred(rotation[early]))
    if not rotors:
        return RotorMoments(np.zeros((1, 3)), np.zeros((1, vehicle.rotors.count)), vehicle.rotors.allocation[1:], ())
    x, z, y = (np.vstack(parts) for parts in (rotors, nuisances, rotations))
    z = z / np.maximum(np.std(z, axis=0), 1e-12)
    x, y = (values - z @ np.linalg.lstsq(z, values, rcond=None)[0] for values in (x, y))
    axes = tuple(axis for axis in range(2) if float(np.std(y[:, axis])) >= limits.min_angular_acceleration)
    return RotorMoments(y, x, vehicle.rotors.allocation[1:], axes)


def _centred(values: Floats) -> Floats:
    return np.asarray(values - values.mean(axis=0))


def _rotation(segment: Segment, vehicle: Vehicle) -> Floats:
    """(m, 3) moment over inertia that the rotation has, rad/s^2."""
    inertia = np.array(vehicle.body.inertia)
    gyroscopic = np.cross(segment.body_rate, inertia * segment.body_rate) / inertia
    return segment.low_pass(difference(segment.body_rate, segment.rate) + gyroscopic)[segment.decimated]


def _others(segment: Segment) -> Floats:
    """(m, 3 or 6) what turns a vehicle besides its rotors: body rates, and the body's velocity where it was logged."""
    rate = segment.low_pass(segment.body_rate)[segment.decimated]
    if not segment.has_pose:
        return rate
    velocity = np.einsum("nji,nj->ni", segment.to_world, segment.smooth[:, VELOCITY])
    return np.hstack([rate, segment.low_pass(velocity)[segment.decimated]])


def _require_order(moments: RotorMoments, limits: RotorMomentChecks) -> None:
    """No other order of the rotors may explain the rotation clearly better than the file's."""
    count = moments.squares.shape[1]
    own = moments.agreement(range(count))
    best, fit, apart = _best_order(moments, limits)
    if fit - own <= limits.order_margin:
        return
    disagree = f"the rotors do not turn the vehicle as the vehicle file says (agreement {own:.2f})"
    if apart > limits.order_margin:
        raise DataError(
            f"{disagree}. They do in another order: the log's columns {list(best)} are the file's rotors "
            f"{list(range(count))} (agreement {fit:.2f}). Reorder [rotors] position and spin, or the log's columns."
        )
    raise DataError(
        f"{disagree}. Another order fits better (agreement {fit:.2f}), but these flights do not show which. Check the "
        "order of [rotors] position (body FLU: x forward, y left) and of the log's columns."
    )


def _require_same_order(flight: str, moments: RotorMoments, limits: RotorMomentChecks) -> None:
    """One flight of several may not have its rotors in another order, as after a change of firmware or of vehicle."""
    if not moments.axes:
        return
    own = moments.agreement(range(moments.squares.shape[1]))
    best, fit, apart = _best_order(moments, limits)
    if fit - own > 2 * limits.order_margin and apart > limits.order_margin:
        raise DataError(
            f"{flight}: here the rotors turn the vehicle in another order than in the other flights: the log's columns "
            f"{list(best)} are the file's rotors {list(range(len(best)))} (agreement {fit:.2f}, in the file's order "
            f"{own:.2f}). Leave it out, or reorder its columns."
        )


def _best_order(moments: RotorMoments, limits: RotorMomentChecks) -> tuple[tuple[int, ...], float, float]:
    """The order with the greatest agreement, its agreement, and by how much it exceeds the next."""
    count = moments.squares.shape[1]
    usual = tuple(range(count))
    if count > limits.max_permuted_rotors:
        return usual, moments.agreement(usual), 0.0
    tried = list(itertools.permutations(usual))
    products = moments.acceleration.T @ moments.squares
    gram = moments.squares.T @ moments.squares
    energy = np.sum(moments.acceleration**2, axis=0)
    fits = np.zeros(len(tried))
    for i, order in enumerate(tried):
        places = list(order)
        for axis in moments.axes:
            row = moments.rows[axis]
            size = np.sqrt(float(row @ gram[np.ix_(places, places)] @ row) * float(energy[axis]))
            value = float(row @ products[axis, places]) / max(size, 1e-30)
            fits[i] += value * abs(value) / len(moments.axes)
    first, second = np.argsort(fits)[::-1][:2].tolist() if len(tried) > 1 else (0, 0)
    return tried[first], float(fits[first]), float(fits[first] - fits[second])


def _require_relation(
    moments: RotorMoments, segments: Sequence[Segment], vehicle: Vehicle, limits: RotorMomentChecks
) -> tuple[Finding, ...]:
    """The rotors must have to do with the rotation: else they are of another clock, or of another flight."""
    explained = moments.explained
    seconds, shifted = _best_shift(segments, vehicle, limits)
    towards = "earlier" if seconds > 0 else "later"
    if shifted > max(explained + limits.order_margin, limits.min_explained):
        raise DataError(
            f"the rotors explain {explained:.0%} of the angular acceleration as they are logged, and {shifted:.0%} if "
            f"they are shifted by {abs(seconds):.2f} s to {towards} times: their clock is not the "
            "gyro's. Log both with one clock, or shift the columns by that time."
        )
    if explained >= limits.min_explained:
        return ()
    text = f"the rotors explain {explained:.0%} of the angular acceleration, in any order and on any clock"
    if explained < limits.no_relation:
        raise DataError(
            f"{text}: they say nothing about moments. Check that the columns are this flight's rotors, that gyro and "
            "rotors are logged unfiltered and at their own times, and fly briskly about roll and pitch."
        )
    advice = "fly more briskly about roll and pitch, and log rotors and gyro at 100 Hz or more with one clock"
    return (Finding("warning", "weak_moments", f"{text}: torques are hardly visible in these flights", advice),)


def _best_shift(segments: Sequence[Segment], vehicle: Vehicle, limits: RotorMomentChecks) -> tuple[float, float]:
    """The shift of the rotors' clock, s, that explains most, and the share that it explains."""
    rate = segments[0].decimated_rate
    lag = 0.0 if segments[0].rotor_source == "measured" else limits.response_times[len(limits.response_times) // 2]
    motion, squares = [(_rotation(s, vehicle), _others(s)) for s in segments], _squares(segments, lag)
    steps = range(-round(limits.max_shift * rate), round(limits.max_shift * rate) + 1)
    tried = [(_compared(motion, squares, vehicle, limits, shift=step).explained, step / rate) for step in steps]
    explained, seconds = max(tried)
    return seconds, explained


def _require_proportion(moments: RotorMoments, limits: RotorMomentChecks) -> None:
    """The file's arms must combine the rotors nearly as well as any combination of them does."""
    count, explained = moments.squares.shape[1], moments.explained
    own = moments.agreement(range(count))
    if explained < limits.min_explained or own >= limits.min_share_of_mixture * explained:
        return
    tried = "no other order of them fits" if count <= limits.max_permuted_rotors else "their orders are too many to try"
    raise DataError(
        f"the rotors do not turn the vehicle as the vehicle file says (agreement {own:.2f}, any combination of them "
        f"{explained:.2f}), and {tried}. Check their order and [rotors] position (body FLU: x forward, y left), and "
        "that rates are body FLU."
    )


def _require_scale(moments: RotorMoments, vehicle: Vehicle, limits: RotorMomentChecks) -> None:
    axes, inertia = list(moments.axes), np.array(vehicle.body.inertia)
    if moments.agreement(range(moments.squares.shape[1])) < limits.order_margin:
        return
    modelled = (moments.squares @ moments.rows.T / inertia)[:, axes]
    ratio = float(np.median(np.std(moments.acceleration[:, axes], axis=0) / np.std(modelled, axis=0)))
    low, high = limits.angular_ratio
    if low <= ratio <= high:
        return
    hint = "Check inertia (kg m^2) and [rotors] position (m)."
    if DEGREES / limits.unit_slack < ratio < DEGREES * limits.unit_slack:
        hint = "That is degrees for radians: convert the log's rates to rad/s, or give a mapping with unit = 'deg/s'."
    raise DataError(
        f"with this vehicle file the vehicle turns {ratio:.3g} times as fast as its rotors push; wanted "
        f"{low:g} to {high:g}. {hint}"
    )


def _require_spin(moments: RotorMoments, vehicle: Vehicle, limits: RotorMomentChecks) -> None:
    """The rotors may not yaw the vehicle the other way, by about what they yaw it.

    Where something else yaws it far more, as drag beside the centre of mass does, they answer that: opposite, too.
    """
    if float(np.std(moments.acceleration[:, 2])) < limits.min_yaw_acceleration:
        return
    count = moments.squares.shape[1]
    yaw = float(moments.correlations(range(count))[2])
    modelled = moments.squares @ moments.rows[2] / vehicle.body.inertia[2]
    ratio = abs(yaw) * float(np.std(moments.acceleration[:, 2]) / max(float(np.std(modelled)), 1e-30))
    if yaw < limits.opposite_yaw and ratio <= limits.max_opposite_ratio:
        raise DataError(
            "the rotors yaw the vehicle in the direction opposite to the vehicle file's (agreement "
            f"{yaw:.2f}). Turn the signs of [rotors] spin, or check that rates are body FLU and rotors in the file's "
            "order."
        )
