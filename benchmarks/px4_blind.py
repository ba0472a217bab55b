"""Is a change of PX4's simulated quadrotor named from logs as real PX4 writes them? Writes results/px4_blind.md.

Two or three flights a set, of `vehicles/px4_sih.toml` with one number changed or none, by the outside simulator that
shares no line with `dynamics`: the controllers see PX4's estimate and gyro with their errors, logs hold commands at 250
Hz. Logs and finished answers are kept, so that a run that was stopped resumes.

    python -m benchmarks.px4_blind --first 100 --count 3 --table
"""

from __future__ import annotations

import argparse
import json
import os
import time
import traceback
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

import alula
from benchmarks.provenance import write_result
from dynamics.errors import AlulaError
from dynamics.vehicle_file import read_vehicle
from fixtures.outside_sih import HIDDEN_CHANGES, PATHS, SihFlight, change, fly_sih, sih_flight
from vehicles import FOLDER

FLOWN, VEHICLE = Path("build/px4_blind"), FOLDER / "px4_sih.toml"
DURATION = 34.0  # s of each flight
RIGHT = ("right", "declared")
GOAL_VALUE = 0.05
Result = dict[str, Any]


def prepare(seed: int, names: Sequence[str]) -> None:
    """Fly the sets of a seed that have not been flown, side by side."""
    vehicle, flights, folders = read_vehicle(VEHICLE), list[SihFlight](), list[Path]()
    for name in names:
        folder = folder_of(name, seed)
        if (folder / "hidden.json").exists():
            continue
        random = np.random.default_rng([seed, *name.encode()])
        hidden, count = change(name, random), int(random.integers(2, 4))
        for path in random.permutation(PATHS)[:count]:
            flights.append(sih_flight(str(path), vehicle, hidden, DURATION, int(random.integers(2**31))))
            folders.append(folder / f"{str(path).partition(':')[0]}.ulg")
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "hidden.part").write_text(json.dumps(hidden))
    for file, log in zip(folders, fly_sih(flights) if flights else (), strict=True):
        if log is not None:
            file.write_bytes(log)
    for folder in {file.parent for file in folders}:
        (folder / "hidden.part").rename(folder / "hidden.json")


def folder_of(name: str, seed: int) -> Path:
    """Of a set's logs and what they hide."""
    return FLOWN / f"{name.replace(' ', '_')}-{seed}"


def answer(name: str, seed: int) -> Result:
    """Answer of the diagnosis to a set."""
    folder = folder_of(name, seed)
    result: Result = {"key": f"{name}-{seed}", "name": name, "seed": seed}
    result["hidden"] = json.loads((folder / "hidden.json").read_text())
    began = time.process_time()
    try:
        diagnosis = alula.diagnose(sorted(str(log) for log in folder.glob("*.ulg")), str(VEHICLE))
        result["report"] = msgspec.to_builtins(diagnosis.report)
        result["seconds"] = sum(segment.duration for segment in diagnosis.dataset.everything)
    except AlulaError as error:
        result["refused"] = str(error)
    except Exception as error:  # a traceback is a result, too, and the worst one
        result["error"] = f"{type(error).__name__}: {error}; {traceback.format_exc(limit=-3)}"[:600]
    result["took"] = time.process_time() - began
    return result


def outcome(result: Result) -> str:
    """One word: right, declared (among look-alikes), partly (beside an `unknown`), false, silent, unknown, none."""
    if "report" not in result:
        return "none"
    report, hidden = result["report"], set(result["hidden"])
    named = [{e["name"]} for e in report["effects"]]
    declared = [{e["name"], *e["ambiguous_with"]} for e in report["effects"]]
    as_gain = set((report["command_gain"] or {}).get("look_alikes", ()))
    if any(not names & hidden for names in declared) or (as_gain and not hidden & as_gain and not named):
        return "false"
    if named and report["verdict"] == "unknown":
        return "partly"
    if report["verdict"] == "unknown":
        return "unknown"
    if not hidden:
        return "right"
    if named and all(names & hidden for names in named):
        return "right"
    return "declared" if named or as_gain & hidden else "silent"


def value_errors(result: Result) -> list[float]:
    """Relative error of each hidden parameter under its own name."""
    made = []
    for effect in result["report"]["effects"] if "report" in result else ():
        for name, p in effect["parameters"].items():
            if name in result["hidden"].get(effect["name"], {}):
                truth = result["hidden"][effect["name"]][name]
                made.append(abs(p["value"] - truth) / abs(truth))
    return made


