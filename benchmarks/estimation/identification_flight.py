"""Does an identification flight give the intervals that it promises, and half of those of a Lemniscate as long?

One vehicle in lockstep on the mock hides several effects of random size; each seed is other sizes and other sensor
noise. The same vehicle flies the paper's Lemniscate and planned manoeuvres, 60 s each: in the Lemniscate's room, which
limits the speed of both, and on a field, for the hidden effects by name and for the whole catalogue. The hidden
effects are fitted jointly as a given set by the likelihood, from motor commands alone (as PX4 logs them, with the
motors' lag among the unknown) and from measured rotor speeds; intervals are those that a diagnosis states. Ratio: the
standard deviation over that of the Lemniscate's. Promised: the plan's, over that of the flight.

    python -m benchmarks estimation identification_flight --first-seed 5000 --flights 1
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np

from benchmarks.measurement import Page, flown, keep, kept_results, options_of, paragraph_of
from diagnosis.data.dataset import make_dataset
from diagnosis.experiment import PlannedFlight, parse_request, plan_flight
from diagnosis.likelihood.columns import candidates
from diagnosis.likelihood.flight_rows import make_rows
from diagnosis.likelihood.given_set import fit_set, nearest_members
from diagnosis.likelihood.problem import Problem
from diagnosis.models.command_effects import with_command_effects
from dynamics.effects import CATALOGUE
from dynamics.errors import VehicleError
from dynamics.references import Reference, check_feasibility, named_reference
from dynamics.references.feasibility import slowed
from dynamics.vehicle import EffectUse, Vehicle
from dynamics.vehicle_file import read_vehicle
from flights import Flight
from flights.log import Log
from simulation.campaign_flight import SPEEDS
from simulation.lockstep import FlownReference, fly_reference
from sitl_mock.vehicle.vehicle import VehicleOptions

VEHICLE, SECONDS, ROOM, FIELD = "arpl_250g", 60.0, "box=4x4x3", "box=10x10x5"
LEMNISCATE = "Lemniscate:ramp=3,height=1.5"
SETS: Mapping[str, tuple[str, ...]] = {
    "drag, inertia, lag": ("rotor_drag", "linear_drag", "parasitic_drag", "inertia", "motor_lag"),
    "moments": ("inertia", "torque_constant", "centre_of_mass", "rotational_damping"),
}
LOGGED = {"drag, inertia, lag": ("commands", "speeds"), "moments": ("speeds",)}
PLANNED = {
    "drag, inertia, lag": (
        f"identify:{ROOM},for=drag+inertia+lag",
        f"identify:{FIELD},for=drag+inertia+lag",
        f"identify:{ROOM}",
    ),
    "moments": (f"identify:{ROOM},for=inertia+torque_constant+centre_of_mass+rotational_damping",),
}
REMARKS = """\
The Lemniscate is at the vehicle's limits in x and pitch. A circle at the same limits in the same room has about 1.4
times its root mean square speed, so that the interval of a drag that is fitted alone can fall by about 1.4 there, and
that of the inertia about y hardly at all; what falls further was confounded or not excited. A motors' lag from
commands has the interval of the commands' clock, on which no manoeuvre acts. From commands, the mock's delay of the
actuation is in the lag (22 to 24 % of it), and inertias about x and y come out 2 to 6 % low beside it, outside of their
intervals. What is not planned shows as well: the controller's answer to turbulence turns the vehicle."""
Row = Mapping[str, Any]


@dataclass(frozen=True)
class Trial:
    """Hidden effect, and the seed of its size and of the sensors."""

    hidden: str
    seed: int


@cache
def vehicle() -> Vehicle:
    """The nominal vehicle."""
    return read_vehicle(f"vehicles/{VEHICLE}.toml")


@cache
def planned(text: str) -> tuple[PlannedFlight, float]:
    """An identification flight, and the processor's time that planning took, s."""
    began = time.process_time()
    request = parse_request(f"{text},duration={SECONDS:g}")
    return plan_flight(vehicle(), request, CATALOGUE), time.process_time() - began


def reference(text: str) -> Reference:
    """The reference of a name, of equal length; the Lemniscate as fast as the vehicle can fly it."""
    if text.startswith("identify"):
        return planned(text)[0].reference
    path = named_reference(text, vehicle(), duration=SECONDS)
    verdict = check_feasibility(path, vehicle())
    return path if verdict.is_feasible else slowed(path, verdict.feasible_speed or 1.0)


