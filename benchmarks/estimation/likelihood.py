"""The likelihood's answers to the judge's cases, beside what diagnosis answers today. Writes likelihood.md.

`diagnosis/likelihood` shall replace the regression; it has no verdict yet. What is scored is the best set of effects:
those whose removal costs three of the log-evidence (20 to 1) and that are not too small to be claimed. Outcomes are the
judge's (`python -m benchmarks.verdict`). Recordings, RotorPy's and PX4's, have no seeds: those here are the ones by
which `thresholds.likelihood.trusted` was calibrated, beside flights of the outside simulator of other seeds than these.

    python -m benchmarks estimation likelihood --sets captured rotorpy --first 91000 --jobs 2
"""

from __future__ import annotations

import tempfile
import time
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np

from benchmarks.measurement import Page, add_names, keep, kept_results, options_of, paragraph_of
from benchmarks.verdict.asking import ask
from benchmarks.verdict.cases import Case, planned, read_sets
from benchmarks.verdict.posing import LostFlightsError, Posed, pose, recordings
from benchmarks.verdict.record import Record
from benchmarks.verdict.scoring import Answer, Outcome, intervals, outcome_of
from diagnosis.data.dataset import read_dataset
from diagnosis.likelihood.columns import candidates
from diagnosis.likelihood.flight_rows import make_rows
from diagnosis.likelihood.identify import Identified, identify
from diagnosis.likelihood.problem import Problem
from diagnosis.models.command_effects import with_command_effects
from dynamics.effects import CATALOGUE
from dynamics.errors import AlulaError
from dynamics.vehicle import Vehicle
from dynamics.vehicle_file import read_vehicle
from flights.parallel import parallel_map

SETS = ("captured", "rotorpy", "px4_real", "px4_like", "estimated", "nothing")
NAMED = 3.0  # of the log-evidence
FIRST, LIMIT, MIN_ANSWERS = 91_000, 1000, 20  # seed, cases of a set, answers that make a page


def answer_of(problem: Problem, result: Identified) -> Answer:
    """The best set as a report of diagnosis has it."""
    effects: list[dict[str, Any]] = []
    first, values = 0, result.search.named_values(result.best)
    for number in result.best.members:
        width = len(result.search.columns[number])
        candidate, deviations = problem.what.all[number], result.std[first : first + width]
        first += width
        rest = result.search.score([i for i in result.best.members if i != number])
        present = candidate.present or {p.name: p.neutral for p in candidate.effect.parameters}
        size = max(abs(value - present[name]) for name, value in values[number].items())
        gain = result.best.evidence - rest.evidence
        if gain < NAMED or size < candidate.effect.min_detectable:
            continue
        rivals = {problem.what.all[i].effect.name for i in result.search.rivals(result.best, number, NAMED)}
        parameters = {
            name: {"value": value, "std": float(std)}
            for (name, value), std in zip(values[number].items(), deviations, strict=True)
        }
        effects.append(
            {
                "name": candidate.effect.name,
                "rotor": candidate.rotor,
                "parameters": parameters,
                "confidence": float(1 / (1 + np.exp(-gain))),
                "ambiguous_with": sorted(rivals - {candidate.effect.name}),
            }
        )
    word = "ambiguous" if any(effect["ambiguous_with"] for effect in effects) else "effect"
    return Answer({"verdict": word if effects else "explained", "effects": effects})


def answer_to(posed: Posed) -> Answer:
    """The answer of the likelihood to a question."""
    vehicle = posed.vehicle if isinstance(posed.vehicle, Vehicle) else read_vehicle(posed.vehicle)
    logs = [log for log in posed.logs if isinstance(log, Path)]  # of these sets all are
    dataset = read_dataset(logs, vehicle, hold_out=posed.hold_out)
    vehicle, catalogue = with_command_effects(vehicle, CATALOGUE, dataset.fitted)
    rows = [make_rows(segment, group) for segment, group in zip(dataset.fitted, dataset.flight_of, strict=True)]
    problem = Problem(vehicle, catalogue, rows, candidates(vehicle, catalogue, dataset.fitted))
    return answer_of(problem, identify(problem))


