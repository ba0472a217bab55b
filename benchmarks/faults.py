"""Planned faults in flight: ends that nobody expected, by case and model. Writes results/faults.md.

The files of fixtures/fault_cases are flown over the link's bytes in simulated time, by the vehicle file's model
(nominal), by one that has identified what the mock hides, a tenth less thrust (identified), by a PI-TCN (learned) and
by a model that follows in flight what is hidden (adapting); a reference that leaps also by a network without history
that makes the vehicle oscillate (learned_mlp). At each tick: setpoints are finite and within their limits, and none
leaves after the end. Finished flights are kept, so that a run that was stopped resumes. The networks are trained once,
3,000 steps on eleven simulated flights, which takes some minutes.

    python -m benchmarks faults study --seeds 5 --jobs 2
"""

from __future__ import annotations

import subprocess
import sys
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from time import perf_counter
from typing import Any, get_args

import msgspec

from benchmarks.measurement import Page, add_names, finished, measured, options_of, paragraph_of
from benchmarks.provenance import commit
from fixtures.fault_flights import BUNDLES, VEHICLE, FaultCase, Model, fly_case, read_cases

FIRST_SEED = 71_000
ALL_MODELS: tuple[Model, ...] = get_args(Model)
CAMPAIGN = Path("build/fault_campaign")
FLIGHTS = (
    "circle_xy*",
    "line_*_wide",
    "yaw_spin*",
    "Lemniscate_xz_60",
    "WarpedEllipse_1_xz",
    "ExtendedLemniscate_xy_60",
)
STEPS = 3000
Flight = tuple[str, Model, int]


def export_network(folder: Path) -> None:
    """Train and export the network that a folder is named after, where it is not there."""
    if (folder / "manifest.json").exists():
        return
    if not CAMPAIGN.exists():
        patterns = [word for pattern in FLIGHTS for word in ("--flights", pattern)]
        _run("campaign", "--vehicle", str(VEHICLE), "--out", str(CAMPAIGN), "--jobs", "1", *patterns)
    checkpoint = folder.with_suffix(".pt")
    folder.parent.mkdir(parents=True, exist_ok=True)
    words = ("--vehicle", str(VEHICLE), "--model", folder.name, "--steps", str(STEPS), "--out", str(checkpoint))
    _run("train", str(CAMPAIGN), *words)
    _run("export", str(checkpoint), "--out", str(folder))


def _run(*words: str) -> None:
    subprocess.run([sys.executable, "-m", "alula", *words], check=True)


def planned_flights(models: Sequence[Model], seeds: int) -> list[Flight]:
    """Every case by each of the models that fly it and by each seed.

    The first flights are every case by the first model, the next ones every case by another one: a run that is
    stopped has flown them all as evenly as it can.
    """
    cases = read_cases()
    courses = [_course(case, models, offset) for offset, case in enumerate(cases)]
    longest = max(map(len, courses))
    return [
        (case.name, course[turn], FIRST_SEED + seed)
        for seed in range(seeds)
        for turn in range(longest)
        for case, course in zip(cases, courses, strict=True)
        if turn < len(course)
    ]


def _course(case: FaultCase, models: Sequence[Model], offset: int) -> list[Model]:
    """The models of a case in the order in which they fly it. offset: by which all but the first are turned."""
    flying = [model for model in models if model in case.models]
    first, others = flying[:1], flying[1:]
    turned = offset % max(len(others), 1)
    return [*first, *others[turned:], *others[:turned]]


def key_of(flight: Flight) -> str:
    """Unique name of a flight."""
    return ", ".join(map(str, flight))


def flown(flight: Flight) -> dict[str, Any]:
    """The result of a flight and its duration, s of this computer. flight: case, model and seed."""
    name, model, seed = flight
    began = perf_counter()
    (case,) = read_cases([name])
    result = fly_case(case, model, seed)
    seconds = perf_counter() - began
    return {"key": key_of(flight), "seconds": seconds, "commit": commit(), **msgspec.to_builtins(result)}


def line_of(result: Mapping[str, Any]) -> str:
    """One line about a flight."""
    return f"{result['key']}: {result['end']}{' !! ' + result['unexplained'] if result['unexplained'] else ''}"


def table(results: Sequence[Mapping[str, Any]]) -> str:
    """The table of cases, and that of unexplained ends."""
    models = [model for model in ALL_MODELS if any(result["model"] == model for result in results)]
    unexplained = [result for result in results if result["unexplained"]]
    violations = sum(bool(result["violations"]) for result in results)
    flown_cases = len({result["case"] for result in results})
    seconds = sum(result["seconds"] for result in results) / len(results)
    lines = [
        f"{len(results)} flights of {flown_cases} of {len(read_cases())} cases: **{len(unexplained)}** ends "
        f"that are not as expected, **{violations}** flights with a setpoint that is not finite, outside its limits or "
        f"after the end. A flight took {seconds:.0f} s by the clock on average.",
        "",
        f"| case | fault | {' | '.join(models)} |",
        f"| --- | --- |{' --- |' * len(models)}",
    ]
    for case in read_cases():
        some = [result for result in results if result["case"] == case.name]
        if some:
            cells = [_cell([result for result in some if result["model"] == model]) for model in models]
            lines.append(f"| {case.name} | {case.summary} | {' | '.join(cells)} |")
    lines += ["", "## Ends that are not as expected", "", "| flight | why | outcome |", "| --- | --- | --- |"]
    lines += [f"| {result['key']} | {result['unexplained']} | {result['outcome']} |" for result in unexplained]
    return "\n".join(lines)


def _cell(results: Sequence[Mapping[str, Any]]) -> str:
    ends = [result["end"] for result in results]
    wrong = sum(bool(result["unexplained"]) for result in results)
    text = ", ".join(f"{ends.count(end)} {end}" for end in sorted(set(ends)))
    return f"{text}; **{wrong} unexpected**" if wrong else text


def study(words: Sequence[str]) -> Page:
    """Fly the cases and write the tables."""
    parser = options_of(__doc__, jobs=1, resumes="faults", seeds=5)
    add_names(parser, "--models", ALL_MODELS)
    parser.add_argument("--flown", action="store_true", help="write the page of the flights that are flown, fly none")
    options = parser.parse_args(words)
    flights = planned_flights(options.models, options.seeds)
    if options.flown:
        done = finished(options.kept)
        results = [done[key] for key in map(key_of, flights) if key in done]
    else:
        for model in set(options.models) & set(BUNDLES):
            export_network(BUNDLES[model])
        results = measured(flown, flights, options, line_of, key_of=key_of)
    commits = Counter(result["commit"].removeprefix("commit ") for result in results)
    by_commit = ", ".join(f"{count} at {name}" for name, count in commits.items())
    planned = f"{len(results)} of {len(flights)} planned flights are flown: {by_commit}."
    return Page("faults", "Planned faults in flight", f"{paragraph_of(__doc__)}\n\n{planned}\n\n{table(results)}")
