"""Checks of flights and vehicle file before any model is judged: duration, motion, units, rotors, inertia."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from diagnosis.data.command_curve import lagged
from diagnosis.data.filters import difference
from diagnosis.data.segment import Segment
from diagnosis.thresholds import DEFAULT, DataChecks
from dynamics.arrays import Floats
from dynamics.errors import DataError
from dynamics.units import RPM
from dynamics.vehicle import GRAVITY, Vehicle

DEGREES = 180 / np.pi


def require_answerable(segments: Sequence[Segment], vehicle: Vehicle, limits: DataChecks = DEFAULT.data_checks) -> None:
    """Raise DataError, with what to do, for flights too short or gentle or a vehicle file that cannot be theirs."""
    duration = sum(s.duration for s in segments)
    if duration < limits.min_duration:
        raise DataError(
            f"{duration:.0f} s of flight are too short to tell effects apart. Fly {limits.min_duration:.0f} s or more."
        )
    _require_motion(segments, limits)
    _require_metres(segments, limits)
    _require_live_rotors(segments, vehicle, limits)
    _require_thrust(segments, vehicle, limits)
    _require_angular_acceleration(segments, vehicle, limits)


def _require_motion(segments: Sequence[Segment], limits: DataChecks) -> None:
    body_rate = np.vstack([s.low_pass(s.body_rate) for s in segments])
    rate = float(np.sqrt(np.mean(np.sum(body_rate**2, axis=1))))
    if all("velocity" in s.lacks for s in segments):
        change = float(np.std(np.concatenate([s.low_pass(_specific_thrust(s)) for s in segments])))
        gentle, motion = change < limits.min_thrust_change, f"{change:.2f} m/s^2 of change in thrust"
    else:
        velocity = np.vstack([s.velocity[:, :2] for s in segments])  # climbing alone shows few effects
        speed = float(np.sqrt(np.mean(np.sum((velocity - velocity.mean(axis=0)) ** 2, axis=1))))
        gentle, motion = speed < limits.min_speed, f"{speed:.2f} m/s horizontally"
    if gentle and rate < limits.min_rate:
        raise DataError(
            f"the flights are too gentle: {motion} and {rate:.2f} rad/s RMS. Nearly all effects look alike in "
            "hover. Fly straight accelerations to 3 m/s or more along both axes, yaw spins and fast climbs."
        )


def _require_metres(segments: Sequence[Segment], limits: DataChecks) -> None:
    """The pose must accelerate as the accelerometer measures it, or as the vehicle's tilt gives it."""
    posed = [s for s in segments if s.has_pose]
    if not posed:
        return
    of_pose, of_tilt = [], []
    for s in posed:
        force = np.tile([0.0, 0.0, GRAVITY], (len(s), 1)) if s.specific_force is None else s.specific_force
        of_pose.append(s.low_pass(difference(s.velocity, s.rate))[:, :2])
        of_tilt.append(s.low_pass(np.einsum("nij,nj->ni", s.to_world, force))[:, :2])
    pose, tilt = (float(np.sqrt(np.mean(np.vstack(x) ** 2))) for x in (of_pose, of_tilt))
    low, high = limits.tilt_ratio
    if tilt < limits.min_tilt_acceleration or low <= pose / tilt <= high:
        return
    hint = "Check the units of position and velocity (m, m/s) and of the time (s)."
    if 0.5 < pose / tilt / 1000 < 2.0:
        hint = "That is millimetres for metres: convert position and velocity, or give a column mapping."
    raise DataError(
        f"by its position and velocity the vehicle accelerates {pose / tilt:.3g} times as much as its tilt gives; "
        f"wanted {low:g} to {high:g}. {hint}"
    )


def _require_live_rotors(segments: Sequence[Segment], vehicle: Vehicle, limits: DataChecks) -> None:
    min_speed = limits.min_rotor_speed * vehicle.hover_speed
    for flight in dict.fromkeys(s.flight for s in segments):
        speeds = np.vstack([s.rotor_speed for s in segments if s.flight == flight])
        dead = [i for i, speed in enumerate(np.median(speeds, axis=0)) if speed < min_speed]
        if dead:
            raise DataError(
                f"{flight}: rotor {', '.join(map(str, dead))} reads nearly zero speed while the vehicle flies: its "
                "speed sensor is dead (rotor_speed_fault), not the rotor. Repair it, or give a log with the motor "
                "commands instead."
            )


def _require_thrust(segments: Sequence[Segment], vehicle: Vehicle, limits: DataChecks) -> None:
    modelled = np.concatenate([s.rotor_speed**2 @ vehicle.rotors.allocation[0] for s in segments])
    needed = np.concatenate([_specific_thrust(s) for s in segments]) * vehicle.body.mass
    ratio = float(np.mean(modelled) / np.mean(needed))
    low, high = limits.thrust_ratio
    if low <= ratio <= high:
        return
    hint = "Check mass, thrust_constant and that the file is this vehicle's."
    if low <= ratio * RPM**2 <= high:
        hint = "The ratio is that of rpm to rad/s: the log's rotor speeds are in rpm, or thrust_constant is per rpm^2."
    elif low <= ratio / RPM**2 <= high:
        hint = "The ratio is that of rad/s to rpm: thrust_constant is per (rad/s)^2, or the speeds are in rad/s twice."
    raise DataError(
        f"with this vehicle file the rotors give {ratio:.3g} times the thrust that the motion needs; wanted "
        f"{low:.1f} to {high:.1f}. {hint}"
    )


