"""The diagnosis: how often its verdict is false, and its time."""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from statistics import median
from typing import Any

import msgspec
import numpy as np
from scipy.stats import beta

from benchmarks import mutated_flights
from benchmarks.measurement import ROOT, Page, options_of, own_command
from benchmarks.provenance import provenance
from benchmarks.verdict_cases import KINDS, NOTHING, Case, flies_our_campaign, prepare
from benchmarks.verdict_table import ALIKE, AT_FLOOR, SURE, as_gain, drifted, effects, fault_of, right, verdict, visible
from benchmarks.verdicts import answer, logs_of, spoken
from diagnosis.data.dataset import Dataset, make_dataset, read_dataset
from diagnosis.diagnose import diagnose_dataset
from dynamics.effects import CATALOGUE
from dynamics.vehicle import EffectUse, Vehicle
from dynamics.vehicle_file import read_vehicle
from fixtures.compiled_flights import compiled_flights
from vehicles import FOLDER

COUNTS = ROOT / "benchmarks" / "results" / "counts"
RUNS = COUNTS / "runs.md"
SHARES: Mapping[str, float] = {  # of the processor time
    "speeds": 0.1, "commands": 0.1, "true_file": 0.1, "campaign": 0.1, "estimator": 0.1,
    "add": 0.25, "mutated": 0.15, "many": 0.1,
}  # fmt: skip
TOGETHER = {  # flown, which costs little more time than one alone
    "speeds": 48, "commands": 48, "true_file": 48, "campaign": 1, "estimator": 24, "add": 32, "many": 20,
}  # fmt: skip
MIN_SHOWN = 1.01  # growth of a channel's error that counts as worse


class Count(msgspec.Struct, omit_defaults=True):
    """One case.

    seed: of the case, or number of the mutation.
    verdict: in one word; "refused", "traceback" or "lost" where there is none.
    false: effects that are not there, named in any verdict, or added.
    sure: those with 90 % of the resamples and more.
    fault: what is wrong, empty where nothing is.
    answer: in words, where something is wrong.
    took: processor time, s.
    revision: of the repository.
    hidden, named: effects that can show, and those of them that are named.
    steps, worse: of `add`, and those after which a kind of channel or the open loop was worse.
    at_floor: whether all channels are at the floor in the end.
    """

    seed: int
    verdict: str
    took: float
    revision: str
    name: str = ""
    false: int = 0
    sure: int = 0
    fault: str = ""
    answer: str = ""
    hidden: int = 0
    named: int = 0
    steps: int = 0
    worse: int = 0
    at_floor: bool = False


def read(kind: str) -> list[Count]:
    """The lines of a kind, sorted by seed."""
    file = COUNTS / f"{kind}.jsonl"
    lines = file.read_text().splitlines() if file.exists() else []
    return sorted((msgspec.json.decode(line, type=Count) for line in lines), key=lambda count: count.seed)


def run(kind: str, seed: int, revision: str) -> Count:
    """Fly, answer and count a case."""
    if kind == "mutated":
        return _of_mutation(mutated_flights.run(mutated_flights.Case(seed)), revision)
    case = _case(kind, seed)
    together = [case] if flies_our_campaign(case) else [_case(kind, s) for s in range(seed, seed + TOGETHER[kind])]
    if not (case.folder / "case.json").exists():
        prepare(together)
    result = answer(case)
    shutil.rmtree(case.folder)
    return _counted(result, revision)


def _case(kind: str, seed: int) -> Case:
    if kind in NOTHING:
        return Case("nothing", kind, seed)
    if kind == "many":
        return Case("many", "random", seed)
    return Case("add", KINDS["add"][seed % len(KINDS["add"])], seed)


def _of_mutation(outcome: mutated_flights.Outcome, revision: str) -> Count:
    sure, unsure = outcome.outcome == "sure falsehood", outcome.outcome == "unsure falsehood"
    fault = outcome.outcome if sure or unsure or outcome.outcome == "traceback" else ""
    refused = outcome.outcome in ("refused", "traceback")
    source = "commands" if outcome.commands else "speeds"
    words = f"{outcome.what} ({source}, hidden: {outcome.hidden}): {outcome.answer}" if fault else ""
    word = outcome.outcome if refused else outcome.answer.split(":")[0].split(",")[0]
    return Count(
        outcome.number, word, round(outcome.took, 1), revision, name=outcome.mutation, false=int(sure or unsure),
        sure=int(sure), fault=fault, answer=words[:400],
    )  # fmt: skip


