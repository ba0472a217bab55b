"""How the rotors share the load in hover, compared with normal flights of the same vehicle.

It needs only the rotors' commands and a measure of hover, and so works on logs that are too poor for the rest. A rotor
with a larger command than in the vehicle's normal flights is weak or carries more: mean commands do not distinguish
these. Batteries and propellers are mounted again before each flight, so the spread between normal flights decides what
is unusual. With few of them it is uncertain: the prior is the usual spread of small multirotors, and the quantile is
that of Student's t.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import msgspec
import numpy as np
import scipy
from numpy.typing import NDArray

from diagnosis.data.filters import difference
from diagnosis.report import MissingEffect, ParameterValue, Verdict
from diagnosis.thresholds import DEFAULT, HoverTrimThresholds
from dynamics.arrays import Floats
from dynamics.effects import CATALOGUE
from dynamics.effects.weak_rotor import EFFECT as WEAK_ROTOR
from dynamics.errors import DataError, RequestError
from dynamics.rotor_places import rotor_names
from dynamics.vehicle import Vehicle
from flights import Flight
from flights.exclusion import excluded_rows, find_exclusions
from flights.filters import zero_phase
from flights.rotors import QUANTITIES, instead_of_missing


class RotorShare(msgspec.Struct, frozen=True):
    """A rotor's share of the commands in hover, 1 for the mean rotor.

    name: with its place and the autopilots' numbers, for people.
    normal, now: mean over the normal flights and over the others.
    limit: share above which the rotor is flagged.
    """

    rotor: int
    name: str
    normal: float
    now: float
    limit: float


class TrimComparison(msgspec.Struct, frozen=True):
    """Document that `alula diagnose --normal --json` writes.

    verdict: "ambiguous" where a rotor works harder, else "explained".
    effects: a weak rotor, ambiguous with the centre of mass.
    rotors: their shares.
    normal_flights: how many.
    spread: standard deviation of a rotor's share between normal flights, with the prior.
    centre_of_mass_moved: forward and to the left, m, if nothing but that explains the shares.
    next_flight: the manoeuvre that separates the two.
    notes: to the user.
    """

    verdict: Verdict
    effects: tuple[MissingEffect, ...]
    rotors: tuple[RotorShare, ...]
    normal_flights: int
    spread: float
    centre_of_mass_moved: tuple[float, float]
    next_flight: str
    notes: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class HoverShares:
    """Rotors' shares in one flight.

    flight: path of its log.
    shares: (rotors,) means over its hover, 1 for the mean rotor.
    seconds: of hover.
    quantity: of which these are shares.
    """

    flight: str
    shares: Floats
    seconds: float
    quantity: str


def hover_shares(flight: Flight, vehicle: Vehicle, thresholds: HoverTrimThresholds = DEFAULT.hover_trim) -> HoverShares:
    """How the rotors share the load while a flight hovers.

    Raises DataError for a flight without rotors' commands or speeds, or with too little hover.
    """
    name, usual = flight.provenance.path, (*QUANTITIES[1:], QUANTITIES[0])
    quantity = next((q for q in usual if flight.has(q) and _fast(flight, q, thresholds)), None)
    if quantity is None:
        raise DataError(
            f"{name} has {', '.join(flight.quantities)}. Wanted motor commands or rotor speeds of each rotor; "
            f"{instead_of_missing(flight)}."
        )
    if flight[quantity].shape[1] != vehicle.rotors.count:
        raise DataError(f"{name} has {flight[quantity].shape[1]} rotors, the vehicle file {vehicle.rotors.count}.")
    power = 2.0 if "speed" in quantity else 1.0  # speeds act by their squares
    effort = np.maximum(flight[quantity], 0.0) ** power
    if not flight.has("velocity") and not flight.has("position"):
        raise DataError(
            f"{name} has {', '.join(flight.quantities)}. Wanted velocity or position as well, without which hover "
            "cannot be told from travel; log one of them."
        )
    rows = _hovering(flight, thresholds) & np.isfinite(effort).all(axis=1)
    seconds = float(np.count_nonzero(rows)) * flight.period
    if seconds < thresholds.min_hover:
        raise DataError(
            f"{name} holds {seconds:.1f} s of hover. Wanted {thresholds.min_hover:.0f} s or more; hover longer."
        )
    mean = effort[rows].mean(axis=0)
    return HoverShares(name, mean / mean.mean(), seconds, quantity)


def compare_trim(
    flights: Sequence[Flight],
    normal: Sequence[Flight],
    vehicle: Vehicle,
    thresholds: HoverTrimThresholds = DEFAULT.hover_trim,
) -> TrimComparison:
    """Whether a rotor works harder in flights than in normal flights of the same vehicle.

    Raises RequestError for a flight that is in both groups, DataError for flights that do not hover.
    """
    hashes = {f.provenance.sha256 for f in normal if f.provenance.sha256}
    both = [f.provenance.path for f in flights if f.provenance.sha256 in hashes]
    if both:
        raise RequestError(f"{', '.join(both)} is among the normal flights too. Give other flights as normal ones.")
    now, usual = ([hover_shares(f, vehicle, thresholds) for f in group] for group in (flights, normal))
    if len({s.quantity for s in (*now, *usual)}) > 1:
        raise DataError(
            f"the flights hold different quantities of their rotors: "
            f"{', '.join(sorted({s.quantity for s in now + usual}))}. Give flights that were logged alike."
        )
    shares_now, shares_usual = (np.array([s.shares for s in group]) for group in (now, usual))
    measured = now[0].quantity == "rotor_speed"
    return judge_shares(shares_now, shares_usual, vehicle, thresholds, measured=measured)


def judge_shares(
    now: Floats,
    usual: Floats,
    vehicle: Vehicle,
    thresholds: HoverTrimThresholds = DEFAULT.hover_trim,
    *,
    measured: bool = False,
) -> TrimComparison:
    """The verdict on shares (flights, rotors) in hover, compared with those of normal flights.

    measured: whether they are of measured speeds, which a sensor's fault changes too.
    """
    spread, freedom = _spread(usual, thresholds)
    before, after, count = usual.mean(axis=0), now.mean(axis=0), vehicle.rotors.count
    error = spread * float(np.sqrt(1 / len(now) + 1 / len(usual)))
    improbable = before + float(scipy.stats.t.ppf(1 - thresholds.false_alarms / count, freedom)) * error
    limit = np.maximum(improbable, usual.max(axis=0) + thresholds.min_spreads * spread)
    change = after - before
    rotor = int(np.argmax(after - limit))
    effects: tuple[MissingEffect, ...] = ()
    if after[rotor] > limit[rotor]:
        chance = min(1.0, count * float(scipy.stats.t.sf(change[rotor] / error, freedom)))
        effects = (_weak(rotor, before, after, error, 1.0 - chance, measured=measured),)
    moved = np.array(vehicle.rotors.position)[:, :2].T @ change / count
    table, names = np.round(np.column_stack([before, after, limit]), 4).tolist(), rotor_names(vehicle)
    return TrimComparison(
        verdict="ambiguous" if effects else "explained",
        effects=effects,
        rotors=tuple(RotorShare(i, name, *row) for i, (name, row) in enumerate(zip(names, table, strict=True))),
        normal_flights=len(usual),
        spread=round(spread, 4),
        centre_of_mass_moved=(float(moved[0]), float(moved[1])),
        next_flight=_next_flight(effects, names, len(usual), thresholds),
        notes=_notes(len(usual), thresholds),
    )


def trim_sentence(comparison: TrimComparison) -> str:
    """The verdict in one sentence."""
    count = comparison.normal_flights
    against = f"{count} normal flight{'s' if count > 1 else ''} of this vehicle"
    if not comparison.effects:
        return f"No rotor works harder in hover than the spread between flights allows, against {against}."
    effect = comparison.effects[0]
    assert effect.rotor is not None
    rotor = comparison.rotors[effect.rotor].name
    loss, (x, y) = effect.parameters["loss"], comparison.centre_of_mass_moved
    return (
        f"{rotor[0].upper()}{rotor[1:]} works harder in hover than in {against}: weak_rotor of it (loss = "
        f"{loss.value:.2f} ± {1.96 * loss.std:.2f}), or centre_of_mass (moved by {1e3 * x:.1f} mm forward and "
        f"{1e3 * y:.1f} mm to the left); mean commands cannot tell them apart."
    )


def read_trim(
    logs: Sequence[Path],
    normal: Sequence[Path],
    vehicle: Vehicle,
    mapping: Path | None,
    thresholds: HoverTrimThresholds = DEFAULT.hover_trim,
) -> TrimComparison:
    """Compare logs with logs of normal flights. Raises RequestError and DataError as `compare_trim` and reading do."""
    flights, usual = ([Flight.read(path, mapping=mapping) for path in group] for group in (logs, normal))
    return compare_trim(flights, usual, vehicle, thresholds)


def _fast(flight: Flight, quantity: str, thresholds: HoverTrimThresholds) -> bool:
    """Whether a quantity was logged often enough."""
    origin = flight.origins.get(quantity)
    return origin is None or origin.rate >= thresholds.min_rotor_rate


def _hovering(flight: Flight, thresholds: HoverTrimThresholds) -> NDArray[np.bool_]:
    """(n,) rows of free flight in which the vehicle hovers, in segments of the minimum duration or longer."""
    rows = flight.usable() & ~excluded_rows(flight, find_exclusions(flight))
    if flight.has("velocity"):
        rows &= _smooth_norm(flight["velocity"], flight.rate, thresholds) < thresholds.max_speed
    elif flight.has("position"):
        velocity = difference(np.nan_to_num(flight["position"]), flight.rate)
        rows &= _smooth_norm(velocity, flight.rate, thresholds) < thresholds.max_speed
    if flight.has("rate"):
        rows &= _smooth_norm(flight["rate"], flight.rate, thresholds) < thresholds.max_rate
    min_rows = max(1, round(thresholds.min_segment * flight.rate))
    return np.asarray(scipy.ndimage.binary_opening(rows, structure=np.ones(min_rows)))


def _smooth_norm(values: Floats, rate: float, thresholds: HoverTrimThresholds) -> Floats:
    """(n,) norm of the values (n, 3) below the cutoff, so that noise does not count as motion."""
    finite = np.nan_to_num(values)
    if rate > thresholds.min_rotor_rate and len(finite) > rate:
        finite = zero_phase(finite, rate, thresholds.cutoff, 2)
    return np.asarray(np.linalg.norm(finite, axis=1))


def _spread(shares: Floats, thresholds: HoverTrimThresholds) -> tuple[float, float]:
    """Standard deviation of a rotor's share between flights and its degrees of freedom. shares: (flights, rotors)."""
    flights, rotors = shares.shape
    freedom = (flights - 1) * (rotors - 1)  # the shares of a flight have one mean
    squares = float(np.sum((shares - shares.mean(axis=0)) ** 2)) * (rotors - 1) / rotors
    prior, together = thresholds.prior_freedom, thresholds.prior_freedom + freedom
    return float(np.sqrt((prior * thresholds.prior_spread**2 + squares) / together)), float(together)


