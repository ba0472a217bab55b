"""Both methods' answers to the judge's cases, side by side. Writes likelihood.md.

The likelihood (`diagnosis/likelihood`) shall replace the regression; today it is asked of logs whose pose an estimator
makes. Here both are asked of all: the same flights, the same tests of what remains, values each by its own. Outcomes
are the judge's (`python -m benchmarks.verdict`). Recordings, RotorPy's and PX4's, have no seeds: those here are the
ones by which `thresholds.likelihood.trusted` was calibrated, beside flights of the outside simulator of other seeds
than these.

    python -m benchmarks estimation likelihood --sets captured rotorpy --first 91000 --jobs 2
"""

from __future__ import annotations

import json
import tempfile
import time
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from statistics import median
from typing import Any

import msgspec

from benchmarks.measurement import Page, add_names, keep, kept_results, options_of, paragraph_of
from benchmarks.verdict.cases import Case, planned, read_sets
from benchmarks.verdict.posing import LostFlightsError, Posed, pose, recordings
from benchmarks.verdict.record import Record
from benchmarks.verdict.scoring import Answer, Outcome, intervals, outcome_of
from diagnosis.data.dataset import read_dataset
from diagnosis.diagnose import diagnose_dataset
from diagnosis.report import Method
from dynamics.effects import CATALOGUE
from dynamics.errors import AlulaError
from dynamics.vehicle import Vehicle
from dynamics.vehicle_file import read_vehicle
from flights.parallel import parallel_map

METHODS: tuple[Method, ...] = ("likelihood", "regression")
SETS = ("captured", "rotorpy", "px4_real", "px4_like", "estimated", "nothing")
FIRST, LIMIT, MIN_ANSWERS = 91_000, 1000, 20  # seed, cases of a set, answers that make a page


def answer_to(posed: Posed, method: Method) -> Answer:
    """The answer of a method to a question."""
    vehicle = posed.vehicle if isinstance(posed.vehicle, Vehicle) else read_vehicle(posed.vehicle)
    logs = [log for log in posed.logs if isinstance(log, Path)]  # of these sets all are
    dataset = read_dataset(logs, vehicle, hold_out=posed.hold_out)
    return Answer(
        json.loads(msgspec.json.encode(diagnose_dataset(dataset, vehicle, CATALOGUE, method=method).diagnosis))
    )


def both(case: Case) -> tuple[dict[str, Any], ...]:
    """Records of both methods' answers."""
    with tempfile.TemporaryDirectory() as folder:
        try:
            posed = pose(case, Path(folder))
        except LostFlightsError:
            lost = {"key": case.key, "set": case.set_name, "outcome": "lost"}
            return lost, lost
        records = []
        for method in METHODS:
            began = time.process_time()
            try:
                answer = answer_to(posed, method)
            except AlulaError as error:
                answer = Answer(refusal=str(error))
            except Exception as error:  # is an answer, too, and the worst one
                answer = Answer(error=f"{type(error).__name__}: {error}")
            took = time.process_time() - began
            records.append(_line(Record(case.key, case.set_name, case.seed, posed.expected, answer, took)))
    return tuple(records)


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
    return Page("likelihood", "The likelihood beside the regression", _table(pairs, options.first), trial=trial)


def _table(pairs: Sequence[Sequence[Mapping[str, Any]]], first: int) -> str:
    titles = {name: each.title for name, each in read_sets().items()}
    heads = ["set", "cases", "which", *(outcome.value for outcome in Outcome), "intervals", "s, median"]
    rows = [f"| {' | '.join(heads)} |"]
    rows.append("| --- " * len(heads) + "|")
    for name in dict.fromkeys(pair[0]["set"] for pair in pairs):
        for place, which in enumerate(METHODS):
            records = [pair[place] for pair in pairs if pair[0]["set"] == name]
            counts = Counter(record["outcome"] for record in records)
            held = [one for record in records for one in record["held"]]
            cells = [titles[name] if place == 0 else "", str(len(records)) if place == 0 else "", which]
            cells += [str(counts[outcome.value]) for outcome in Outcome]
            cells += [f"{sum(held)} of {len(held)}", f"{median(record['took'] for record in records):.1f}"]
            rows.append(f"| {' | '.join(cells)} |")
    answers = [
        f"- `{new['key']}`: {', '.join(new['hidden']) or 'nothing'} -> {', '.join(new['named']) or new['word']} "
        f"({new['outcome']}); regression {', '.join(old['named']) or old['word']} ({old['outcome']})"
        for new, old in pairs
        if new["outcome"] != Outcome.RIGHT.value
    ]
    text = [paragraph_of(__doc__), f"Seeds from {first} on.", "\n".join(rows), "## Where the likelihood is not right"]
    return "\n\n".join([*text, "\n".join(answers)])
