"""Mutated logs: an answer, or exit 3 with the reason; never a traceback, never a sure falsehood.

Four flights of about 12 s that hide nothing or one effect, logging speeds or commands, are mutated as in
`fixtures.mutated_flights`, written as CSV files and diagnosed as a user would. A falsehood is an effect in the answer
that is neither hidden nor made true by the mutation, nor declared to look like one that is; it is sure at 90 % of the
resamples and more. Finished cases are kept in build/, so that a run that was stopped resumes.

    python -m benchmarks.mutated_flights --first 0 --cases 100 --table
"""

from __future__ import annotations

import argparse
import json
import re
import tempfile
import time
import traceback
import warnings
from collections import Counter
from collections.abc import Mapping, Sequence
from functools import lru_cache
from pathlib import Path

import msgspec
import numpy as np
from rich.progress import track

import alula
from benchmarks.provenance import write_result
from dynamics.effects import CATALOGUE
from dynamics.errors import AlulaError, RequestError
from dynamics.vehicle import EffectUse, Vehicle
from dynamics.vehicle_file import read_vehicle, write_vehicle
from fixtures.compiled_flights import compiled_flights
from fixtures.mutated_flights import FLOWN, MUTATIONS, USUAL, Mutated
from flights import Flight
from flights.parallel import parallel_map
from vehicles import FOLDER

CASES_FILE = Path("build/mutated_flights.jsonl")
SURE = 0.9  # of the resamples
HIDDEN: tuple[EffectUse | None, ...] = (
    None,
    None,
    EffectUse("rotor_drag", {"coefficient": 3e-5}),
    EffectUse("inertia", {"ratio_x": 1.15, "ratio_y": 1.15, "ratio_z": 1.0}),
    EffectUse("centre_of_mass", {"x": 0.004, "y": -0.002, "z": 0.0}),
)
ALIKE = (
    {"thrust_constant", "mass", "torque_constant", "inertia", "battery_sag"},
    {"weak_rotor", "centre_of_mass", "rotor_speed_fault", "rotor_cant"},
    {"rotor_drag", "linear_drag", "parasitic_drag", "blade_flapping"},
    {"imu_lever_arm", "centre_of_mass", "pose_lever_arm"},
    {"time_delay", "attitude_delay"},
)
OUTCOMES = ("refused", "explained", "unknown, none named", "right", "unsure falsehood", "sure falsehood", "traceback")


class Case(msgspec.Struct, frozen=True):
    """One mutation of one set of flights."""

    number: int

    @property
    def mutation(self) -> str:
        """Name of the mutation."""
        return list(MUTATIONS)[self.number % len(MUTATIONS)]

    @property
    def random(self) -> np.random.Generator:
        """Numbers that depend on the case alone."""
        return np.random.default_rng([2026, self.number])


class Outcome(msgspec.Struct):
    """Outcome of a case.

    what: the mutation in words. hidden: the effect beneath it. answer: the answer or the refusal. took: s.
    """

    number: int
    mutation: str
    what: str
    commands: bool
    hidden: str
    outcome: str
    answer: str
    took: float


def run(case: Case) -> Outcome:
    """Fly, mutate, diagnose."""
    random = case.random
    use, commands = HIDDEN[int(random.integers(len(HIDDEN)))], bool(random.random() < 0.35)
    vehicle = read_vehicle(FOLDER / "arpl_250g.toml")
    seed = 100 + int(random.integers(4))
    flown = _flights(use.name if use else "", commands, seed, tuple(FLOWN.get(case.mutation, USUAL)))
    hidden, began = use.name if use else "nothing", time.process_time()
    try:
        mutated = MUTATIONS[case.mutation](flown, vehicle, random)
    except RequestError as error:  # a vehicle file that is refused when it is read
        return Outcome(case.number, case.mutation, "", commands, hidden, "refused", str(error), 0.0)
    outcome, answer = _answer(mutated, use.name if use else "")
    took = time.process_time() - began
    return Outcome(case.number, case.mutation, mutated.what, commands, hidden, outcome, answer, took)


@lru_cache(maxsize=8)
def _flights(hidden: str, commands: bool, seed: int, manoeuvres: tuple[str, ...]) -> list[Flight]:
    vehicle: Vehicle = read_vehicle(FOLDER / "arpl_250g.toml")
    uses = [use for use in HIDDEN if use is not None and use.name == hidden]
    return compiled_flights(vehicle, uses, catalogue=CATALOGUE, seed=seed, commands=commands, manoeuvres=manoeuvres)


