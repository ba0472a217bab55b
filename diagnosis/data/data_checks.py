"""A verdict on the data before any on the physics: can these flights, with this vehicle file, answer at all?"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from diagnosis.data.command_curve import lagged
from diagnosis.data.filters import difference, kept, low_pass
from diagnosis.data.segment import Segment
from dynamics.arrays import Floats
from dynamics.errors import DataError
from dynamics.vehicle import GRAVITY, Vehicle

SHORTEST = 20.0  # s of flight in all
GENTLE_SPEED, GENTLE_RATE, GENTLE_FORCE = 0.25, 0.10, 0.5  # m/s, rad/s, m/s^2, RMS: less is hover
THRUST_RATIO = (0.6, 1.67)  # model over measured, beyond which the vehicle file is another vehicle's
RPM = 2 * np.pi / 60
DEGREES = 180 / np.pi
AGREES, DISAGREES = 0.7, 0.4  # correlation of modelled with measured angular acceleration
STANDS_OUT, APART = 0.45, 0.2  # the same of an order that fits less, but better than all others by as much
OPPOSITE = -0.4  # the same, of rotors that turn the vehicle the other way than the file says
ROTORS_TELL = 0.5  # share of the turning that rotors explain in some mixture, if not in the file's
MIN_TURNING = 0.5  # rad/s^2 RMS of angular acceleration that a correlation needs
MIN_YAWING = 0.3  # the same about z, where rotors push less
TURNING_RATIO = (0.2, 5.0)  # measured over modelled angular acceleration
LEAN_RATIO = (0.2, 5.0)  # horizontal acceleration of the pose over what the vehicle's lean gives
MIN_LEAN = 0.3  # m/s^2 RMS of the latter that the ratio needs
STANDING = 0.1  # of hover speed, below which a rotor's reading is dead
MAX_PERMUTED = 6  # rotors
RESPONSES = (0.0, 0.03, 0.06, 0.1)  # s by which rotors may follow commands


def require_answerable(segments: Sequence[Segment], vehicle: Vehicle) -> None:
    """Raise DataError, with what to do, for flights too short or gentle or a vehicle file that cannot be theirs."""
    duration = sum(s.duration for s in segments)
    if duration < SHORTEST:
        raise DataError(
            f"{duration:.0f} s of flight are too short to tell effects apart. Fly {SHORTEST:.0f} s or more."
        )
    _require_motion(segments)
    _require_metres(segments)
    _require_live_rotors(segments, vehicle)
    _require_thrust(segments, vehicle)
    _require_turning(segments, vehicle)


def _require_motion(segments: Sequence[Segment]) -> None:
    rate = float(np.sqrt(np.mean(np.sum(np.vstack([low_pass(s.body_rate, s.rate) for s in segments]) ** 2, axis=1))))
    if all("velocity" in s.lacks for s in segments):
        pushed = float(np.std(np.concatenate([low_pass(_specific_thrust(s), s.rate) for s in segments])))
        gentle, seen = pushed < GENTLE_FORCE, f"{pushed:.2f} m/s^2 of change in thrust"
    else:
        velocity = np.vstack([s.velocity[:, :2] for s in segments])  # climbing alone tells little
        speed = float(np.sqrt(np.mean(np.sum((velocity - velocity.mean(axis=0)) ** 2, axis=1))))
        gentle, seen = speed < GENTLE_SPEED, f"{speed:.2f} m/s horizontally"
    if gentle and rate < GENTLE_RATE:
        raise DataError(
            f"the flights are too gentle: {seen} and {rate:.2f} rad/s RMS. Nearly all effects look alike in "
            "hover. Fly straight accelerations to 3 m/s or more along both axes, yaw spins and fast climbs."
        )


def _require_metres(segments: Sequence[Segment]) -> None:
    """The pose must accelerate as the accelerometer feels it, or as the vehicle leans."""
    posed = [s for s in segments if s.has_pose]
    if not posed:
        return
    moved, felt = [], []
    for s in posed:
        force = np.tile([0.0, 0.0, GRAVITY], (len(s), 1)) if s.specific_force is None else s.specific_force
        moved.append(low_pass(difference(s.velocity, s.rate), s.rate)[:, :2])
        felt.append(low_pass(np.einsum("nij,nj->ni", s.to_world, force), s.rate)[:, :2])
    seen, wanted = (float(np.sqrt(np.mean(np.vstack(x) ** 2))) for x in (moved, felt))
    if wanted < MIN_LEAN or LEAN_RATIO[0] <= seen / wanted <= LEAN_RATIO[1]:
        return
    hint = "Check the units of position and velocity (m, m/s) and of the time (s)."
    if 0.5 < seen / wanted / 1000 < 2.0:
        hint = "That is millimetres for metres: convert position and velocity, or give a column mapping."
    raise DataError(
        f"by its position and velocity the vehicle accelerates {seen / wanted:.3g} times as much as it leans; wanted "
        f"{LEAN_RATIO[0]:g} to {LEAN_RATIO[1]:g}. {hint}"
    )


def _require_live_rotors(segments: Sequence[Segment], vehicle: Vehicle) -> None:
    for flight in dict.fromkeys(s.flight for s in segments):
        speeds = np.vstack([s.rotor_speed for s in segments if s.flight == flight])
        dead = [i for i, speed in enumerate(np.median(speeds, axis=0)) if speed < STANDING * vehicle.hover_speed]
        if dead:
            raise DataError(
                f"{flight}: rotor {', '.join(map(str, dead))} reads nearly zero speed while the vehicle flies: its "
                "speed sensor is dead (rotor_speed_fault), not the rotor. Repair it, or give a log with the motor "
                "commands instead."
            )


def _require_thrust(segments: Sequence[Segment], vehicle: Vehicle) -> None:
    modelled = np.concatenate([s.rotor_speed**2 @ vehicle.rotors.allocation[0] for s in segments])
    wanted = np.concatenate([_specific_thrust(s) for s in segments]) * vehicle.body.mass
    ratio = float(np.mean(modelled) / np.mean(wanted))
    if THRUST_RATIO[0] <= ratio <= THRUST_RATIO[1]:
        return
    hint = "Check mass, thrust_constant and that the file is this vehicle's."
    if 0.6 <= ratio * RPM**2 <= 1.67:
        hint = "The ratio is that of rpm to rad/s: the log's rotor speeds are in rpm, or thrust_constant is per rpm^2."
    elif 0.6 <= ratio / RPM**2 <= 1.67:
        hint = "The ratio is that of rad/s to rpm: thrust_constant is per (rad/s)^2, or the speeds are in rad/s twice."
    raise DataError(
        f"with this vehicle file the rotors give {ratio:.3g} times the thrust that the motion needs; wanted "
        f"{THRUST_RATIO[0]:.1f} to {THRUST_RATIO[1]:.1f}. {hint}"
    )


def _specific_thrust(segment: Segment) -> Floats:
    """(n,) specific force along body z that the motion has, m/s^2."""
    if segment.specific_force is not None:
        return np.asarray(segment.specific_force[:, 2])
    world = low_pass(difference(segment.velocity, segment.rate), segment.rate) + np.array([0, 0, GRAVITY])
    return np.asarray(np.einsum("nj,nj->n", segment.to_world[:, :, 2], world))


def _require_turning(segments: Sequence[Segment], vehicle: Vehicle) -> None:
    """The vehicle must turn as the rotors push; if another order of rotors or other units fit, say which."""
    measured, squares = _turning_and_rotors(segments, vehicle)
    rows = vehicle.rotors.allocation[1:]
    if min(float(np.std(measured[:, 0])), float(np.std(measured[:, 1]))) >= MIN_TURNING:
        own = _agreement(measured, squares, rows)
        _require_order(own, measured, squares, rows)
        if own > DISAGREES:
            _require_scale(measured[:, :2], squares @ rows[:2].T / np.array(vehicle.body.inertia[:2]))
    if float(np.std(measured[:, 2])) >= MIN_YAWING and _correlation(measured[:, 2], squares @ rows[2]) < OPPOSITE:
        raise DataError(
            "the rotors yaw the vehicle the other way than the vehicle file says (agreement "
            f"{_correlation(measured[:, 2], squares @ rows[2]):.2f}). Turn the signs of [rotors] spin, or check that "
            "rates are body FLU and rotors in the file's order."
        )


def _require_order(own: float, measured: Floats, squares: Floats, rows: Floats) -> None:
    count = squares.shape[1]
    if own > DISAGREES:
        return
    if count <= MAX_PERMUTED:
        orders = list(itertools.permutations(range(count)))
        fits = [_agreement(measured, squares[:, list(order)], rows) for order in orders]
        best, second = np.argsort(fits)[::-1][:2].tolist()
        if fits[best] > AGREES or (fits[best] > STANDS_OUT and fits[best] - fits[second] > APART):
            raise DataError(
                f"the rotors do not turn the vehicle as the vehicle file says (agreement {own:.2f}). They do in "
                f"another order: the log's columns {list(orders[best])} are the file's rotors {list(range(count))} "
                f"(agreement {fits[best]:.2f}). Reorder [rotors] position and spin, or the log's columns."
            )
    if own < OPPOSITE or _explained(measured[:, :2], squares) > ROTORS_TELL:
        tried = "no other order of them fits" if count <= MAX_PERMUTED else "their orders are too many to try"
        raise DataError(
            f"the rotors do not turn the vehicle as the vehicle file says (agreement {own:.2f}), and {tried}. Check "
            "their order and [rotors] position (body FLU: x forward, y left), and that rates are body FLU."
        )


def _require_scale(measured: Floats, modelled: Floats) -> None:
    """measured, modelled: (m, 2) angular acceleration about x and y, rad/s^2."""
    size = np.std(modelled, axis=0)
    slope = float(np.median(np.sqrt(np.var(measured, axis=0)) / size))
    if TURNING_RATIO[0] <= slope <= TURNING_RATIO[1]:
        return
    hint = "Check inertia (kg m^2) and [rotors] position (m)."
    if 0.4 * DEGREES < slope < 2.5 * DEGREES:
        hint = "That is degrees for radians: convert the log's rates to rad/s, or give a mapping with unit = 'deg/s'."
    raise DataError(
        f"with this vehicle file the vehicle turns {slope:.3g} times as fast as its rotors push; wanted "
        f"{TURNING_RATIO[0]:g} to {TURNING_RATIO[1]:g}. {hint}"
    )


def _turning_and_rotors(segments: Sequence[Segment], vehicle: Vehicle) -> tuple[Floats, Floats]:
    """(m, 3) angular acceleration and (m, rotors) squared speeds, as late behind commands as fits best."""
    commanded = segments[0].rotor_source != "measured"
    turning = [low_pass(difference(s.body_rate, s.rate), s.rate)[kept(len(s), s.rate)] for s in segments]
    measured = np.vstack(turning)
    found = []
    for response in RESPONSES if commanded else RESPONSES[:1]:
        late = [replace(s, rotor_speed=lagged(s.rotor_speed, s.rate, response)) for s in segments]
        found.append(np.vstack([low_pass(s.rotor_speed**2, s.rate)[kept(len(s), s.rate)] for s in late]))
    explained = [_explained(measured[:, :2], squares) for squares in found]
    return measured, found[int(np.argmax(explained))]


def _explained(measured: Floats, squares: Floats) -> float:
    """Share of the turning that any mixture of the rotors explains, whatever their order."""
    columns = np.column_stack([squares, np.ones(len(squares))])
    left = measured - columns @ np.linalg.lstsq(columns, measured, rcond=None)[0]
    return 1.0 - float(np.sum(left**2) / max(float(np.sum(measured**2)), 1e-30))


def _agreement(measured: Floats, squares: Floats, rows: Floats) -> float:
    """The lesser correlation of roll and pitch."""
    modelled = squares @ rows.T
    return min(_correlation(measured[:, i], modelled[:, i]) for i in range(2))


def _correlation(one: Floats, other: Floats) -> float:
    return float(np.corrcoef(one, other)[0, 1])
