"""Summary of a fleet's table: verdicts by vehicle, parameters that drift, flights unlike the others.

Pure functions on flights. Drift: slope by Theil and Sen with its interval (Sen, Estimates of the regression coefficient
based on Kendall's tau, JASA 1968), tested by Kendall's tau, over all tests of the fleet with the false discovery rate
of Benjamini and Hochberg (JRSS B 1995). Outliers: modified z-scores (Iglewicz and Hoaglin, How to detect and handle
outliers, 1993).
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import msgspec
import numpy as np
import scipy

from diagnosis.models.channels import NAMES
from studies.fleet.date import day_of
from studies.fleet.flight import FleetFlight

VERDICTS = ("explained", "effect", "ambiguous", "unknown", "refused", "failed")
Owner = tuple[str, str, str]


@dataclass(frozen=True)
class FleetThresholds:
    """Limits of the summaries.

    min_drift_flights: dated values of a drift [five values in order have a probability of 2 in 120 by chance].
    min_history: values of a vehicle from which one stands out [Iglewicz and Hoaglin's tables begin near it].
    false_discoveries: share of the drifts reported that may be chance [the usual 5 %].
    confidence: of a slope's interval [as all intervals of Alula].
    min_score: modified z-score of an outlier [Iglewicz and Hoaglin's 3.5].
    min_spread: of a channel's logarithm over its floor; a vehicle whose flights agree more closely still has it [5 %:
        how far the floors of flights of one vehicle differ].
    """

    min_drift_flights: int = 5
    min_history: int = 6
    false_discoveries: float = 0.05
    confidence: float = 0.95
    min_score: float = 3.5
    min_spread: float = 0.05


DEFAULT = FleetThresholds()


class VehicleSummary(msgspec.Struct, frozen=True):
    """A vehicle's flights.

    label: its name, with its file or airframe where several have the name.
    verdicts: number of flights by verdict, "refused" and "failed" among them.
    effects: number of flights that name each effect.
    over_floor: median of each channel's error with the present model over its floor.
    first, last: dates; empty without any.
    """

    label: str
    vehicle: str
    vehicle_file: str
    airframe: str
    flights: int
    verdicts: dict[str, int]
    effects: dict[str, int]
    over_floor: dict[str, float]
    first: str
    last: str


class Drift(msgspec.Struct, frozen=True):
    """A quantity of a vehicle over the dates of its flights.

    quantity: a parameter ("rotor_drag coefficient") or a channel over its floor.
    flights: dated values.
    first, last: dates.
    median: of the values, in unit.
    slope, low, high: change a day with its 95 % interval.
    probability: of a correlation with time as large by chance (Kendall's tau).
    is_drift: whether it counts as a drift among all quantities of the fleet.
    """

    vehicle: str
    quantity: str
    unit: str
    flights: int
    first: str
    last: str
    median: float
    slope: float
    low: float
    high: float
    probability: float
    is_drift: bool

    @property
    def change(self) -> float:
        """From the first to the last date, in unit."""
        return self.slope * (day_of(self.last) - day_of(self.first))


class Outlier(msgspec.Struct, frozen=True):
    """A flight unlike the others of its vehicle. value, median: of the quantity. score: modified z-score."""

    log: str
    vehicle: str
    quantity: str
    unit: str
    value: float
    median: float
    score: float


class FleetReport(msgspec.Struct, frozen=True):
    """A fleet's flights and what they show.

    folder: of the logs.
    verdicts: number of flights by verdict; "refused" logs have none, "failed" ones are tried again by the next run.
    copies: logs with the content of another one, left out of everything below.
    drifts: every quantity that has enough dated values, the surest first.
    outliers: the farthest first.
    undated: flights that know their date by the file's time of change alone, left out of drifts.
    flights: every log's line.
    """

    folder: str
    verdicts: dict[str, int]
    vehicles: tuple[VehicleSummary, ...]
    drifts: tuple[Drift, ...]
    outliers: tuple[Outlier, ...]
    copies: dict[str, str]
    undated: int
    flights: tuple[FleetFlight, ...]


@dataclass(frozen=True)
class History:
    """A quantity of one vehicle, flight by flight.

    values: with the flights. stds: of each value, 0 where unknown.
    is_ratio: a positive number whose logarithm is compared.
    """

    owner: Owner
    quantity: str
    unit: str
    flights: tuple[FleetFlight, ...]
    values: tuple[float, ...]
    stds: tuple[float, ...]
    is_ratio: bool


def summarise(folder: str, flights: Sequence[FleetFlight], thresholds: FleetThresholds = DEFAULT) -> FleetReport:
    """The report of a fleet's flights."""
    copies = copies_of(flights)
    distinct = [flight for flight in flights if flight.log not in copies]
    names = labels(distinct)
    series = histories(distinct)
    return FleetReport(
        folder=folder,
        verdicts=verdict_counts(distinct),
        vehicles=vehicle_summaries(distinct, names),
        drifts=drifts(series, names, thresholds),
        outliers=outliers(series, names, thresholds),
        copies=copies,
        undated=sum(flight.status == "diagnosed" and not flight.is_dated for flight in distinct),
        flights=tuple(flights),
    )


def copies_of(flights: Iterable[FleetFlight]) -> dict[str, str]:
    """Logs with the content of an earlier one, and that one."""
    first: dict[str, str] = {}
    return {
        flight.log: original
        for flight in flights
        if flight.sha256 and (original := first.setdefault(flight.sha256, flight.log)) != flight.log
    }


def outcome(flight: FleetFlight) -> str:
    """The verdict, or the status of a flight that has none."""
    return flight.verdict or flight.status


def verdict_counts(flights: Iterable[FleetFlight]) -> dict[str, int]:
    """Number of flights by outcome, in the order of `VERDICTS`, without zeros."""
    counts = Counter(map(outcome, flights))
    return {name: counts[name] for name in VERDICTS if counts[name]}


def labels(flights: Iterable[FleetFlight]) -> dict[Owner, str]:
    """A name for each vehicle, with its file and its airframe where the name alone is not enough."""
    owners = sorted({flight.owner for flight in flights if flight.vehicle})
    names: dict[Owner, str] = {}
    for owner in owners:
        same = [other for other in owners if other[0] == owner[0]]
        parts = [
            part for place, part in enumerate(owner) if place and part and len({other[place] for other in same}) > 1
        ]
        names[owner] = f"{owner[0]} ({', '.join(parts)})" if parts else owner[0]
    return names


def vehicle_summaries(flights: Sequence[FleetFlight], names: dict[Owner, str]) -> tuple[VehicleSummary, ...]:
    """A summary of each vehicle, in the order of their labels."""
    summaries = []
    for owner, label in sorted(names.items(), key=lambda pair: pair[1]):
        own = [flight for flight in flights if flight.owner == owner]
        effects = Counter(key for flight in own for key in {effect.key for effect in flight.effects})
        ratios = defaultdict(list)
        for flight in own:
            for kind, channel in flight.channels.items():
                if channel.over_floor is not None:
                    ratios[kind].append(channel.over_floor)
        dates = sorted(flight.date for flight in own if flight.is_dated) or sorted(f.date for f in own if f.date)
        summaries.append(
            VehicleSummary(
                label,
                *owner,
                flights=len(own),
                verdicts=verdict_counts(own),
                effects=dict(effects.most_common()),
                over_floor={kind: float(np.median(values)) for kind, values in ratios.items()},
                first=dates[0] if dates else "",
                last=dates[-1] if dates else "",
            )
        )
    return tuple(summaries)


def histories(flights: Iterable[FleetFlight]) -> list[History]:
    """Every parameter and every channel over its floor of every vehicle, over the flights that have a value."""
    rows: dict[tuple[Owner, str, str, bool], list[tuple[FleetFlight, float, float]]] = defaultdict(list)
    for flight in flights:
        for effect in flight.effects:
            for name, parameter in effect.parameters.items():
                if parameter.std > 0:  # a held value is not measured
                    key = (flight.owner, f"{effect.key} {name}", parameter.unit, False)
                    rows[key].append((flight, parameter.value, parameter.std))
        for kind, channel in flight.channels.items():
            if channel.over_floor:
                key = (flight.owner, f"{NAMES[kind]} over its floor", "1", True)
                rows[key].append((flight, channel.over_floor, 0.0))
    series = []
    for (owner, quantity, unit, is_ratio), values in rows.items():
        own, numbers, stds = zip(*values, strict=True)
        series.append(History(owner, quantity, unit, own, numbers, stds, is_ratio))
    return series


def drifts(
    series: Iterable[History], names: dict[Owner, str], thresholds: FleetThresholds = DEFAULT
) -> tuple[Drift, ...]:
    """The drift of every quantity with enough dated values, the surest first."""
    dated = [one for history in series if (one := _drift(history, names[history.owner], thresholds)) is not None]
    if not dated:
        return ()
    adjusted = scipy.stats.false_discovery_control([one.probability for one in dated])
    judged = [
        msgspec.structs.replace(one, is_drift=bool(value <= thresholds.false_discoveries))
        for one, value in zip(dated, adjusted, strict=True)
    ]
    return tuple(sorted(judged, key=lambda one: (one.probability, one.vehicle, one.quantity)))


def _drift(history: History, label: str, thresholds: FleetThresholds) -> Drift | None:
    """The drift of a quantity; None without enough values or with all of them on one date."""
    dated = [
        (flight.date, value) for flight, value in zip(history.flights, history.values, strict=True) if flight.is_dated
    ]
    dated.sort()
    if len(dated) < thresholds.min_drift_flights or dated[0][0] == dated[-1][0]:
        return None
    days, values = np.array([day_of(date) for date, _ in dated]), np.array([value for _, value in dated])
    if np.ptp(values) == 0.0:
        return None
    slope = scipy.stats.theilslopes(values, days, alpha=thresholds.confidence)
    probability = float(scipy.stats.kendalltau(days, values).pvalue)
    return Drift(
        label,
        history.quantity,
        history.unit,
        len(dated),
        dated[0][0],
        dated[-1][0],
        float(np.median(values)),
        float(slope.slope),
        float(slope.low_slope),
        float(slope.high_slope),
        probability,
        is_drift=False,
    )


def outliers(
    series: Iterable[History], names: dict[Owner, str], thresholds: FleetThresholds = DEFAULT
) -> tuple[Outlier, ...]:
    """Flights whose value of a quantity is unlike those of the vehicle's other flights, the farthest first."""
    outside = []
    for history in series:
        if len(history.values) < thresholds.min_history:
            continue
        median = float(np.median(history.values))
        for flight, value, score in zip(
            history.flights, history.values, modified_scores(history, thresholds.min_spread), strict=True
        ):
            if abs(score) > thresholds.min_score:
                label = names[history.owner]
                outside.append(Outlier(flight.log, label, history.quantity, history.unit, value, median, float(score)))
    return tuple(sorted(outside, key=lambda one: (-abs(one.score), one.log, one.quantity)))


def modified_scores(history: History, min_spread: float) -> list[float]:
    """Distance of each value from the median, over the scaled median absolute deviation and the value's own std."""
    values = np.array(history.values)
    if history.is_ratio:
        values = np.log(values)
    deviation = values - np.median(values)
    spread = 1.4826 * float(np.median(np.abs(deviation)))  # of a normal distribution, its standard deviation
    if history.is_ratio:
        spread = max(spread, min_spread)
    scale = np.hypot(spread, np.array(history.stds))
    return [float(score) for score in deviation / scale]
