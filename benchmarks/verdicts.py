"""Is the verdict right on vehicles, sensors and logs that are not ours, or silent? Writes results/verdicts.md.

Random vehicles (quadrotor X and +, hexarotor, 40 g to 2.5 kg) fly random paths, slow and fast, in a simulator that
shares no line with `dynamics`; logs hold speeds or commands at 50 to 400 Hz, or are PX4's with the errors of its
estimator. Flights and finished cases are kept, so that a run that was stopped resumes; logs serve every later version.

    python -m benchmarks.verdicts --kind nothing single outside --first 1 --count 2 --kept build/verdicts.jsonl --table
"""

from __future__ import annotations

import argparse
import json
import os
import time
import traceback
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import msgspec

import alula
from benchmarks.provenance import write_result
from benchmarks.verdict_cases import KINDS, Case, prepare
from benchmarks.verdict_table import table, wrong_answers
from dynamics.errors import AlulaError
from flights.parallel import parallel_map

TOGETHER = 32  # cases that are flown side by side
MAX_ROUNDS = 6  # of adding


def planned(options: argparse.Namespace) -> list[Case]:
    """The cases that the options ask for, seed by seed."""
    return [
        Case(kind, name, seed)
        for seed in range(options.first, options.first + options.count)
        for kind in options.kind
        for name in KINDS[kind]
        if not options.names or name in options.names
    ]


def answer(case: Case) -> dict[str, Any]:
    """Answer of the diagnosis to a case that was flown."""
    described = json.loads((case.folder / "case.json").read_text())
    result: dict[str, Any] = {"key": case.key, "kind": case.kind, "name": case.name, "seed": case.seed, **described}
    logs, vehicle = logs_of(case.folder), str(case.folder / "vehicle.toml")
    if not logs:
        return result
    began = time.process_time()
    try:
        result |= added(logs, case.folder) if case.kind == "add" else diagnosed(logs, vehicle)
    except AlulaError as error:
        result["refused"] = str(error)
    except Exception as error:  # a traceback is a result, too, and the worst one
        result["error"] = f"{type(error).__name__}: {error}; {traceback.format_exc(limit=-3)}"[:600]
    result["took"] = time.process_time() - began
    return result


def logs_of(folder: Path) -> list[str]:
    """Of a case."""
    return sorted(str(log) for pattern in ("*.csv", "*.ulg", "*.parquet") for log in folder.glob(pattern))


def diagnosed(logs: Sequence[str], vehicle: str) -> dict[str, Any]:
    """The report and its sentence."""
    diagnosis = alula.diagnose(list(logs), vehicle)
    flown = sum(segment.duration for segment in diagnosis.dataset.everything)
    return {"report": msgspec.to_builtins(diagnosis.report), "sentence": diagnosis.sentence, "seconds": flown}


def added(logs: Sequence[str], folder: Path) -> dict[str, Any]:
    """`add` until it stops: what each round did to every kind of channel and to the open loop, held out."""
    rounds: list[dict[str, Any]] = []
    vehicle, stopped = folder / "vehicle.toml", "rounds"
    for number in range(MAX_ROUNDS):
        try:
            made = alula.add_effect(list(logs), str(vehicle))
        except AlulaError as error:
            stopped = str(error)
            break
        vehicle = folder / f"vehicle.round{number}.toml"
        vehicle.unlink(missing_ok=True)
        made.write(vehicle)
        details = made.details
        rounds.append(
            {
                "report": msgspec.to_builtins(made.report),
                "channels": {kind: msgspec.to_builtins(error) for kind, error in details.channels.items()},
                "open_loop": [[msgspec.to_builtins(e) for e in errors] for errors in details.open_loop],
            }
        )
    diagnosis = alula.diagnose(list(logs), str(vehicle))
    return {"rounds": rounds, "stopped": stopped, "report": msgspec.to_builtins(diagnosis.report)}


def parser() -> argparse.ArgumentParser:
    """The options."""
    made = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    made.add_argument("--kind", nargs="+", choices=list(KINDS), default=["nothing", "single", "outside"])
    made.add_argument("--names", nargs="*", default=[], help="of the kinds' names, these alone")
    made.add_argument("--first", type=int, default=1, help="the first seed")
    made.add_argument("--count", type=int, default=1, help="seeds")
    made.add_argument("--kept", type=Path, default=Path("build/verdicts.jsonl"), help="where finished cases are kept")
    made.add_argument("--budget", type=float, default=float("inf"), help="seconds after which no case is begun")
    made.add_argument("--jobs", type=int, default=1, help="processes")
    made.add_argument("--fly-only", action="store_true", help="make the logs, answer nothing")
    made.add_argument("--table", action="store_true", help="write results/PAGE.md")
    made.add_argument("--page", default="verdicts", help="its name")
    made.add_argument("--state", type=Path, help="write the table and the wrong answers to this file instead")
    return made


def main() -> None:
    """Fly and answer the missing cases, and write the table."""
    options = parser().parse_args()
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    options.kept.parent.mkdir(parents=True, exist_ok=True)
    lines = options.kept.read_text().splitlines() if options.kept.exists() else []
    done = {result["key"]: result for result in map(json.loads, lines)}
    todo = [case for case in planned(options) if case.key not in done]
    began = time.monotonic()
    parts = [todo[first : first + TOGETHER] for first in range(0, len(todo), TOGETHER)]
    for _, _ in parallel_map(prepare, parts, jobs=options.jobs):
        pass
    for _, result in [] if options.fly_only else parallel_map(answer, todo, jobs=options.jobs):
        done[result["key"]] = result
        with options.kept.open("a") as file:
            print(json.dumps(result), file=file)
        print(f"{time.monotonic() - began:5.0f} s  {result['key']}: {spoken(result)}", flush=True)
        if time.monotonic() - began > options.budget:
            break
    results = [done[case.key] for case in planned(options) if case.key in done]
    if options.state:
        options.state.write_text(f"{table(results)}\n\n{wrong_answers(results)}\n")
    elif options.table:
        write_result(
            options.page, "The verdict on data that is not ours", f"{table(results)}\n\n{wrong_answers(results)}"
        )


def spoken(result: dict[str, Any]) -> str:
    """One line of what was said."""
    if "report" not in result:
        return str(result.get("error", result.get("refused", "lost")))[:150]
    report = result["report"]
    return f"{report['verdict']} " + ", ".join(f"{e['name']} {100 * e['confidence']:.0f} %" for e in report["effects"])


if __name__ == "__main__":
    main()