def _specific_thrust(segment: Segment) -> Floats:
    """(n,) specific force along body z that the motion has, m/s^2."""
    if segment.specific_force is not None:
        return np.asarray(segment.specific_force[:, 2])
    world = segment.low_pass(difference(segment.velocity, segment.rate)) + np.array([0, 0, GRAVITY])
    return np.asarray(np.einsum("nj,nj->n", segment.to_world[:, :, 2], world))


def _require_angular_acceleration(segments: Sequence[Segment], vehicle: Vehicle, limits: DataChecks) -> None:
    """The rotors must rotate the vehicle as it rotates; the error names another order or other units that fit."""
    measured, squares = _rotation_and_rotors(segments, vehicle, limits)
    rows = vehicle.rotors.allocation[1:]
    if min(float(np.std(measured[:, 0])), float(np.std(measured[:, 1]))) >= limits.min_angular_acceleration:
        own = _agreement(measured, squares, rows)
        _require_order(own, measured, squares, rows, limits)
        if own > limits.min_agreement:
            _require_scale(measured[:, :2], squares @ rows[:2].T / np.array(vehicle.body.inertia[:2]), limits)
    if float(np.std(measured[:, 2])) < limits.min_yaw_acceleration:
        return
    yaw = _correlation(measured[:, 2], squares @ rows[2])
    if yaw < limits.opposite_agreement:
        raise DataError(
            "the rotors yaw the vehicle in the direction opposite to the vehicle file's (agreement "
            f"{yaw:.2f}). Turn the signs of [rotors] spin, or check that rates are body FLU and rotors in the file's "
            "order."
        )


def _require_order(own: float, measured: Floats, squares: Floats, rows: Floats, limits: DataChecks) -> None:
    count = squares.shape[1]
    if own > limits.min_agreement:
        return
    disagree = f"the rotors do not turn the vehicle as the vehicle file has it (agreement {own:.2f})"
    if count <= limits.max_permuted_rotors:
        permutations = list(itertools.permutations(range(count)))
        fits = [_agreement(measured, squares[:, list(order)], rows) for order in permutations]
        best, second = np.argsort(fits)[::-1][:2].tolist()
        apart = fits[best] - fits[second] > limits.agreement_margin
        if fits[best] > limits.clear_agreement or (fits[best] > limits.best_agreement and apart):
            raise DataError(
                f"{disagree}. They do in another order: the log's columns {list(permutations[best])} are the file's "
                f"rotors {list(range(count))} (agreement {fits[best]:.2f}). Reorder [rotors] position and spin, or "
                "the log's columns."
            )
    if own < limits.opposite_agreement or _explained(measured[:, :2], squares) > limits.min_explained:
        few = count <= limits.max_permuted_rotors
        tried = "no other order of them fits" if few else "their orders are too many to try"
        raise DataError(
            f"{disagree}, and {tried}. Check their order and [rotors] position (body FLU: x forward, y left), and that "
            "rates are body FLU."
        )


def _require_scale(measured: Floats, modelled: Floats, limits: DataChecks) -> None:
    """measured, modelled: (m, 2) angular acceleration about x and y, rad/s^2."""
    size = np.std(modelled, axis=0)
    slope = float(np.median(np.sqrt(np.var(measured, axis=0)) / size))
    low, high = limits.angular_ratio
    if low <= slope <= high:
        return
    hint = "Check inertia (kg m^2) and [rotors] position (m)."
    if 0.4 * DEGREES < slope < 2.5 * DEGREES:
        hint = "That is degrees for radians: convert the log's rates to rad/s, or give a mapping with unit = 'deg/s'."
    raise DataError(
        f"with this vehicle file the vehicle turns {slope:.3g} times as fast as its rotors push; wanted "
        f"{low:g} to {high:g}. {hint}"
    )


def _rotation_and_rotors(segments: Sequence[Segment], vehicle: Vehicle, limits: DataChecks) -> tuple[Floats, Floats]:
    """(m, 3) angular acceleration and (m, rotors) squared speeds, with the lag behind commands that fits best."""
    commanded = segments[0].rotor_source != "measured"
    measured = np.vstack([s.low_pass(difference(s.body_rate, s.rate))[s.decimated] for s in segments])
    responses = []
    for response in limits.response_times if commanded else (0.0,):
        late = [replace(s, rotor_speed=lagged(s.rotor_speed, s.rate, response)) for s in segments]
        responses.append(np.vstack([s.low_pass(s.rotor_speed**2)[s.decimated] for s in late]))
    explained = [_explained(measured[:, :2], squares) for squares in responses]
    return measured, responses[int(np.argmax(explained))]


def _explained(measured: Floats, squares: Floats) -> float:
    """Share of the angular acceleration that any mixture of the rotors explains, whatever their order."""
    columns = np.column_stack([squares, np.ones(len(squares))])
    residual = measured - columns @ np.linalg.lstsq(columns, measured, rcond=None)[0]
    return 1.0 - float(np.sum(residual**2) / max(float(np.sum(measured**2)), 1e-30))


def _agreement(measured: Floats, squares: Floats, rows: Floats) -> float:
    """The lesser correlation of roll and pitch."""
    modelled = squares @ rows.T
    return min(_correlation(measured[:, i], modelled[:, i]) for i in range(2))


def _correlation(one: Floats, other: Floats) -> float:
    return float(np.corrcoef(one, other)[0, 1])
