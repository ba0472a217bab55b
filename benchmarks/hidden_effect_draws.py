"""Random hidden effects and the command line alone: the acceptance tests' draws with seeds that nobody chose.

Each draw hides an effect of the whole catalogue, strong or very strong, with usual or threefold noise; one draw of each
seed hides nothing. A fault is an error or a worse model, a miss is a goal that was not reached.

    python -m benchmarks.hidden_effect_draws [--seeds 2] [--first SEED]
"""

from __future__ import annotations

import argparse
import secrets
import tempfile
from pathlib import Path

from benchmarks.provenance import write_result
from fixtures.hidden_effect import Draw, try_command_line, yardstick

DRAWS = 3  # of a seed, as in tests/acceptance


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=2)
    parser.add_argument("--first", type=int, default=None, help="a random number by default")
    arguments = parser.parse_args()
    first = secrets.randbelow(100_000) if arguments.first is None else arguments.first
    rows = ["| seed | draw | outcome |", "| --- | --- | --- |"]
    faults = misses = count = 0
    for seed in range(first, first + arguments.seeds):
        measure = yardstick(seed)
        for draw in (Draw("", 0.0, 1.0, seed), *(Draw.random(seed, number) for number in range(DRAWS))):
            with tempfile.TemporaryDirectory() as folder:
                outcome = try_command_line(draw, measure, Path(folder))
            rows.append(f"| {seed} | {draw.effect or 'nothing'} | {str(outcome).replace('|', '/')} |")
            faults, misses, count = faults + bool(outcome.faults), misses + bool(outcome.misses), count + 1
    text = f"{count} draws of {arguments.seeds} seeds from {first} on: {faults} with faults, {misses} with misses.\n\n"
    write_result("hidden_effect_draws", "Random hidden effects, by the command line alone", text + "\n".join(rows))


if __name__ == "__main__":
    main()
