"""Checks of flights and vehicle file before any model is judged: duration, motion, units, rotors, inertia."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from diagnosis.data.filters import difference
from diagnosis.data.misread_rotors import misread_rotors, misread_text, reading_shares, specific_thrust
from diagnosis.data.rotor_moments import require_rotor_moments
from diagnosis.data.segment import Segment
from diagnosis.data.sensor_checks import require_range, require_velocity
from diagnosis.thresholds import DEFAULT, DataChecks, Thresholds
from dynamics.errors import DataError
from dynamics.rotor_places import rotor_names
from dynamics.speed_units import unit_of
from dynamics.vehicle import GRAVITY, Vehicle
from flights.quality.findings import Finding


def require_answerable(
    segments: Sequence[Segment], vehicle: Vehicle, thresholds: Thresholds = DEFAULT
) -> tuple[Finding, ...]:
    """Raise DataError, with what to do, for flights too short or gentle or a vehicle file that cannot be theirs.

    Returns findings about flights that answer in part.
    """
    limits = thresholds.data_checks
    duration = sum(s.duration for s in segments)
    if duration >= thresholds.rotor_moments.min_flight:  # a longer flight would have the same units
        _require_thrust(segments, vehicle, limits)
    if duration < limits.min_duration:
        raise DataError(
            f"{duration:.0f} s of flight are too short to tell effects apart. Fly {limits.min_duration:.0f} s or more."
        )
    _require_motion(segments, limits)
    _require_metres(segments, limits)
    require_velocity(segments, limits)
    require_range(segments, limits)
    _require_live_rotors(segments, vehicle, limits)
    return require_rotor_moments(segments, vehicle, thresholds.rotor_moments)


def _require_motion(segments: Sequence[Segment], limits: DataChecks) -> None:
    body_rate = np.vstack([s.low_pass(s.body_rate) for s in segments])
    rate = float(np.sqrt(np.mean(np.sum(body_rate**2, axis=1))))
    if all("velocity" in s.lacks for s in segments):
        change = float(np.std(np.concatenate([s.low_pass(specific_thrust(s)) for s in segments])))
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
    if 1 / limits.unit_slack < pose / tilt / 1000 < limits.unit_slack:
        hint = "That is millimetres for metres: convert position and velocity, or give a column mapping."
    raise DataError(
        f"by its position and velocity the vehicle accelerates {pose / tilt:.3g} times as much as its tilt gives; "
        f"wanted {low:g} to {high:g}. {hint}"
    )


def _require_live_rotors(segments: Sequence[Segment], vehicle: Vehicle, limits: DataChecks) -> None:
    min_speed, names = limits.min_rotor_speed * vehicle.hover_speed, rotor_names(vehicle)
    for flight in dict.fromkeys(s.flight for s in segments):
        speeds = np.vstack([s.rotor_speed for s in segments if s.flight == flight])
        dead = [names[i] for i, speed in enumerate(np.median(speeds, axis=0)) if speed < min_speed]
        if dead:
            raise DataError(
                f"{flight}: {', '.join(dead)} reads nearly zero speed while the vehicle flies: its "
                "speed sensor is dead (rotor_speed_fault), not the rotor. Repair it, or give a log with the motor "
                "commands instead."
            )


def _require_thrust(segments: Sequence[Segment], vehicle: Vehicle, limits: DataChecks) -> None:
    modelled = np.concatenate([s.rotor_speed**2 @ vehicle.rotors.allocation[0] for s in segments])
    needed = np.concatenate([specific_thrust(s) for s in segments]) * vehicle.body.mass
    ratio = float(np.mean(modelled) / np.mean(needed))
    low, high = limits.thrust_ratio
    if low <= ratio <= high:
        return
    hint = "Check mass, thrust_constant and that the file is this vehicle's."
    if segments[0].rotor_source == "measured" and ratio > 0.0:
        shares = reading_shares(segments, vehicle)
        wrong = [] if shares is None else misread_rotors(shares)
        if shares is not None and wrong:
            raise DataError(
                f"{misread_text(shares, wrong, vehicle)}: their measurement is wrong (rotor_speed_fault). Check their "
                "ESCs' telemetry and pole count, or log the motor commands beside the speeds."
            )
        factor = float(np.sqrt(ratio))
        hint = f"The rotor speeds are {factor:.3g} times what the thrust needs: {unit_of(factor)}. {hint}"
    raise DataError(
        f"with this vehicle file the rotors give {ratio:.3g} times the thrust that the motion needs; wanted "
        f"{low:.1f} to {high:.1f}. {hint}"
    )