def spoken(result: Result) -> str:
    """Answer of the diagnosis, in short."""
    if "report" not in result:
        return str(result.get("error", result.get("refused")))[:150]
    report = result["report"]
    named = "; ".join(f"{e['name']} {_values(e)}{_rivals(e['ambiguous_with'])}" for e in report["effects"])
    gain = report["command_gain"] or {"value": 1.0, "std": 0.0, "look_alikes": ()}
    text = f"{report['verdict']}: {named or '-'}; gain {gain['value']:.3f} ± {1.96 * gain['std']:.3f}"
    text += _rivals(gain["look_alikes"])
    refused = ", ".join(f"{r['name']} {r['reason']}" for r in report["refused"])
    return text + (f" [refused: {refused}]" if refused else "")


def _values(effect: dict[str, Any]) -> str:
    values = ", ".join(f"{p['value']:.4g}" for p in effect["parameters"].values())
    return f"{values} ({100 * effect['confidence']:.0f} %)"


def _rivals(names: Sequence[str]) -> str:
    return f" or {' or '.join(names)}" if names else ""


def table(results: Sequence[Result]) -> str:
    """Counts, and every answer."""
    kinds = {r["key"]: outcome(r) for r in results}
    hidden, nothing = [r for r in results if r["hidden"]], [r for r in results if not r["hidden"]]
    errors = [error for r in hidden if kinds[r["key"]] in RIGHT for error in value_errors(r)]
    took = [100 * r["took"] / r["seconds"] for r in results if "seconds" in r]
    good = sum(kinds[r["key"]] in RIGHT for r in hidden)
    counts = Counter(kinds[r["key"]] for r in hidden)
    false = sum(kind == "false" for kind in kinds.values())
    lines = [
        "| | measured | goal |", "| --- | --- | --- |",
        f"| changes that are named or declared | {good} of {len(hidden)} | >= 90 % |",
        *(f"| of these answers, {kind} | {count} | |" for kind, count in counts.most_common()),
        f"| nothing hidden: explained | {sum(kinds[r['key']] == 'right' for r in nothing)} of {len(nothing)} | all |",
        f"| false | {false} of {len(results)} | 0 |",
        f"| values within 5 % of the truth | {sum(e <= GOAL_VALUE for e in errors)} of {len(errors)} | all |",
        f"| processor time for 100 s of flight, median, greatest | {np.median(took):.1f}, {max(took):.1f} s | |",
        "", "| hidden | seed | answer | what was said |", "| --- | --- | --- | --- |",
    ]  # fmt: skip
    for r in sorted(results, key=lambda r: (list(HIDDEN_CHANGES).index(r["name"]), r["seed"])):
        truth = " ".join(f"{value:.4g}" for values in r["hidden"].values() for value in list(values.values())[:1])
        lines.append(f"| {r['name']}{f': {truth}' if truth else ''} | {r['seed']} | {kinds[r['key']]} | {spoken(r)} |")
    return "\n".join(lines)


def main() -> None:
    """Fly and answer the missing sets, and write the table."""
    made = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    made.add_argument("--first", type=int, default=1, help="the first seed")
    made.add_argument("--count", type=int, default=1, help="seeds")
    made.add_argument("--names", nargs="*", default=list(HIDDEN_CHANGES), choices=list(HIDDEN_CHANGES), help="changes")
    made.add_argument("--kept", type=Path, default=Path("build/px4_blind.jsonl"), help="where answers are kept")
    made.add_argument("--table", action="store_true", help="write results/px4_blind.md")
    options = made.parse_args()
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    options.kept.parent.mkdir(parents=True, exist_ok=True)
    lines = options.kept.read_text().splitlines() if options.kept.exists() else []
    done: dict[str, Result] = {result["key"]: result for result in map(json.loads, lines)}
    for seed in range(options.first, options.first + options.count):
        prepare(seed, options.names)
        for name in options.names:
            if f"{name}-{seed}" in done:
                continue
            result = done[f"{name}-{seed}"] = answer(name, seed)
            with options.kept.open("a") as file:
                print(json.dumps(result), file=file)
            print(f"{result['took']:5.0f} s  {result['key']}: {outcome(result)}; {spoken(result)}", flush=True)
    seeds = range(options.first, options.first + options.count)
    results = [r for r in done.values() if r["seed"] in seeds and r["name"] in options.names]
    if options.table:
        write_result("px4_blind", "Blind flights as real PX4 logs them", table(results))


if __name__ == "__main__":
    main()
