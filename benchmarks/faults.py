"""Planned faults in flight: ends that nobody expected, by case and model. Writes results/faults.md.

The files of fixtures/fault_cases are flown over the link's bytes in simulated time, by the vehicle file's model, by one
that has identified what the mock hides (a tenth less thrust), by one that follows it in flight and, where
`build/fault_bundle` holds an exported network of px4_sih, by a learned one. At each tick: setpoints are finite and
within their limits, and none leaves after the end. Finished flights are kept, so that a run that was stopped resumes.

    python -m benchmarks faults study --seeds 5 --jobs 2
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from time import perf_counter
from typing import Any

import msgspec

from benchmarks.measurement import Page, add_names, measured, options_of, paragraph_of
from fixtures.fault_flights import LEARNED, MODELS, Model, fly_case, read_cases

FIRST_SEED = 71_000
Flight = tuple[str, Model, int]


def key_of(flight: Flight) -> str:
    """Unique name of a flight."""
    return ", ".join(map(str, flight))


def flown(flight: Flight) -> dict[str, Any]:
    """The result of a flight and its duration, s of this computer. flight: case, model and seed."""
    name, model, seed = flight
    began = perf_counter()
    (case,) = read_cases([name])
    result = fly_case(case, model, seed)
    return {"key": key_of(flight), "seconds": perf_counter() - began, **msgspec.to_builtins(result)}


def line_of(result: Mapping[str, Any]) -> str:
    """One line about a flight."""
    return f"{result['key']}: {result['end']}{' !! ' + result['unexplained'] if result['unexplained'] else ''}"


def table(results: Sequence[Mapping[str, Any]]) -> str:
    """The table of cases, and that of unexplained ends."""
    models = [model for model in MODELS if any(result["model"] == model for result in results)]
    unexplained = [result for result in results if result["unexplained"]]
    violations = sum(bool(result["violations"]) for result in results)
    flown_cases = len({result["case"] for result in results})
    seconds = sum(result["seconds"] for result in results) / len(results)
    lines = [
        f"{len(results)} flights of {flown_cases} of {len(read_cases())} cases: **{len(unexplained)}** ends "
        f"that are not as expected, **{violations}** flights with a setpoint that is not finite, outside its limits or "
        f"after the end. A flight took {seconds:.0f} s of one processor on average.",
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
    add_names(parser, "--models", MODELS)
    options = parser.parse_args(words)
    models = [model for model in options.models if model != "learned" or LEARNED.exists()]
    names = [case.name for case in read_cases()]
    flights: list[Flight] = [
        (name, model, FIRST_SEED + seed) for seed in range(options.seeds) for model in models for name in names
    ]
    results = measured(flown, flights, options, line_of, key_of=key_of)
    left_out = "" if "learned" in models else f"\n\nWithout a learned model: {LEARNED} does not exist.\n"
    return Page("faults", "Planned faults in flight", f"{paragraph_of(__doc__)}{left_out}\n\n{table(results)}")
