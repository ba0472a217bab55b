"""How the rotors share the load in hover, against normal flights of the same vehicle.

It needs nothing but the rotors' commands and a way to see hover, so it answers where a log is too poor for the rest.
A rotor that has to work harder than in the vehicle's normal flights is weak or carries more: which of both, mean
commands cannot say. Batteries and propellers are put on anew before each flight, so it is the spread between normal
flights that decides what is unusual. With few of them it is known badly: usual spreads of small multirotors stand in
as a prior, and Student's t makes up for the rest.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import msgspec
import numpy as np
from numpy.typing import NDArray
from scipy import ndimage, stats

from diagnosis.data.filters import difference, low_pass
from diagnosis.report import FoundEffect, ParameterValue, Verdict
from dynamics.arrays import Floats
from dynamics.effects.weak_rotor import EFFECT as WEAK_ROTOR
from dynamics.errors import DataError, RequestError
from dynamics.vehicle import Vehicle
from flights import Flight
from flights.exclusion import excluded_rows, find_exclusions
from flights.rotors import QUANTITIES

MIN_HOVER = 4.0  # s
MIN_SPELL = 0.5  # s of hover that count
MIN_ROTORS = 5.0  # Hz; means need no more
HOVER_SPEED, HOVER_RATE = 0.3, 0.5  # m/s, rad/s
USUAL_SPREAD, WORTH = 0.02, 20  # of a rotor's share between normal flights (CrazyPAD, two vehicles); degrees of freedom
FALSE_ALARMS = 0.05  # of normal flights, over all rotors, by Student's t alone
CLEAR_OF_ALL = 1.0  # spreads by which a rotor must also lie above the normal flight in which it worked hardest


class RotorShare(msgspec.Struct, frozen=True):
    """A rotor's share of the commands in hover, 1 for the mean rotor. limit: share that is still usual."""

    rotor: int
    normal: float
    now: float
    limit: float


class TrimComparison(msgspec.Struct, frozen=True):
    """What `alula diagnose --normal --json` writes.

    spread: standard deviation of a rotor's share between normal flights, with the prior. centre_of_mass_moved: forward
    and to the left, m, if nothing but that explains the shares.
    """

    verdict: Verdict
    effects: tuple[FoundEffect, ...]
    rotors: tuple[RotorShare, ...]
    normal_flights: int
    spread: float
    centre_of_mass_moved: tuple[float, float]
    next_flight: str
    notes: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class HoverShares:
    """(rotors,) means over a flight's hover, 1 for the mean rotor. seconds: of hover. quantity: what was shared."""

    flight: str
    shares: Floats
    seconds: float
    quantity: str


def hover_shares(flight: Flight, vehicle: Vehicle) -> HoverShares:
    """How the rotors share the load while a flight hovers.

    Raises DataError for a flight without rotors' commands or speeds, or with too little hover.
    """
    name = flight.provenance.path
    quantity = next((q for q in (*QUANTITIES[1:], QUANTITIES[0]) if flight.has(q) and _rate(flight, q)), None)
    if quantity is None:
        raise DataError(
            f"{name} has {', '.join(flight.quantities)}. Wanted motor commands or rotor speeds of each rotor; log them."
        )
    if flight[quantity].shape[1] != vehicle.rotors.count:
        raise DataError(f"{name} has {flight[quantity].shape[1]} rotors, the vehicle file {vehicle.rotors.count}.")
    power = 2.0 if "speed" in quantity else 1.0  # speeds act by their squares
    effort = np.maximum(flight[quantity], 0.0) ** power
    rows = _hovering(flight) & np.isfinite(effort).all(axis=1)
    seconds = float(np.count_nonzero(rows)) * flight.period
    if seconds < MIN_HOVER:
        raise DataError(f"{name} holds {seconds:.1f} s of hover. Wanted {MIN_HOVER:.0f} s or more; hover longer.")
    mean = effort[rows].mean(axis=0)
    return HoverShares(name, mean / mean.mean(), seconds, quantity)


def compare_trim(flights: Sequence[Flight], normal: Sequence[Flight], vehicle: Vehicle) -> TrimComparison:
    """Whether a rotor works harder in flights than in normal flights of the same vehicle.

    Raises RequestError for a flight that is given as both, DataError for flights that do not hover.
    """
    hashes = {f.provenance.sha256 for f in normal if f.provenance.sha256}
    both = [f.provenance.path for f in flights if f.provenance.sha256 in hashes]
    if both:
        raise RequestError(f"{', '.join(both)} is given as a normal flight too. Give other flights as normal ones.")
    now, usual = ([hover_shares(f, vehicle) for f in group] for group in (flights, normal))
    if len({s.quantity for s in (*now, *usual)}) > 1:
        raise DataError(
            f"the flights tell different things of their rotors: {', '.join(sorted({s.quantity for s in now + usual}))}"
            ". Give flights that were logged alike."
        )
    return judge_shares(np.array([s.shares for s in now]), np.array([s.shares for s in usual]), vehicle)