def _counted(result: Mapping[str, Any], revision: str) -> Count:
    """The line of an answer of `benchmarks.verdicts`."""
    answered = "report" in result
    word = verdict(result) if answered or "refused" in result else "traceback" if "error" in result else "lost"
    steps = result.get("rounds", ())
    false = [e for e in effects(result) if not right(e, result["hidden"], rivals=True)]
    added = [e for step in steps for e in map(_as_effect, step["report"]["effects"])]
    wrong = {e["name"] for e in added if not right(e, result["hidden"], rivals=True)}
    hidden = visible(result) if answered and result["kind"] == "many" else []
    named = [n for n in hidden if any(right(e, {n: result["hidden"][n]}, rivals=True) for e in effects(result))]
    fault = _fault(result, steps)
    alarm = bool(as_gain(result)) and not result["hidden"]
    return Count(
        result["seed"], word, round(result.get("took", 0.0), 1), revision, name=result["name"],
        false=len({e["name"] for e in false} | wrong) + alarm,
        sure=len({e["name"] for e in false if e["confidence"] >= SURE}),
        fault=fault, answer=f"{', '.join(result['hidden'])} -> {spoken(dict(result))}"[:400] if fault else "",
        hidden=len(hidden), named=len(named), steps=len(steps), worse=sum(map(_is_worse, steps)),
        at_floor=answered and _is_at_floor(result["report"]),
    )  # fmt: skip


def _as_effect(key: str) -> dict[str, Any]:
    """An effect that was added, by its name in the model, with those that no flights tell from it."""
    name, _, rotor = key.removesuffix("]").partition("[")
    alike = sorted({other for group in ALIKE if name in group for other in group})
    return {"name": name, "rotor": int(rotor) if rotor else None, "ambiguous_with": alike}


def _fault(result: Mapping[str, Any], steps: Sequence[Mapping[str, Any]]) -> str:
    if steps and any(map(_is_worse, steps)):
        return "worse after a step"
    return fault_of(result)


def _is_worse(step: Mapping[str, Any]) -> bool:
    """Whether a step of `add` made a kind of channel or the open loop worse."""
    channel = any(c["after"] > MIN_SHOWN * c["before"] for c in step["channels"].values())
    return channel or drifted(*step["open_loop"])


def _is_at_floor(report: Mapping[str, Any]) -> bool:
    return all(c["after"] <= AT_FLOOR * c["floor"] for c in report["channels"].values() if c["floor"])


def interval(count: int, of: int) -> tuple[float, float]:
    """95 % interval of a share (Clopper and Pearson, 1934)."""
    low = float(beta.ppf(0.025, count, of - count + 1)) if count else 0.0
    return low, float(beta.ppf(0.975, count + 1, of - count)) if count < of else 1.0


def _row(title: str, some: Sequence[Count], is_counted: Callable[[Count], bool], goal: str) -> str:
    count = sum(map(is_counted, some))
    low, high = interval(count, len(some))
    return (
        f"| {title} | {count} of {len(some)} | {100 * count / len(some):.1f} % | {100 * low:.1f} to "
        f"{100 * high:.1f} % | {goal} |"
    )


def table(counts: Mapping[str, Sequence[Count]], revision: str = "") -> str:
    """All figures with their intervals, those of one revision alone or of some with commas, then every fault."""
    parts, alone = [figures(counts)], revision.split(",")
    answered = {kind: [c for c in some if c.revision in alone] for kind, some in counts.items()}
    if of_revision := {kind: some for kind, some in answered.items() if some}:
        parts += [f"## Answered by {revision} alone", figures(of_revision)]
    return "\n\n".join([*parts, "## Cases", _seeds(counts), "## Faults", "\n".join(_faults(counts))])


def figures(counts: Mapping[str, Sequence[Count]]) -> str:
    """The figures with their intervals."""
    lines = ["| | count | share | 95 % interval | goal |", "| --- | --- | --- | --- | --- |"]
    nothing = {kind: counts.get(kind, ()) for kind in NOTHING}
    nothing["all five"] = [count for some in nothing.values() for count in some]
    for kind, some in nothing.items():
        if some:
            lines += [
                _row(f"nothing hidden, {kind}: false alarms", some, lambda c: c.false > 0, "<= 0.5 %"),
                _row(f"nothing hidden, {kind}: explained", some, lambda c: c.verdict == "explained", ">= 97 %"),
                _row(f"nothing hidden, {kind}: unknown", some, lambda c: c.verdict == "unknown", ""),
            ]
    if adding := counts.get("add", ()):
        inside = [c for c in adding if c.name in ("single", "random")]
        lines.append(_row(f"`add` ({sum(c.steps for c in adding)} steps): worse", adding, lambda c: c.worse > 0, "0"))
        lines.append(_row("`add`: an effect that is not there", adding, lambda c: c.false > 0, ""))
        lines.append(_row("`add`: at the floor, of the catalogue", inside, lambda c: c.at_floor, "all"))
    if mutated := counts.get("mutated", ()):
        lines.append(_row("mutated logs: sure falsehoods", mutated, lambda c: c.sure > 0, "0"))
        lines.append(_row("mutated logs: unsure falsehoods", mutated, lambda c: c.false > c.sure, ""))
        lines.append(_row("mutated logs: refused", mutated, lambda c: c.verdict == "refused", ""))
    if many := counts.get("many", ()):
        hidden, named = sum(c.hidden for c in many), sum(c.named for c in many)
        low, high = interval(named, hidden)
        shown = f"{100 * named / hidden:.1f} % | {100 * low:.1f} to {100 * high:.1f} %"
        lines.append(f"| {len(many)} random sets: effects named | {named} of {hidden} | {shown} | >= 90 % |")
        lines.append(_row("random sets with an effect that is not there", many, lambda c: c.false > 0, "0"))
    everything = [count for some in counts.values() for count in some]
    lines.append(_row("all: sure and false", everything, lambda c: c.sure > 0, "<= 0.5 %"))
    lines.append(_row("all: tracebacks", everything, lambda c: c.verdict == "traceback", "0"))
    return "\n".join(lines)