def _weak(
    rotor: int, before: Floats, after: Floats, error: float, confidence: float, *, measured: bool
) -> MissingEffect:
    """The weak rotor that would explain the change: with a loss l it needs 1 / (1 - l) times its usual command."""
    was, now = (x[rotor] / np.delete(x, rotor).mean() for x in (before, after))
    loss = float(1 - was / now)
    deviation = float(error * (1 - loss) / after[rotor])
    parameters = {"loss": ParameterValue(round(loss, 4), round(deviation, 4), "1")}
    alike = [n for n in WEAK_ROTOR.confounded_with if measured or CATALOGUE[n].acts_on != "rotor_speed_reading"]
    return MissingEffect(WEAK_ROTOR.name, rotor, parameters, round(confidence, 4), tuple(alike))


def _next_flight(
    effects: Sequence[MissingEffect], rotors: Sequence[str], normal: int, thresholds: HoverTrimThresholds
) -> str:
    if effects:
        rotor = effects[0].rotor
        assert rotor is not None
        return (
            f"to tell weak_rotor from centre_of_mass: exchange the propeller of {rotors[rotor]} for that of another "
            "rotor of the same turning direction and hover again: the change follows a weak propeller, but not a load"
        )
    more = " and more normal flights, which make smaller changes visible" if normal < thresholds.enough_flights else ""
    return f"half a minute of hover after the next repair{more}"


def _notes(normal: int, thresholds: HoverTrimThresholds) -> tuple[str, ...]:
    if normal >= thresholds.few_flights:
        return ()
    return (
        f"{normal} normal flight{'s' if normal > 1 else ''} only: what is usual rests on other vehicles' spread of "
        f"{thresholds.prior_spread:g}; five or more of this vehicle give its own",
    )
