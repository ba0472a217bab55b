"""Fuzzing for hours, with rising seeds: python -m tests.fuzz --hours 8

Rounds go on where the last campaign in the folder ended. A find is printed with its place and what repeats it, and its
input is put into the folder; further finds of the same place are counted. Ends with 1 where there was one.
"""

from __future__ import annotations

import argparse
import random
import shutil
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

from tests.fuzz import sanitized
from tests.fuzz.campaign import Campaign, Find, fuzz, round_of
from tests.fuzz.targets import GROUPS, targets_of
from tests.fuzz.test_kernels import CALLS, LARGER, PROGRAMS
from tests.fuzz.worker import made

ROOT = Path(__file__).parents[2]
NEXT = "next_round"


def main() -> None:
    """Fuzz until the time is over, or read one input again."""
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz", description=__doc__)
    parser.add_argument("--hours", type=float, default=8.0)
    parser.add_argument("--rounds", type=int, help="end after so many rounds instead")
    parser.add_argument("--target", help="GROUP:TARGET alone, such as logs:ulog")
    parser.add_argument("--number", type=int, help="with --target: this input alone")
    parser.add_argument("--out", type=Path, default=ROOT / "build" / "fuzz")
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    if arguments.number is not None:
        group, _, name = arguments.target.partition(":")
        finds = list(fuzz(group, {name: range(arguments.number, arguments.number + 1)}, Campaign()))
        print(*finds, sep="\n\n")
        sys.exit(bool(finds))
    marker = arguments.out / NEXT
    number = int(marker.read_text()) if marker.is_file() else 1  # round 0 is that of the tests
    end, last = time.monotonic() + 3600 * arguments.hours, arguments.rounds and number + arguments.rounds
    places, executions = Counter[str](), Counter[str]()
    with tempfile.TemporaryDirectory(prefix="alula-fuzz-") as folder:
        programs = {} if arguments.target else _programs(Path(folder))
        while time.monotonic() < end and number != last:
            _readers(number, arguments.target, arguments.out, places, executions)
            _kernels(number, programs, places, executions)
            number += 1
            marker.write_text(str(number))
            total = sum(executions.values())
            print(
                f"round {number - 1}: {total} executions, {sum(places.values())} finds of {len(places)} places",
                flush=True,
            )
    for target, count in sorted(executions.items()):
        print(f"{count:>10} {target}")
    sys.exit(bool(places))


def _readers(number: int, only: str | None, out: Path, places: Counter[str], executions: Counter[str]) -> None:
    group_of, _, target = (only or "").partition(":")
    for group in [group_of] if only else GROUPS:
        plan = {name: numbers for name, numbers in round_of(group, number).items() if not only or name == target}
        campaign = Campaign()
        for find in fuzz(group, plan, campaign):
            places[f"{find.target} {find.place}"] += 1
            if places[f"{find.target} {find.place}"] == 1:
                _keep(group, find, out)
        executions.update({f"{group}:{name}": count for name, count in campaign.executions.items()})


def _keep(group: str, find: Find, out: Path) -> None:
    """Print a find, and put its input into the folder."""
    print(f"\n{find}", flush=True)
    if not find.number.isdecimal():
        return
    print(f"    python -m tests.fuzz --target {group}:{find.target} --number {find.number}", flush=True)
    target = targets_of(group)[find.target]
    place = out / find.target / find.number
    shutil.rmtree(place, ignore_errors=True)
    place.mkdir(parents=True)
    with tempfile.TemporaryDirectory() as folder:
        path = target.assemble(made(target, target.seeds(Path(folder)), int(find.number)), place)
    print(f"    {path}", flush=True)


def _programs(folder: Path) -> dict[str, tuple[Path, bytes]]:
    if reason := sanitized.why_not():
        print(f"kernels are left out: {reason}")
        return {}
    programs = {}
    for order, (name, make) in enumerate({**PROGRAMS, **LARGER}.items()):
        (folder / str(order)).mkdir()
        programs[name] = make(folder / str(order))
    return programs


def _kernels(
    number: int, programs: dict[str, tuple[Path, bytes]], places: Counter[str], executions: Counter[str]
) -> None:
    """Calls of every kernel; a find names the seed, which repeats it."""
    for name, (program, content) in programs.items():
        seed = random.Random(number).randrange(1 << 40)
        done = sanitized.run(program, content, seed, CALLS)
        executions[f"kernel:{name}, calls"] += CALLS
        if done.returncode:
            places[f"{name} {done.stderr[:200]!r}"] += 1
            print(f"\n{name}, seed {seed}, {CALLS} calls:\n{done.stderr.decode()[:3000]}", flush=True)


if __name__ == "__main__":
    main()