def sizes(trial: Trial) -> list[EffectUse]:
    """The hidden effects, of 0.5 to 1.5 times their usual size."""
    random = np.random.default_rng([*trial.hidden.encode(), trial.seed])
    uses = []
    for name in SETS[trial.hidden]:
        values = {}
        for parameter in CATALOGUE[name].parameters:
            prior = parameter.prior(vehicle())
            size = prior.mean - parameter.neutral or prior.std * random.choice([-1.0, 1.0])
            values[parameter.name] = float(parameter.neutral + size * random.uniform(0.5, 1.5))
        uses.append(EffectUse(name, values))
    return uses


def measure(trial: Trial) -> list[Row]:
    """A row for each manoeuvre, kind of log and parameter."""
    rows: list[Row] = []
    uses = sizes(trial)
    for text in (LEMNISCATE, *PLANNED[trial.hidden]):
        result, speed = fly(text, uses, trial.seed)
        about = {"hidden": trial.hidden, "seed": trial.seed, "manoeuvre": text, "seconds": result.seconds}
        about |= {"rmse": result.position_rmse, "speed": speed, "planning": _planning_time(text)}
        for logged in LOGGED[trial.hidden]:
            promised = _promised(text)
            fits = fitted(result.log, uses, logged)
            rows += [{**about, "logged": logged, "promised": promised.get(row["parameter"]), **row} for row in fits]
    return rows


def fly(text: str, uses: Sequence[EffectUse], seed: int) -> tuple[FlownReference, float]:
    """A flight of SECONDS, slower where the hidden effects are too strong for full speed, and its factor of speed."""
    for speed in SPEEDS:
        path = reference(text)
        if speed < 1.0:
            path = slowed(path, speed)
            law = replace(path.law, duration=SECONDS)  # as long, fewer laps
            path = replace(path, law=law)
        start = path.states(np.zeros(1))[0]
        yaw = float(2 * np.arctan2(start[9], start[6]))
        options = VehicleOptions(position=(float(start[0]), float(start[1])), yaw=yaw)
        result = fly_reference(vehicle(), path, effects=uses, options=options, seed=seed, name=text)
        if not result.aborted:
            return result, speed
    raise VehicleError(f"{text} cannot be flown even at {SPEEDS[-1]:g} of its speed: {result.aborted}.")


def fitted(log: Log, uses: Sequence[EffectUse], logged: str) -> list[Row]:
    """A row for each parameter of the hidden effects that such a log can show."""
    if logged == "commands":
        streams = tuple(stream for stream in log.streams if stream.name != "rotor_speed")
        log = Log(streams, log.provenance)
    else:
        uses = [use for use in uses if CATALOGUE[use.name].rotor_speed is None]
    dataset = make_dataset([Flight.from_log(log, rate=100.0)], vehicle())
    catalogue = {use.name: CATALOGUE[use.name] for use in uses}
    model, catalogue = with_command_effects(vehicle(), catalogue, dataset.fitted)
    what = candidates(model, catalogue, dataset.fitted)
    flights = [make_rows(s, group) for s, group in zip(dataset.fitted, dataset.flight_of, strict=True)]
    problem = Problem(model, catalogue, flights, what)
    estimate = fit_set([problem], nearest_members(problem, uses))
    true = {(use.name, name): value for use in uses for name, value in use.parameters.items()}
    return [
        {"parameter": f"{key}.{name}", "true": true[key, name], "value": value, "std": float(std)}
        for ((key, name), value), std in zip(estimate.values.items(), estimate.deviations, strict=True)
    ]


def _promised(text: str) -> dict[str, float]:
    """Expected standard deviations by parameter, none of the Lemniscate."""
    return {one.name: one.std for one in planned(text)[0].expected} if text.startswith("identify") else {}


def table(rows: Sequence[Row]) -> str:
    """A line for each parameter, the medians over the seeds."""
    head = (
        "| hidden | logged | parameter | Lemniscate, % | planned | % | ratio | range | promised | error, Lemniscate, % "
        "| error, planned, % | held | held, planned |"
    )
    lines = [head, "|" + " --- |" * 13]
    ratios: dict[tuple[str, str, str], list[float]] = {}
    groups = dict.fromkeys((r["hidden"], r["logged"], r["parameter"]) for r in rows)
    for hidden, logged, parameter in groups:
        own = [r for r in rows if (r["hidden"], r["logged"], r["parameter"]) == (hidden, logged, parameter)]
        before = {r["seed"]: r for r in own if r["manoeuvre"] == LEMNISCATE}
        for text in PLANNED[hidden]:
            after = {r["seed"]: r for r in own if r["manoeuvre"] == text}
            both = sorted(set(before) & set(after))
            ratio = [after[s]["std"] / before[s]["std"] for s in both]
            ratios.setdefault((hidden, logged, text), []).append(float(np.median(ratio)))
            cells = [
                hidden, logged, parameter, _percent(before.values()), _short(text),
                _percent(after.values()), f"{np.median(ratio):.2f}", f"{min(ratio):.2f} to {max(ratio):.2f}",
                f"{np.median([r['promised'] / r['std'] for r in after.values()]):.2f}",
                _error(before.values()), _error(after.values()), _held(before.values()), _held(after.values()),
            ]  # fmt: skip
            lines.append("| " + " | ".join(cells) + " |")
    head = "| hidden | logged | planned | parameters | median ratio | geometric mean | at least halved | promised |"
    lines += ["", head, "|" + " --- |" * 8]
    for (hidden, logged, text), values in ratios.items():
        halved, promised = sum(value <= 0.5 for value in values), _range(rows, hidden, logged, text)
        lines.append(
            f"| {hidden} | {logged} | {_short(text)} | {len(values)} | {np.median(values):.2f} "
            f"| {np.exp(np.mean(np.log(values))):.2f} | {halved} of {len(values)} | {promised} |"
        )
    return "\n".join(lines)