def _seeds(counts: Mapping[str, Sequence[Count]]) -> str:
    """Of each kind seeds, revisions and time."""
    lines = ["| kind | cases | seeds | revisions | processor time, median, s |", "| --- | --- | --- | --- | --- |"]
    for kind, some in counts.items():
        revisions = ", ".join(sorted({c.revision for c in some}))
        span = f"{some[0].seed} to {some[-1].seed}"
        lines.append(f"| {kind} | {len(some)} | {span} | {revisions} | {np.median([c.took for c in some]):.1f} |")
    return "\n".join(lines)


def _faults(counts: Mapping[str, Sequence[Count]]) -> Iterable[str]:
    for kind, some in counts.items():
        for c in some:
            if c.fault:
                yield f"- **{c.fault}** {kind}-{c.name}-{c.seed}: {c.answer}"


def parser() -> argparse.ArgumentParser:
    """The options."""
    made = options_of(counts.__doc__)
    made.add_argument("--first", type=int, default=2000, help="the first seed of each kind")
    made.add_argument("--budget", type=float, default=600, help="s after which no case is begun")
    made.add_argument(
        "--shares", nargs="*", default=[], metavar="KIND=SHARE", help="of the time, instead of usual ones"
    )
    made.add_argument(
        "--revision",
        default="",
        help="of the repository, for the lines; with a table that (or those, with commas) of which is shown alone, too",
    )
    return made


def counts(words: Sequence[str]) -> Page:
    """How often is the verdict false? Counts on fresh seeds, one line a case, so that runs of any time merge.

    Kinds are flown and answered by `benchmarks.verdicts` (nothing hidden, five ways; `add` until it stops; many
    effects) and `benchmarks.mutated_flights`. Processor time is shared out by `--shares`; seeds of a kind follow one
    another, and a case that has a line is not repeated. Lines stay in results/counts/KIND.jsonl with the revision that
    answered.

        python -m benchmarks diagnosis counts --first 2000 --budget 3600 --revision $(git rev-parse --short HEAD)
        python -m benchmarks diagnosis counts --budget 0 --revision $(git rev-parse --short HEAD)
    """
    options = parser().parse_args(words)
    shares = {kind: float(share) for kind, _, share in (text.partition("=") for text in options.shares)} or dict(SHARES)
    COUNTS.mkdir(parents=True, exist_ok=True)
    if options.budget:
        with RUNS.open("a") as file:
            print(f"- {options.revision}: {provenance()}", file=file)
    done = {kind: {c.seed for c in read(kind)} for kind in shares}
    spent, following, began = dict.fromkeys(shares, 0.0), dict.fromkeys(shares, options.first), time.monotonic()
    while time.monotonic() - began < options.budget:
        kind = min(shares, key=lambda k: spent[k] / shares[k])
        while following[kind] in done[kind]:
            following[kind] += 1
        started = time.process_time()
        count = run(kind, following[kind], options.revision)
        spent[kind] += time.process_time() - started
        following[kind] += 1
        with (COUNTS / f"{kind}.jsonl").open("a") as file:
            print(msgspec.json.encode(count).decode(), file=file)
        print(f"{time.monotonic() - began:5.0f} s  {kind}-{count.seed} {count.verdict} {count.fault}", flush=True)
    answers = {kind: some for kind in SHARES if (some := read(kind))}
    runs = RUNS.read_text() if RUNS.exists() else ""
    body = f"{table(answers, options.revision)}\n\n## Runs\n\n{runs}"
    return Page("counts", "How often the verdict is false, on fresh seeds", body)


