"""Does diagnosis name what is planted? Effects hidden in simulated flights, at sizes set by the sensors' noise.

Every case is nine flights of about 12 s, two of them held out, by one of three simulators: `compiled` (our physics,
another integrator, controller and sensors than the mock's), `rotorpy` (nothing of ours), `mock` (the mock's plant under
the runtime). An effect's size is such that at its best channel it makes 0.1, 0.4, 1.5 or 5 times the noise floor. Even
seeds are for calibrating thresholds, odd seeds for the table. Flights and finished cases are kept in build/, so that a
run that was stopped resumes.

    python -m benchmarks.diagnosis_planted_truth --first 1 --seeds 1 --noise 1 3 --nothing 200 --pairs 24
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path

from rich.progress import track

from benchmarks.planted_cases import Case, fair, flown, names, pairs, vehicle
from benchmarks.planted_table import table
from benchmarks.provenance import write_result
from diagnosis.diagnose import DiagnosisDetails, diagnose_dataset
from diagnosis.report import MissingEffect
from dynamics.effects import CATALOGUE
from dynamics.vehicle import EffectUse
from fixtures.foreign_effects import FOREIGN
from flights.parallel import parallel_map

CASES_FILE = Path("build/diagnosis_planted_truth.jsonl")
SOURCES = ("compiled", "rotorpy", "mock")


def run(case: Case) -> dict[str, object]:
    """Fly, diagnose, and what came of it."""
    try:
        data, uses = flown(case)
        began = time.process_time()
        findings = diagnose_dataset(data, vehicle(), CATALOGUE)
    except Exception as error:  # a case that cannot be flown or answered is a result, too
        return {**asdict(case), "error": f"{type(error).__name__}: {error}"[:200]}
    return {**asdict(case), "took": time.process_time() - began, **outcome(findings, uses)}


def outcome(findings: DiagnosisDetails, uses: Sequence[EffectUse]) -> dict[str, object]:
    """The verdict, and the numbers behind it."""
    answer = findings.diagnosis
    true = {use.name: use for use in uses}
    parameters = {
        f"{effect.name}.{n}": (true[effect.name].parameters[n], p.value, p.std)
        for effect in answer.effects
        if effect.name in true and effect.rotor == true[effect.name].rotor
        for n, p in effect.parameters.items()
        if p.std > 0 and n in true[effect.name].parameters and effect.name != "gust" and _same_form(effect, true)
    }
    return {
        "verdict": answer.verdict,
        "names": [e.name for e in answer.effects],
        "rivals": [list(e.ambiguous_with) for e in answer.effects],
        "confidence": [e.confidence for e in answer.effects],
        "rotors": [e.rotor for e in answer.effects],
        "truth": [(use.name, use.rotor, use.parameters) for use in uses],
        "over_floor": {k: (c.before / c.floor, c.after / c.floor) for k, c in answer.channels.items()},
        "residual_tests": findings.residual_tests.statistics,
        "leftover": [(one.test, one.channel, one.size, one.over_floor) for one in answer.leftover],
        "chi_square": (findings.chi_square_before, findings.chi_square_after),
        "singles": [(s.candidates[0].effect.name, s.score) for s in findings.selection.singles[:5]],
        "chosen": [c.key for c in findings.selection.chosen.candidates],
        "gusts": (findings.selection.gust_before.score, findings.selection.gust.score),
        "parameters": parameters,
    }


def _same_form(effect: MissingEffect, true: Mapping[str, EffectUse]) -> bool:
    """Whether parameters that were tried, not fitted, are the true ones: else the fitted ones mean something else."""
    held = {n: p.value for n, p in effect.parameters.items() if p.std == 0}
    return all(
        abs(value - true[effect.name].parameters.get(n, value)) <= 1e-3 * abs(value) for n, value in held.items()
    )


def cases(options: argparse.Namespace) -> list[Case]:
    """All cases that the options ask for, seed by seed."""
    planned: list[Case] = []
    source = options.source
    for seed in range(options.first, options.first + options.seeds):
        for noise in options.noise:
            planned += [
                Case("single", (name,), strength, noise, seed, source)
                for strength in options.strengths
                for name in options.effects or names(source)
            ]
            if source == "compiled":
                planned += [
                    Case("outside", (name,), strength, noise, seed, source)
                    for strength in options.outside
                    for name in FOREIGN
                ]
        if source != "mock":
            drawn = pairs(source, options.pairs, seed)
            planned += [
                Case("pair", pair, 5.0 if i % 2 else 1.5, options.noise[i // 2 % len(options.noise)], seed, source)
                for i, pair in enumerate(drawn)
            ]
    first = 1000 + options.first
    nothing = [
        Case("nothing", (), 0.0, noise, first + 2 * i, source)
        for i in range(options.nothing)
        for noise in options.noise
    ]
    return [*planned, *nothing]


def parser() -> argparse.ArgumentParser:
    """The options."""
    made = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    made.add_argument("--source", choices=SOURCES, default="compiled")
    made.add_argument("--seeds", type=int, default=1)
    made.add_argument("--first", type=int, default=0, help="the first seed")
    made.add_argument("--noise", type=float, nargs="+", default=[1.0, 3.0])
    made.add_argument("--strengths", type=float, nargs="*", default=[1.5, 0.4, 5.0, 0.1])
    made.add_argument("--outside", type=float, nargs="*", default=[1.5, 0.4, 5.0])
    made.add_argument("--effects", nargs="*", default=[])
    made.add_argument("--nothing", type=int, default=0, help="cases that hide nothing, for each noise")
    made.add_argument("--pairs", type=int, default=0)
    made.add_argument("--jobs", type=int, default=1)
    made.add_argument("--budget", type=float, default=float("inf"), help="seconds after which no case is begun")
    made.add_argument("--kept", type=Path, default=CASES_FILE, help="where finished cases are kept")
    made.add_argument("--table", action="store_true", help="write the table of the odd seeds")
    return made


def main() -> None:
    """Run the missing cases, and write the table if requested."""
    options = parser().parse_args()
    options.kept.parent.mkdir(exist_ok=True)
    done = {}
    if options.kept.exists():
        done = {json.loads(line)["key"]: json.loads(line) for line in options.kept.read_text().splitlines()}
    todo = [case for case in cases(options) if case.key not in done]
    began = time.monotonic()
    with options.kept.open("a") as file:
        for index, result in track(parallel_map(run, todo, jobs=options.jobs), total=len(todo)):
            done[todo[index].key] = {"key": todo[index].key, **result}
            print(json.dumps(done[todo[index].key]), file=file, flush=True)
            if time.monotonic() - began > options.budget:
                break
    if options.table:
        odd = [r for r in done.values() if r["seed"] % 2 == 1 and (r["kind"] != "pair" or fair(r["effects"]))]
        write_result("diagnosis_planted_truth", "Planted truth: does diagnosis name it?", table(odd))
    else:
        print(table(list(done.values())))


if __name__ == "__main__":
    main()