def _range(rows: Sequence[Row], hidden: str, logged: str, text: str) -> str:
    """Median and range, over parameters and flights, of what a plan promises over what its flight gives."""
    own = [r for r in rows if (r["hidden"], r["logged"], r["manoeuvre"]) == (hidden, logged, text)]
    values = [r["promised"] / r["std"] for r in own]
    return f"{np.median(values):.2f} ({min(values):.2f} to {max(values):.2f})"


def _planning_time(text: str) -> float:
    return planned(text)[1] if text.startswith("identify") else 0.0


def _short(text: str) -> str:
    """A request's room, and whether the hidden effects were named in it."""
    room = text.partition("box=")[2].partition(",")[0]
    return f"{room}, {'named' if 'for=' in text else 'whole catalogue'}"


def _percent(rows: Any) -> str:
    """Median interval of 95 %, of the true value."""
    return f"{np.median([196 * r['std'] / abs(r['true']) for r in rows]):.2g}"


def _error(rows: Any) -> str:
    """Median distance from the true value, of that."""
    return f"{np.median([100 * abs(r['value'] / r['true'] - 1) for r in rows]):.2g}"


def _held(rows: Any) -> str:
    inside = [abs(r["value"] - r["true"]) <= 1.96 * r["std"] for r in rows]
    return f"{sum(inside)} of {len(inside)}"


def flights_table(rows: Sequence[Row]) -> str:
    """How each manoeuvre was flown."""
    lines = [
        "| manoeuvre | planned in, s of the processor | flights | s | tracking RMS, m | speeds |",
        "|" + " --- |" * 6,
    ]
    for text in dict.fromkeys(row["manoeuvre"] for row in rows):
        own = {(r["hidden"], r["seed"]): r for r in rows if r["manoeuvre"] == text}.values()
        errors = [r["rmse"] for r in own]
        planning = max(r["planning"] for r in own)
        cells = [
            text,
            f"{planning:.0f}" if planning else "",
            len(own),
            f"{np.median([r['seconds'] for r in own]):.1f}",
            f"{np.median(errors):.3f}",
        ]
        lines.append("| " + " | ".join(map(str, (*cells, ", ".join(f"{r['speed']:g}" for r in own)))) + " |")
    return "\n".join(lines)


def identification_flight(words: Sequence[str]) -> Page:
    """Fly and fit. Returns the page."""
    parser = options_of(__doc__, resumes="identification_flight", jobs=1, flights=1, first_seed=5000)
    parser.add_argument("--hidden", nargs="*", default=list(SETS))
    chosen = parser.parse_args(words)
    seeds = range(chosen.first_seed, chosen.first_seed + chosen.flights)
    trials = [Trial(hidden, seed) for seed in seeds for hidden in chosen.hidden]
    trials = trials[: chosen.cases]
    rows = kept_results(chosen.kept)
    done = {(row["hidden"], row["seed"]) for row in rows}
    for result in flown(measure, [t for t in trials if (t.hidden, t.seed) not in done], jobs=chosen.jobs):
        rows += result
        keep(chosen.kept, *result)
    rows = [row for row in rows if Trial(row["hidden"], row["seed"]) in trials]
    note = (
        f"{paragraph_of(__doc__)}\n\nVehicle {VEHICLE}, seeds {seeds[0]} to {seeds[-1]}. Intervals of "
        "95 % and median errors in per cent of the true value; held: how often the intervals contain it."
    )
    text = f"{note}\n\n{flights_table(rows)}\n\n{table(rows)}\n\n{REMARKS}"
    return Page("identification_flight", "Intervals after an identification flight", text)
