"""Many effects at once: how many of five to nine hidden ones are named, and how many that are not there.

Sets are drawn at random from effects that flights can tell apart, each at 1.5 times the floor at its best channel;
flights and simulators are those of `diagnosis_planted_truth`. Fresh seeds: those below 100 are for calibration.

    python -m benchmarks.many_effects --first 101 --seeds 20
"""

from __future__ import annotations

import argparse
import itertools
import time

import numpy as np

from benchmarks.planted_cases import Case, fair, flown, names, vehicle
from benchmarks.provenance import write_result
from diagnosis.diagnose import diagnose_dataset
from dynamics.effects import CATALOGUE

STRENGTH, NOISE = 1.5, 1.0
LEAVE_OUT = ("time_delay", "wall_effect", "ground_effect", "motor_lag", "battery_sag")  # of a place, or of commands


def drawn(source: str, seed: int) -> tuple[str, ...]:
    """Five to nine effects, any two of which one kind of log tells apart."""
    random = np.random.default_rng(seed)
    count, chosen = int(random.integers(5, 10)), list[str]()
    for name in random.permutation([n for n in names(source) if n not in LEAVE_OUT]).tolist():
        if all(fair((name, other)) for other in chosen) and len(chosen) < count:
            chosen.append(name)
    return tuple(sorted(chosen))


def line(source: str, seed: int) -> tuple[str, tuple[int, int, int]]:
    """A table's line of one set, and (hidden, named, false)."""
    hidden = drawn(source, seed)
    data, uses = flown(Case("many", hidden, STRENGTH, NOISE, seed, source))
    began = time.process_time()
    answer = diagnose_dataset(data, vehicle(), CATALOGUE).diagnosis
    took = time.process_time() - began
    named = {e.name: e for e in answer.effects}
    errors = [
        abs(p.value / use.parameters[n] - 1)
        for use in uses
        if use.name in named and use.rotor == named[use.name].rotor
        for n, p in named[use.name].parameters.items()
        if p.std > 0 and use.parameters.get(n)
    ]
    missed, false = sorted(set(hidden) - set(named)), sorted(set(named) - set(hidden))
    worst = max((c.after / c.floor for c in answer.channels.values()), default=float("nan"))
    median = f"{100 * float(np.median(errors)):.1f} %" if errors else "-"
    row = [seed, len(hidden), ", ".join(missed) or "-", ", ".join(false) or "-", median, f"{worst:.2f}", f"{took:.0f}"]
    return "| " + " | ".join(map(str, row)) + " |", (len(hidden), len(hidden) - len(missed), len(false))


def main() -> None:
    """Fly, diagnose, and write the table."""
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("--source", choices=("compiled", "mock"), default="compiled")
    options.add_argument("--first", type=int, default=101)
    options.add_argument("--seeds", type=int, default=20)
    options.add_argument("--write", action="store_true", help="write the table to benchmarks/results")
    chosen = options.parse_args()
    lines, counts = [], []
    for seed in range(chosen.first, chosen.first + chosen.seeds):
        text, count = line(chosen.source, seed)
        print(text, flush=True)
        lines.append(text)
        counts.append(count)
    hidden, named, false = (sum(c) for c in zip(*counts, strict=True))
    head = "| seed | hidden | missed | false | parameter error, median | worst channel over floor | processor time, s |"
    summary = f"{named} of {hidden} effects named ({100 * named / hidden:.0f} %, goal 90 %), {false} false (goal 0)."
    table = "\n".join(itertools.chain([summary, "", head, "|" + " --- |" * 7], lines))
    if chosen.write:
        write_result("many_effects", "Many effects at once: are they named?", table)
    else:
        print(table)


if __name__ == "__main__":
    main()
