"""Units in which rotor speeds are written, told by the factor between them and the needed speeds in rad/s."""

from __future__ import annotations

import math
from dataclasses import dataclass

from dynamics.units import RPM

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