REPEATS = 3
ENVIRONMENT = {**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}  # as the command has it
DRAG = [EffectUse("rotor_drag", {"coefficient": 2.2e-5})]
PX4 = ROOT / "tests" / "data" / "px4_sih_flights"


def compiled(uses: list[EffectUse], sets: int) -> tuple[Dataset, Vehicle]:
    """Sets of nine flights by measured speeds at 100 Hz."""
    vehicle = read_vehicle(FOLDER / "arpl_250g.toml")
    flights = [
        flight
        for seed in range(sets)
        for flight in compiled_flights(vehicle, uses, catalogue=CATALOGUE, seed=60 + seed, noise=1.0)
    ]
    return make_dataset(flights, vehicle), vehicle


def px4() -> tuple[Dataset, Vehicle]:
    """Two of PX4's flights, by commands with its estimator's pose at 250 Hz."""
    vehicle = read_vehicle(FOLDER / "px4_sih.toml")
    logs = [PX4 / f"{name}.ulg.gz" for name in ("drag2_1_circle", "drag2_4_lemniscate")]
    return read_dataset(logs, vehicle), vehicle


def outside(case: Case) -> tuple[Dataset, Vehicle]:
    """A case of `benchmarks.verdicts`."""
    prepare([case])
    vehicle = read_vehicle(case.folder / "vehicle.toml")
    return read_dataset(logs_of(case.folder), vehicle), vehicle


TIMED: Mapping[str, tuple[Callable[[], tuple[Dataset, Vehicle]], float | None]] = {  # and the goal, s for 100 s
    "rotor drag, nine flights": (partial(compiled, DRAG, 1), 2.5),
    "nothing, nine flights": (partial(compiled, [], 1), 2.5),
    "rotor drag, 54 flights": (partial(compiled, DRAG, 6), 2.5),
    "nine effects, ten flights": (partial(outside, Case("many", "nine", 1)), 3.7),  # 15 s for ten flights
    "inertia, outside simulator": (partial(outside, Case("single", "inertia", 1)), 2.5),
    "slung load, outside simulator": (partial(outside, Case("single", "slung_load", 1)), 2.5),
    "nothing, outside simulator, commands": (partial(outside, Case("nothing", "commands", 1)), None),
    "nothing, outside simulator, estimator's pose": (partial(outside, Case("nothing", "estimator", 1)), None),
    "drag, PX4's own simulation, two flights": (px4, None),
}


def timed(name: str) -> str:
    """A kind's line of the table."""
    made, goal = TIMED[name]
    data, vehicle = made()
    taken = []
    for _ in range(1 + REPEATS):
        began = time.process_time()
        diagnose_dataset(data, vehicle, CATALOGUE)
        taken.append(time.process_time() - began)
    flown = sum(s.duration for s in data.everything)
    one, first, seconds = data.fitted[0], taken[0], median(taken[1:])
    rotors = "speeds" if one.rotor_source == "measured" else "commands"
    cells = [name, rotors, f"{one.rate:.0f}", f"{flown:.0f}", f"{first:.1f}", f"{seconds:.1f}"]
    cells += [f"{100 * each / flown:.2f}" for each in (first, seconds)]
    return "| " + " | ".join([*cells, "-" if goal is None else f"{goal:g}"]) + " |"


def speed(words: Sequence[str]) -> Page | None:
    """Time of a diagnosis, by kind of flight: processor seconds for 100 s of it, one thread a library.

    Flights by speeds and by commands, slow and fast, of our own simulator, of one that is not ours and of PX4. Each
    kind has a process of its own: the first diagnosis there builds the models, three more find them built. Reading
    files is not counted. The flights of `benchmarks.verdicts` are flown first where they are not kept.

        python -m benchmarks diagnosis speed [--kind NAME ..]
    """
    options = options_of(speed.__doc__)
    options.add_argument("--kind", nargs="+", choices=TIMED, default=list(TIMED), help="kinds to time")
    options.add_argument("--line", action="store_true", help="print the one kind's line of the table")
    chosen = options.parse_args(words)
    if chosen.line:
        print(timed(chosen.kind[0]))
        return None
    own = own_command("diagnosis", "speed", "--line", "--kind")
    lines = [
        "Processor seconds of the first diagnosis in a process and the median of three more.",
        "",
        "| hidden, flights | rotors | Hz | s flown | first | median | first, for 100 s | median, for 100 s | goal |",
        "| --- | --- | --- | --- | --- | --- | --- | --- | --- |",
        *(subprocess.check_output([*own, kind], env=ENVIRONMENT, text=True).strip() for kind in chosen.kind),
    ]
    return Page("diagnosis_speed", "Time of a diagnosis", "\n".join(lines))