def judge_shares(now: Floats, usual: Floats, vehicle: Vehicle) -> TrimComparison:
    """The verdict on shares (flights, rotors) in hover against those of normal flights."""
    spread, freedom = _spread(usual)
    before, after, count = usual.mean(axis=0), now.mean(axis=0), vehicle.rotors.count
    error = spread * float(np.sqrt(1 / len(now) + 1 / len(usual)))
    improbable = before + float(stats.t.ppf(1 - FALSE_ALARMS / count, freedom)) * error
    limit = np.maximum(improbable, usual.max(axis=0) + CLEAR_OF_ALL * spread)
    change = after - before
    rotor = int(np.argmax(after - limit))
    effects: tuple[FoundEffect, ...] = ()
    if after[rotor] > limit[rotor]:
        chance = min(1.0, count * float(stats.t.sf(change[rotor] / error, freedom)))
        effects = (_weak(rotor, before, after, error, 1.0 - chance),)
    moved = np.array(vehicle.rotors.position)[:, :2].T @ change / count
    table = np.round(np.column_stack([before, after, limit]), 4).tolist()
    return TrimComparison(
        verdict="ambiguous" if effects else "explained",
        effects=effects,
        rotors=tuple(RotorShare(i, normal, shown, most) for i, (normal, shown, most) in enumerate(table)),
        normal_flights=len(usual),
        spread=round(spread, 4),
        centre_of_mass_moved=(float(moved[0]), float(moved[1])),
        next_flight=_next_flight(effects, len(usual)),
        notes=_notes(len(usual)),
    )


def trim_sentence(comparison: TrimComparison) -> str:
    """The verdict in one sentence."""
    count = comparison.normal_flights
    against = f"{count} normal flight{'s' if count > 1 else ''} of this vehicle"
    if not comparison.effects:
        return f"No rotor works harder in hover than the spread between flights allows, against {against}."
    effect = comparison.effects[0]
    loss, (x, y) = effect.parameters["loss"], comparison.centre_of_mass_moved
    return (
        f"Rotor {effect.rotor} works harder in hover than in {against}: weak_rotor of rotor {effect.rotor} (loss = "
        f"{loss.value:.2f} ± {1.96 * loss.std:.2f}), or centre_of_mass (moved by {1e3 * x:.1f} mm forward and "
        f"{1e3 * y:.1f} mm to the left); mean commands cannot tell them apart."
    )


def read_trim(logs: Sequence[Path], normal: Sequence[Path], vehicle: Vehicle, mapping: Path | None) -> TrimComparison:
    """Compare logs with logs of normal flights. Raises RequestError and DataError as `compare_trim` and reading do."""
    flights, usual = ([Flight.read(path, mapping=mapping) for path in group] for group in (logs, normal))
    return compare_trim(flights, usual, vehicle)


def _rate(flight: Flight, quantity: str) -> bool:
    origin = flight.origins.get(quantity)
    return origin is None or origin.rate >= MIN_ROTORS


def _hovering(flight: Flight) -> NDArray[np.bool_]:
    """(n,) rows of free flight in which the vehicle stands still in the air, in spells that last."""
    rows = flight.usable() & ~excluded_rows(flight, find_exclusions(flight))
    if flight.has("velocity"):
        rows &= _smooth_norm(flight["velocity"], flight.rate) < HOVER_SPEED
    elif flight.has("position"):
        rows &= _smooth_norm(difference(np.nan_to_num(flight["position"]), flight.rate), flight.rate) < HOVER_SPEED
    if flight.has("rate"):
        rows &= _smooth_norm(flight["rate"], flight.rate) < HOVER_RATE
    least = max(1, round(MIN_SPELL * flight.rate))
    return np.asarray(ndimage.binary_opening(rows, structure=np.ones(least)))


def _smooth_norm(values: Floats, rate: float) -> Floats:
    """(n,) length of what varies below 1 Hz, so that noise is no motion. values: (n, 3)."""
    known = np.nan_to_num(values)
    smooth = low_pass(known, rate, 1.0, 2) if rate > MIN_ROTORS and len(known) > rate else known
    return np.asarray(np.linalg.norm(smooth, axis=1))


def _spread(shares: Floats) -> tuple[float, float]:
    """Standard deviation of a rotor's share between flights and its degrees of freedom. shares: (flights, rotors)."""
    flights, rotors = shares.shape
    freedom = (flights - 1) * (rotors - 1)  # the shares of a flight have one mean
    squares = float(np.sum((shares - shares.mean(axis=0)) ** 2)) * (rotors - 1) / rotors
    return float(np.sqrt((WORTH * USUAL_SPREAD**2 + squares) / (WORTH + freedom))), float(WORTH + freedom)


def _weak(rotor: int, before: Floats, after: Floats, error: float, confidence: float) -> FoundEffect:
    """The weak rotor that would explain the change: with the loss l it needs 1 / (1 - l) of its usual command."""
    was, now = (x[rotor] / np.delete(x, rotor).mean() for x in (before, after))
    loss = float(1 - was / now)
    deviation = float(error * (1 - loss) / after[rotor])
    parameters = {"loss": ParameterValue(round(loss, 4), round(deviation, 4), "1")}
    return FoundEffect(WEAK_ROTOR.name, rotor, parameters, round(confidence, 4), WEAK_ROTOR.confounded_with)


def _next_flight(effects: Sequence[FoundEffect], normal: int) -> str:
    if effects:
        rotor = effects[0].rotor
        return (
            f"to tell weak_rotor from centre_of_mass: exchange rotor {rotor}'s propeller for that of another rotor of "
            "the same turning direction and hover again: a weak propeller takes the change along, a load does not"
        )
    more = " and more normal flights, which make smaller changes visible" if normal < 5 else ""
    return f"half a minute of hover after the next repair{more}"


def _notes(normal: int) -> tuple[str, ...]:
    if normal >= 3:
        return ()
    return (
        f"{normal} normal flight{'s' if normal > 1 else ''} only: what is usual rests on other vehicles' spread of "
        f"{USUAL_SPREAD:g}; five or more of this vehicle would say it better",
    )
