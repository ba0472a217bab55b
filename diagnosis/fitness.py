"""A verdict on the data before any on the physics: can these flights, with this vehicle file, answer at all?"""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np

from diagnosis.filters import Floats, difference, kept, low_pass
from diagnosis.stretch import Stretch
from dynamics.errors import DataError
from dynamics.vehicle import GRAVITY, Vehicle

SHORTEST = 20.0  # s of flight in all
GENTLE_SPEED, GENTLE_RATE = 0.25, 0.10  # m/s and rad/s, RMS: less is hover
THRUST_RATIO = (0.6, 1.67)  # model over measured, beyond which the vehicle file is another vehicle's
RPM = 2 * np.pi / 60
AGREES, DISAGREES = 0.7, 0.4  # correlation of modelled with measured angular acceleration
LEAST_TURNING = 0.5  # rad/s^2 RMS of angular acceleration that a correlation needs
STANDING = 0.1  # of hover speed, below which a rotor's reading is dead
MOST_PERMUTED = 6  # rotors


def require_answerable(stretches: Sequence[Stretch], vehicle: Vehicle) -> None:
    """Raise DataError, with what to do, for flights too short or gentle or a vehicle file that cannot be theirs."""
    duration = sum(s.duration for s in stretches)
    if duration < SHORTEST:
        raise DataError(
            f"{duration:.0f} s of flight are too short to tell effects apart. Fly {SHORTEST:.0f} s or more."
        )
    _require_motion(stretches)
    _require_live_rotors(stretches, vehicle)
    _require_thrust(stretches, vehicle)
    _require_rotor_order(stretches, vehicle)


def _require_motion(stretches: Sequence[Stretch]) -> None:
    velocity = np.vstack([s.velocity for s in stretches])
    speed = float(np.sqrt(np.mean(np.sum((velocity - velocity.mean(axis=0)) ** 2, axis=1))))
    rate = float(np.sqrt(np.mean(np.sum(np.vstack([low_pass(s.body_rate, s.rate) for s in stretches]) ** 2, axis=1))))
    if speed < GENTLE_SPEED and rate < GENTLE_RATE:
        raise DataError(
            f"the flights are too gentle: {speed:.2f} m/s and {rate:.2f} rad/s RMS. Nearly all effects look alike in "
            "hover. Fly straight accelerations to 3 m/s or more along both axes, yaw spins and fast climbs."
        )


def _require_live_rotors(stretches: Sequence[Stretch], vehicle: Vehicle) -> None:
    speeds = np.vstack([s.rotor_speed for s in stretches])
    dead = [i for i, speed in enumerate(np.median(speeds, axis=0)) if speed < STANDING * vehicle.hover_speed]
    if dead:
        raise DataError(
            f"rotor {', '.join(map(str, dead))} reads nearly zero speed while the vehicle flies: its speed sensor is "
            "dead (rotor_speed_fault), not the rotor. Repair it, or give a log with the motor commands instead."
        )


def _require_thrust(stretches: Sequence[Stretch], vehicle: Vehicle) -> None:
    modelled = np.concatenate([s.rotor_speed**2 @ vehicle.rotors.allocation[0] for s in stretches])
    wanted = np.concatenate([_specific_thrust(s) for s in stretches]) * vehicle.body.mass
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


def _specific_thrust(stretch: Stretch) -> Floats:
    """(n,) specific force along body z that the motion has, m/s^2."""
    if stretch.specific_force is not None:
        return np.asarray(stretch.specific_force[:, 2])
    world = low_pass(difference(stretch.velocity, stretch.rate), stretch.rate) + np.array([0, 0, GRAVITY])
    return np.asarray(np.einsum("nj,nj->n", stretch.to_world[:, :, 2], world))


def _require_rotor_order(stretches: Sequence[Stretch], vehicle: Vehicle) -> None:
    """Roll and pitch must turn as the rotors push; if another order of rotors fits, say which."""
    measured, squares = _turning_and_rotors(stretches)
    if min(float(np.std(measured[:, 0])), float(np.std(measured[:, 1]))) < LEAST_TURNING:
        return
    rows = vehicle.rotors.allocation[1:3]
    own = _agreement(measured, squares, rows)
    if own > DISAGREES or vehicle.rotors.count > MOST_PERMUTED:
        return
    orders = list(itertools.permutations(range(vehicle.rotors.count)))
    fits = [_agreement(measured, squares[:, list(order)], rows) for order in orders]
    best = int(np.argmax(fits))
    if fits[best] > AGREES:
        raise DataError(
            f"the rotors do not turn the vehicle as the vehicle file says (agreement {own:.2f}). They do in another "
            f"order: the log's columns {list(orders[best])} are the file's rotors {list(range(len(orders[best])))} "
            f"(agreement {fits[best]:.2f}). Reorder [rotors] position and spin, or the log's columns."
        )


def _turning_and_rotors(stretches: Sequence[Stretch]) -> tuple[Floats, Floats]:
    turning, squares = [], []
    for s in stretches:
        rows = kept(len(s), s.rate)
        turning.append(low_pass(difference(s.body_rate, s.rate), s.rate)[rows])
        squares.append(low_pass(s.rotor_speed**2, s.rate)[rows])
    return np.vstack(turning), np.vstack(squares)


def _agreement(measured: Floats, squares: Floats, rows: Floats) -> float:
    """The lesser correlation of roll and pitch."""
    modelled = squares @ rows.T
    return min(float(np.corrcoef(measured[:, i], modelled[:, i])[0, 1]) for i in range(2))
