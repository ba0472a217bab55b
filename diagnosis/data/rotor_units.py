"""Units of measured rotor speeds, and rotors whose speed is misread, by the vehicle's weight and its moments.

The thrust carries the weight and the moments turn the vehicle, whatever the sensors say: each rotor's squared speed
over its reading's square follows from both by least squares. Rotors are not compared with each other, so that two of
four may be wrong.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy

from diagnosis.data.filters import difference
from diagnosis.data.rotor_moments import compared_moments
from diagnosis.data.segment import Segment
from diagnosis.thresholds import DEFAULT, RotorMomentChecks
from dynamics.arrays import Floats
from dynamics.rotor_places import rotor_names
from dynamics.units import RPM
from dynamics.vehicle import GRAVITY, Vehicle

ALIKE = (0.8, 1.25)  # of the rotors' median share, within which a rotor reads as the others do
_CLOSE = math.log(1.03)  # of a factor to a unit's, that weight and thrust constant tell
_MAX_COST = 2.6  # in units of that: 8 %, where the file's thrust constant errs by a sixth
_CLEAR = 0.7  # in units of that, by which a unit must be likelier than the next to stand alone
_USUAL_PAIRS = (7, 6, 11, 12, 14)  # pole pairs of nearly all motors, the most usual first
_MAX_PAIRS = 24


@dataclass(frozen=True)
class Unit:
    """Meaning that a factor between read and needed speeds may have.

    factor: of the reading over rad/s of the rotor.
    text: for people, with what to do.
    prior: cost of naming it, in units of a deviation of 3 %; 0 for what is usual.
    """

    factor: float
    text: str
    prior: float = 0.0


def _units() -> tuple[Unit, ...]:
    units = [
        Unit(1 / RPM, "they are in rpm; convert them to rad/s, or map them with unit = 'rpm'"),
        Unit(RPM, "they were converted from rpm to rad/s twice, or thrust_constant is per rpm^2; convert once"),
        Unit(1 / (2 * math.pi), "they are in rev/s; multiply by 2 pi"),
    ]
    for pairs in range(2, _MAX_PAIRS + 1):
        prior = 0.0 if pairs == _USUAL_PAIRS[0] else 0.5 if pairs in _USUAL_PAIRS else 1.2
        speeds = f"electrical speeds of motors with {pairs} pole pairs"
        units.append(Unit(pairs, f"they are {speeds}; divide by {pairs}", prior))
        units.append(Unit(pairs / RPM, f"they are {speeds}, in rpm; divide by {pairs} and convert to rad/s", prior))
        if pairs in _USUAL_PAIRS:
            twice = f"they were divided by {pairs} pole pairs twice; multiply by {pairs}"
            units.append(Unit(1 / pairs, twice, prior + 0.5))
            hundreds = f"they are {speeds}, in hundreds of rpm; multiply by 100, divide by {pairs} and convert to rad/s"
            units.append(Unit(pairs / RPM / 100, hundreds, prior + 2.0))
    for power in (1, 2, 3):
        for factor in (10.0**power, 10.0**-power):
            does = "divide" if factor > 1 else "multiply"
            text = f"a factor of {10**power}, which is no unit of speeds; {does} by {10**power} and find its cause"
            units.append(Unit(factor, text, 0.3))
    return tuple(units)


UNITS = _units()


def unit_of(factor: float) -> str:
    """Unit of speeds that read so many times the needed ones, with what to do; a factor where no unit fits."""
    costs = {unit: abs(math.log(factor / unit.factor)) / _CLOSE + unit.prior for unit in UNITS}
    likely = sorted((unit for unit in UNITS if costs[unit] < _MAX_COST), key=lambda unit: costs[unit])
    if not likely:
        return f"a factor of {factor:.3g}, which is no unit of speeds"
    rivals = [unit for unit in likely[1:] if costs[unit] < costs[likely[0]] + _CLEAR]
    return likely[0].text + "".join(f" (or, at {rival.factor:.3g}, {rival.text})" for rival in rivals[:1])


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
    wrong = [index for index, share in enumerate(shares.tolist()) if not ALIKE[0] < share < ALIKE[1]]
    return wrong if len(wrong) < len(shares) else []


def misread_text(shares: Floats, wrong: Sequence[int], vehicle: Vehicle) -> str:
    """The rotors that are misread with their shares, and those that are not. shares: (k,)."""
    names, right = rotor_names(vehicle), [index for index in range(len(shares)) if index not in wrong]
    verb = "reads" if len(wrong) == 1 else "read"
    listed = " and ".join(names[index] for index in wrong)
    values = " and ".join(f"{shares[index]:.2f}" for index in wrong)
    others = ", ".join(f"{shares[index]:.2f}" for index in right)
    return f"{listed} {verb} {values} times the speed that weight and moments need, the others {others} times"
