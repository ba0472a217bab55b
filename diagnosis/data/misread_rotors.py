"""Rotors whose measured speed is misread, by the vehicle's weight and its moments.

The thrust carries the weight and the moments turn the vehicle, whatever the sensors say: each rotor's squared speed
over its reading's square follows from both by least squares. Rotors are not compared with each other, so that two of
four may be wrong.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import scipy

from diagnosis.data.filters import difference
from diagnosis.data.rotor_moments import compared_moments
from diagnosis.data.segment import Segment
from diagnosis.thresholds import DEFAULT, RotorMomentChecks
from dynamics.arrays import Floats
from dynamics.rotor_places import rotor_names
from dynamics.vehicle import GRAVITY, Vehicle
from flights.quality.rotor_balance import FAR_OFF


def specific_thrust(segment: Segment) -> Floats:
    """(n,) specific force along body z that the motion has, m/s^2."""
    if segment.specific_force is not None:
        return np.asarray(segment.specific_force[:, 2])
    world = segment.low_pass(difference(segment.velocity, segment.rate)) + np.array([0, 0, GRAVITY])
    return np.asarray(np.einsum("nj,nj->n", segment.to_world[:, :, 2], world))


def reading_shares(
    segments: Sequence[Segment], vehicle: Vehicle, limits: RotorMomentChecks = DEFAULT.rotor_moments
) -> Floats | None:
    """(k,) each rotor's read speed over that which weight and moments need; None where the rotation tells too little.

    Moments count by their changes: their mean is a load's off the centre as well.
    """
    if not segments:
        return None
    moments = compared_moments(segments, vehicle, limits)
    if moments.explained < limits.min_explained:
        return None
    allocation, mass = vehicle.rotors.allocation, vehicle.body.mass
    arm = float(np.mean(np.abs(allocation[1:3]))) / float(np.mean(allocation[0]))
    rows = [moments.squares * moments.rows[axis] / (mass * GRAVITY * arm) for axis in moments.axes]
    inertia = vehicle.body.inertia
    targets = [moments.acceleration[:, axis] * inertia[axis] / (mass * GRAVITY * arm) for axis in moments.axes]
    for segment in segments:
        squares = segment.low_pass(segment.rotor_speed**2)[segment.decimated]
        force = segment.low_pass(specific_thrust(segment))[segment.decimated]
        valid = np.isfinite(force) & np.isfinite(squares).all(axis=1)
        rows.append((squares * allocation[0])[valid] / (mass * GRAVITY))
        targets.append(force[valid] / GRAVITY)
    matrix = np.vstack(rows)
    size = np.maximum(np.linalg.norm(matrix, axis=0), 1e-30)
    gains = scipy.optimize.nnls(matrix / size, np.concatenate(targets))[0] / size
    return np.asarray(1 / np.sqrt(gains)) if (gains > 0).all() else None


def misread_rotors(shares: Floats) -> list[int]:
    """Rotors that read another speed than weight and moments need, where others read it. shares: (k,)."""
    wrong = [index for index, share in enumerate(shares.tolist()) if not FAR_OFF < share < 1 / FAR_OFF]
    return wrong if len(wrong) < len(shares) else []


def misread_text(shares: Floats, wrong: Sequence[int], vehicle: Vehicle) -> str:
    """The rotors that are misread with their shares, and those that are not. shares: (k,)."""
    names, right = rotor_names(vehicle), [index for index in range(len(shares)) if index not in wrong]
    verb = "reads" if len(wrong) == 1 else "read"
    listed = " and ".join(names[index] for index in wrong)
    values = " and ".join(f"{shares[index]:.2f}" for index in wrong)
    others = ", ".join(f"{shares[index]:.2f}" for index in right)
    return f"{listed} {verb} {values} times the speed that weight and moments need, the others {others} times"