def both(case: Case) -> tuple[dict[str, Any], dict[str, Any]]:
    """Records of the likelihood's answer and of diagnosis'."""
    with tempfile.TemporaryDirectory() as folder:
        try:
            posed = pose(case, Path(folder))
        except LostFlightsError:
            lost = {"key": case.key, "set": case.set_name, "outcome": "lost"}
            return lost, lost
        began = time.process_time()
        try:
            answer = answer_to(posed)
        except AlulaError as error:
            answer = Answer(refusal=str(error))
        except Exception as error:  # is an answer, too, and the worst one
            answer = Answer(error=f"{type(error).__name__}: {error}")
        took = time.process_time() - began
    return _line(Record(case.key, case.set_name, case.seed, posed.expected, answer, took)), _line(ask(case))


def _line(record: Record) -> dict[str, Any]:
    outcome = outcome_of(record.answer, record.expected)
    return {
        "key": record.key,
        "set": record.set_name,
        "outcome": outcome.value,
        "held": intervals(record.answer, record.expected),
        "took": record.took,
        "named": [str(effect["name"]) for effect in record.answer.effects],
        "hidden": list(record.expected.hidden),
        "word": record.answer.error or record.answer.word,
    }


def likelihood(arguments: Sequence[str]) -> Page:
    """Ask both, and make the page."""
    parser = options_of(__doc__, jobs=2, resumes="likelihood", first=FIRST, limit=LIMIT)
    add_names(parser, "--sets", SETS)
    options = parser.parse_args(arguments)
    cases = planned(read_sets(), options.sets, options.first, options.limit)[: options.cases]
    folder = recordings()
    cases = [
        c
        for c in cases
        if c.entry.source != "recorded" or (folder and all((folder / file).exists() for file in c.entry.files))
    ]
    keys = {case.key for case in cases}
    pairs: list[Sequence[Mapping[str, Any]]] = [pair for pair in kept_results(options.kept) if pair[0]["key"] in keys]
    done = {new["key"] for new, _ in pairs}
    for _, pair in parallel_map(both, [c for c in cases if c.key not in done], jobs=options.jobs):
        new, old = pair
        keep(options.kept, pair, line=f"{new['key']}: {new['outcome']} {new.get('named')}; {old['outcome']}")
        pairs.append(pair)
    pairs = [pair for pair in pairs if pair[0]["outcome"] != "lost"]
    trial = len(pairs) < MIN_ANSWERS
    return Page("likelihood", "The likelihood beside today's diagnosis", _table(pairs, options.first), trial=trial)


def _table(pairs: Sequence[Sequence[Mapping[str, Any]]], first: int) -> str:
    titles = {name: each.title for name, each in read_sets().items()}
    heads = ["set", "cases", "which", *(outcome.value for outcome in Outcome), "intervals", "s, median"]
    rows = [f"| {' | '.join(heads)} |"]
    rows.append("| --- " * len(heads) + "|")
    for name in dict.fromkeys(pair[0]["set"] for pair in pairs):
        for place, which in enumerate(("likelihood", "today")):
            records = [pair[place] for pair in pairs if pair[0]["set"] == name]
            counts = Counter(record["outcome"] for record in records)
            held = [one for record in records for one in record["held"]]
            cells = [titles[name] if place == 0 else "", str(len(records)) if place == 0 else "", which]
            cells += [str(counts[outcome.value]) for outcome in Outcome]
            cells += [f"{sum(held)} of {len(held)}", f"{median(record['took'] for record in records):.1f}"]
            rows.append(f"| {' | '.join(cells)} |")
    answers = [
        f"- `{new['key']}`: {', '.join(new['hidden']) or 'nothing'} -> {', '.join(new['named']) or new['word']} "
        f"({new['outcome']}); today {', '.join(old['named']) or old['word']} ({old['outcome']})"
        for new, old in pairs
        if new["outcome"] != Outcome.RIGHT.value
    ]
    text = [paragraph_of(__doc__), f"Seeds from {first} on.", "\n".join(rows), "## Where the likelihood is not right"]
    return "\n\n".join([*text, "\n".join(answers)])