def _answer(mutated: Mutated, hidden: str) -> tuple[str, str]:
    """Outcome and words, as of `alula diagnose` on the files."""
    with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        file = Path(folder) / "vehicle.toml"
        write_vehicle(mutated.vehicle, file)
        logs = [f.to_csv(Path(folder) / f"flight_{i}.csv") for i, f in enumerate(mutated.flights)]
        try:
            report = alula.diagnose(logs, file).report
        except AlulaError as error:
            return "refused", str(error).replace(folder, "")
        except Exception as error:  # what must never happen
            last = traceback.extract_tb(error.__traceback__)[-1]
            return "traceback", f"{type(error).__name__}: {error} ({Path(last.filename).name}:{last.lineno})"
    named = [(e.name, e.confidence, tuple(e.ambiguous_with)) for e in report.effects]
    words = f"{report.verdict}: " + ", ".join(f"{name} {100 * share:.0f} %" for name, share, _ in named)
    if not named:
        return ("explained" if report.verdict == "explained" else "unknown, none named"), words
    false = [(name, share) for name, share, alike in named if not _is_true({name, *alike}, {*mutated.true, hidden})]
    if not false:
        return "right", words
    return ("sure falsehood" if max(share for _, share in false) >= SURE else "unsure falsehood"), words


def _is_true(names: set[str], true: set[str]) -> bool:
    """Whether one of the names is true, or cannot be told from what is."""
    return bool(names & true) or any(names & group and true & group for group in ALIKE)


def table(outcomes: Sequence[Outcome]) -> str:
    """How often each mutation ended in what, and every traceback and falsehood in full."""
    lines = [f"{len(outcomes)} mutated sets of flights.", "", "| mutation | cases | " + " | ".join(OUTCOMES) + " |"]
    lines.append("| --- |" + " --- |" * (len(OUTCOMES) + 1))
    by_mutation: Mapping[str, list[Outcome]] = {n: [o for o in outcomes if o.mutation == n] for n in MUTATIONS}
    for name, some in [*by_mutation.items(), ("all", list(outcomes))]:
        counts = Counter(o.outcome for o in some)
        lines.append(f"| {name} | {len(some)} | " + " | ".join(str(counts[o] or "") for o in OUTCOMES) + " |")
    for kind in ("traceback", "sure falsehood", "unsure falsehood"):
        chosen = [o for o in outcomes if o.outcome == kind]
        lines += ["", f"**{kind}s** ({len(chosen)})", ""] if chosen else []
        for o in chosen:
            source = "commands" if o.commands else "speeds"
            lines.append(f"- {o.number}: {o.what} ({source}, hidden: {o.hidden}): {o.answer}")
    refusals = Counter(_reason(o.answer) for o in outcomes if o.outcome == "refused")
    lines += ["", "Reasons of refusals, the most frequent:", ""]
    lines += [f"- {count} x {reason}" for reason, count in refusals.most_common(12)]
    return "\n".join(lines)


def _reason(answer: str) -> str:
    """The first words of a refusal without files and numbers."""
    without_files = re.sub(r"^(/?flight_\d\.csv(, )?)+:? ?", "", answer)
    return re.sub(r"-?\d[\d.e+]*", "N", without_files)[:80]


def parser() -> argparse.ArgumentParser:
    """The options."""
    made = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    made.add_argument("--first", type=int, default=0, help="number of the first case")
    made.add_argument("--cases", type=int, default=100)
    made.add_argument("--mutations", nargs="*", default=[], choices=list(MUTATIONS), help="these alone")
    made.add_argument("--jobs", type=int, default=1)
    made.add_argument("--kept", type=Path, default=CASES_FILE, help="where finished cases are kept")
    made.add_argument("--table", action="store_true", help="write the table")
    return made


def main() -> None:
    """Run the missing cases, and write the table if requested."""
    options = parser().parse_args()
    options.kept.parent.mkdir(exist_ok=True)
    lines = options.kept.read_text().splitlines() if options.kept.exists() else []
    done = {o.number: o for o in (msgspec.convert(json.loads(line), Outcome) for line in lines)}
    numbered = [Case(n) for n in range(options.first, options.first + options.cases)]
    planned = [case for case in numbered if not options.mutations or case.mutation in options.mutations]
    todo = [case for case in planned if case.number not in done]
    with options.kept.open("a") as file:
        for _, outcome in track(parallel_map(run, todo, jobs=options.jobs), total=len(todo)):
            done[outcome.number] = outcome
            print(msgspec.json.encode(outcome).decode(), file=file, flush=True)
    outcomes = [done[case.number] for case in planned]
    if options.table:
        write_result("mutated_flights", "Mutated logs: what is said of them", table(outcomes))
    else:
        print(table(outcomes))


if __name__ == "__main__":
    main()
