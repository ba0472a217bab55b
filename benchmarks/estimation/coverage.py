"""Do intervals of 95 % hold? Hidden effects are fitted as a known set, without a search. Writes interval_coverage.md.

Random vehicles of the outside simulator, which shares no line with `dynamics`, fly eight random paths each and hide one
effect, or five to nine at once (`several`), of random size. Every seed is another vehicle, other flights and other
sensor noise. z is the estimate less the truth over the standard deviation that the fit gives: its mean is the bias, its
spread is 1 where intervals are right, and |z| < 1.96 is held. Calibrate on seeds below 1000, report others.

    python -m benchmarks estimation coverage --first 1001 --count 40 --kept build/intervals.jsonl
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.measurement import Page, keep, kept_results, options_of, paragraph_of
from diagnosis.data.dataset import make_dataset, read_dataset
from diagnosis.data.segment import Segment, segments
from diagnosis.estimation.equation_error import fit
from diagnosis.estimation.pursuit import about_values
from diagnosis.selection.candidates import Candidate
from diagnosis.selection.gust import gust_beside
from diagnosis.selection.regression import Regression
from diagnosis.selection.regression_of_flights import about_fit, make_regression
from diagnosis.selection.search import Search
from diagnosis.thresholds import DEFAULT, Thresholds
from dynamics.effects import CATALOGUE
from dynamics.errors import AlulaError
from dynamics.vehicle import Vehicle
from fixtures.outside_cases import (
    AIR,
    BY_COMMAND,
    Campaign,
    captured_flights,
    flown,
    milder,
    sized,
    vehicle_of,
    write_campaign,
)
from fixtures.outside_effects import CATALOGUED, OF_SENSORS, Hidden
from fixtures.outside_sensors import Recorder
from fixtures.outside_simulator import Truth

SENSORS = ("imu_bias", "gyro_bias", "time_delay")  # which every fit holds as healthy sensors' errors
FROM_SPEEDS = tuple(n for n in (*CATALOGUED, *OF_SENSORS) if n not in BY_COMMAND)
FROM_COMMANDS = (*BY_COMMAND, "linear_drag", "inertia", "parasitic_drag", "weak_rotor")
FROM_ESTIMATOR = ("linear_drag", "inertia", "rotational_damping", "motor_lag")
SEVERAL = (  # at most one of each group at once: within a group no data can tell two apart
    ("linear_drag", "rotor_drag"), ("parasitic_drag",), ("rotational_damping",), ("translational_lift",),
    ("axial_inflow",), ("blade_flapping",), ("rotor_gyroscopic",), ("thrust_constant", "mass"),
    ("torque_constant", "inertia"), ("weak_rotor", "centre_of_mass"), ("rotor_cant",), ("ground_effect",),
)  # fmt: skip
GUSTS = ("gust", "gust beside three")
BESIDE_GUST = ("blade_flapping", "inertia", "translational_lift")
CASES = (
    *(("speeds", n) for n in FROM_SPEEDS), ("speeds", "several"), ("speeds", "gust beside three"),
    *(("commands", n) for n in FROM_COMMANDS), *(("estimator", n) for n in FROM_ESTIMATOR),
)  # fmt: skip
MAX_TRIES, FLIGHTS, TOGETHER = 3, 8, 41
LEVEL = 1.96
Row = Mapping[str, Any]


@dataclass(frozen=True)
class Case:
    """Hidden effect, logged quantities ("speeds", "commands" or "estimator"), and a seed."""

    logged: str
    name: str
    seed: int

    @property
    def key(self) -> str:
        """Unique name."""
        return f"{self.logged}-{self.name}-{self.seed}"

    def campaign(self) -> Campaign:
        """Flights of the case."""
        random = np.random.default_rng([*self.key.encode()])
        commands = self.logged != "speeds"
        rate, pose = (250.0, "estimator") if self.logged == "estimator" else (100.0, "motion_capture")
        noise = float(np.exp(random.uniform(np.log(0.5), np.log(2.0)))) if self.logged != "estimator" else 1.0
        recorder = Recorder(rate, commands, pose, noise)
        number, fast = int(random.integers(2**31)), bool(random.random() < 0.35)
        lag_declared = commands and self.name != "motor_lag"
        made = Campaign({}, {}, recorder, lag_declared, fast, FLIGHTS, number)
        hidden = {n: sized(n, made.frame, random) for n in self._names(random)}
        declared: Hidden = {}
        if set(AIR) & set(hidden):
            declared = {"rotor_drag": sized("rotor_drag", made.frame, random)}
        return replace(made, hidden=hidden, declared=declared)

    def _names(self, random: np.random.Generator) -> Sequence[str]:
        if self.name == "gust beside three":
            return (*BESIDE_GUST, "gust")
        if self.name != "several":
            return (self.name,)
        groups = [SEVERAL[i] for i in random.permutation(len(SEVERAL))[: int(random.integers(5, 10))]]
        return [str(random.choice(group)) for group in groups]


def read(
    campaign: Campaign, truths: Sequence[Truth], thresholds: Thresholds = DEFAULT
) -> tuple[Vehicle, Sequence[Segment], Sequence[int]]:
    """Vehicle, segments to fit and the flight of each."""
    vehicle = vehicle_of(campaign)
    if campaign.recorder.pose == "estimator":
        with tempfile.TemporaryDirectory() as place:
            write_campaign(campaign, truths, Path(place))
            data = read_dataset(sorted(map(str, Path(place).glob("*.ulg"))), vehicle, thresholds=thresholds)
    elif campaign.recorder.commands:
        data = make_dataset(captured_flights(campaign, truths), vehicle, thresholds=thresholds)
    else:  # nothing is held out of what this table is made from
        parts = [segments(flight, vehicle, thresholds) for flight in captured_flights(campaign, truths)]
        return vehicle, [s for part in parts for s in part], [i for i, part in enumerate(parts) for _ in part]
    return vehicle, data.fitted, data.flight_of


def fitted_rows(case: Case, campaign: Campaign, truths: Sequence[Truth], thresholds: Thresholds = DEFAULT) -> list[Row]:
    """A row for each parameter of the known set."""
    vehicle, flown_segments, flight_of = read(campaign, truths, thresholds)
    truth = {_named(name): _as_named(name, values) for name, values in campaign.hidden.items()}
    catalogue = {n: CATALOGUE[n] for n in dict.fromkeys((*truth, *SENSORS, *(("wind",) if "gust" in truth else ())))}
    catalogue |= {use.name: CATALOGUE[use.name] for use in vehicle.effects}
    regression = make_regression(vehicle, catalogue, flown_segments, flight_of, thresholds)
    chosen = known_set(regression, truth)
    rows: list[Row] = []
    if chosen:
        estimate = fit(regression, chosen)
        for (key, name), e in estimate.estimates.items():
            effect = key.split("[")[0]
            true = truth[effect].get(name, _neutral(effect, name))
            rows.append(_row(case, campaign, effect, name, true, e.value, e.std))
    if "gust" in truth:
        if chosen:
            held = about_values(regression.candidates, chosen, estimate.values)
            regression = about_fit(regression, held, regression.nuisances) or regression
        rows.append(_gust_row(case, campaign, regression, chosen, truth["gust"]["intensity"]))
    return rows


def known_set(regression: Regression, truth: Mapping[str, Mapping[str, float]]) -> list[Candidate]:
    """The hidden effects, each at the point of its grid that scores most beside the others."""
    families = {
        name: [
            c for c in regression.candidates
            if c.effect.name == name and (c.rotor is None or c.rotor == int(values["rotor"]))
        ]
        for name, values in truth.items() if name != "gust"
    }  # fmt: skip
    search, best = Search(regression), {name: family[0] for name, family in families.items()}
    for _ in range(2 if len(families) > 1 else 1):
        for name, family in families.items():
            others = [c for other, c in best.items() if other != name]
            best[name] = max(family, key=lambda c: search.score([*others, c]).score)
    return list(best.values())


def _gust_row(
    case: Case, campaign: Campaign, regression: Regression, chosen: Sequence[Candidate], intensity: float
) -> Row:
    gust = gust_beside(regression, [i for c in chosen for i in c.columns])
    return _row(case, campaign, "gust", "intensity", intensity, gust.intensity, gust.std)


def _row(case: Case, campaign: Campaign, effect: str, name: str, true: float, value: float, std: float) -> Row:
    return {
        "key": case.key, "logged": case.logged, "set": case.name, "seed": case.seed, "effect": effect,
        "parameter": name, "true": true, "value": value, "std": std, "fast": campaign.fast,
        "noise": campaign.recorder.noise,
    }  # fmt: skip


def _named(name: str) -> str:
    return "weak_rotor" if name == "lost_propeller" else name


def _as_named(name: str, values: Mapping[str, float]) -> dict[str, float]:
    """Parameters as our catalogue has them."""
    return {**values, "torque_loss": values["loss"]} if name == "lost_propeller" else dict(values)


def _neutral(effect: str, name: str) -> float:
    return next(p.neutral for p in CATALOGUE[effect].parameters if p.name == name)


def measured(cases: Sequence[Case]) -> Iterator[tuple[Case, list[Row]]]:
    """Rows of each case, flown side by side; the reason where a vehicle was lost or its logs were refused."""
    waiting = [(case, case.campaign()) for case in cases]
    for _ in range(MAX_TRIES):
        again, results = [], flown([campaign for _, campaign in waiting]) if waiting else []
        for (case, campaign), truths in zip(waiting, results, strict=True):
            if truths is None:
                again.append((case, milder(campaign)))
                continue
            try:
                yield case, fitted_rows(case, campaign, truths)
            except AlulaError as error:
                yield case, [{"key": case.key, "refused": str(error)}]
        waiting = again
    for case, _ in waiting:
        yield case, [{"key": case.key, "refused": "lost its path"}]


def table(rows: Sequence[Row]) -> str:
    """A line for each parameter of each set of logs, and all of them at the end."""
    groups: dict[tuple[str, str, str], list[Row]] = {}
    for row in rows:
        if "refused" not in row:
            alone = row["set"] if row["set"] in ("several", "gust beside three") else "alone"
            groups.setdefault((row["logged"], alone, f"{row['effect']} {row['parameter']}"), []).append(row)
    head = "| logged | hidden | parameter | fits | held, % | mean z | spread of z | median error, % | within 5 %, % |"
    lines = [head, "|" + " --- |" * 9]
    lines += [_line(key, group) for key, group in sorted(groups.items())]
    everything = [row for group in groups.values() for row in group]
    return "\n".join([*lines, _line(("all", "", ""), everything)])


def _line(key: Sequence[str], rows: Sequence[Row]) -> str:
    off = np.array([row["value"] - row["true"] for row in rows])
    z = off / np.maximum([row["std"] for row in rows], 1e-300)
    true = np.abs([row["true"] for row in rows])
    relative = np.abs(off[true > 0]) / true[true > 0] if np.any(true > 0) else np.array([np.nan])
    low, high = np.quantile(z, [0.16, 0.84])
    cells = [
        *key, len(rows), f"{100 * np.mean(np.abs(z) <= LEVEL):.0f}", f"{np.mean(z):+.2f}", f"{(high - low) / 2:.2f}",
        f"{100 * np.median(relative):.2g}", f"{100 * np.mean(relative <= 0.05):.0f}",
    ]  # fmt: skip
    return "| " + " | ".join(map(str, cells)) + " |"


def coverage(words: Sequence[str]) -> Page:
    """The measurement's page."""
    parser = options_of(__doc__, resumes="intervals", first=1001, count=40)
    parser.add_argument("--logged", nargs="*", default=[])
    parser.add_argument("--names", nargs="*", default=[])
    parser.add_argument("--budget", type=float, default=1e9, help="s after which none is flown; 0: a table alone")
    options = parser.parse_args(words)
    rows = kept_results(options.kept)
    done, began = {row["key"] for row in rows}, time.monotonic()
    cases = [
        Case(logged, name, seed)
        for seed in range(options.first, options.first + options.count)
        for logged, name in CASES
        if (not options.names or name in options.names) and (not options.logged or logged in options.logged)
    ][: options.cases]
    todo = [case for case in cases if case.key not in done]
    for start in range(0, len(todo), TOGETHER):
        if time.monotonic() - began > options.budget:
            break
        for case, made in measured(todo[start : start + TOGETHER]):
            rows += made
            keep(options.kept, *made, line=f"{time.monotonic() - began:5.0f} s  {case.key}")
    keys = {case.key for case in cases}
    text = table([row for row in rows if row["key"] in keys])
    return Page("interval_coverage", "Do intervals hold?", f"{paragraph_of(__doc__)}\n\n{text}")
