"""The diagnosis: its time, and what adding its answers is worth. `benchmarks.verdict` judges them."""

from __future__ import annotations

import argparse
import math
import os
import subprocess
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from statistics import median
from typing import Any

import alula
from benchmarks.measurement import ROOT, Page, Result, measured, options_of, own_command
from benchmarks.verdict.cases import Case, planned, read_sets
from benchmarks.verdict.posing import ALIKE, LostFlightsError, Posed, pose
from benchmarks.verdict.scoring import NAMES
from diagnosis.by_likelihood import noise_of
from diagnosis.data.dataset import Dataset, make_dataset, read_dataset
from diagnosis.diagnose import diagnose_dataset
from diagnosis.estimation.held_out import HeldOut
from dynamics.effects import CATALOGUE
from dynamics.errors import AlulaError
from dynamics.vehicle import EffectUse, Vehicle
from dynamics.vehicle_file import read_vehicle
from fixtures.campaign_logs import campaign_logs
from fixtures.compiled_flights import compiled_flights
from fixtures.outside_draws import Draw, written
from flights import Flight
from vehicles import FOLDER

REPEATS = 3
SETS = ("planted", "captured", "estimated", "px4_like", "many", "nothing")
MAX_STEPS = 6
INTERVAL = 1.96  # standard deviations of 95 %
RISEN = 1.02  # factor on an error
NEAR = 1.1  # factor on the floor
HELD_OUT = "aside_*"  # names of the flights on which both versions are judged
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


def outside(draw: Draw) -> tuple[Dataset, Vehicle]:
    """A campaign of the outside simulator."""
    with tempfile.TemporaryDirectory() as folder:
        logs = written(draw, Path(folder))
        vehicle = read_vehicle(Path(folder) / "vehicle.toml")
        return read_dataset(logs, vehicle), vehicle


def campaign() -> tuple[Dataset, Vehicle]:
    """Ten flights of a campaign with its nine effects."""
    vehicle = read_vehicle(FOLDER / "arpl_250g.toml")
    with tempfile.TemporaryDirectory() as folder:
        logs = []
        for name, content in campaign_logs(nine=True, seed=1).items():
            logs.append(Path(folder) / name)
            logs[-1].write_bytes(content)
        return read_dataset(logs, vehicle), vehicle


TIMED: Mapping[str, tuple[Callable[[], tuple[Dataset, Vehicle]], float | None]] = {  # and the goal, s for 100 s
    "rotor drag, nine flights": (partial(compiled, DRAG, 1), 2.5),
    "nothing, nine flights": (partial(compiled, [], 1), 2.5),
    "rotor drag, 54 flights": (partial(compiled, DRAG, 6), 2.5),
    "nine effects, ten flights": (campaign, 3.7),  # 15 s for ten flights
    "inertia, outside simulator": (partial(outside, Draw("single", "inertia", 1)), 2.5),
    "slung load, outside simulator": (partial(outside, Draw("single", "slung_load", 1)), 2.5),
    "nothing, outside simulator, commands": (partial(outside, Draw("nothing", "commands", 1)), None),
    "nothing, outside simulator, estimator's pose": (partial(outside, Draw("nothing", "estimator", 1)), None),
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
    files is not counted. Flights of the outside simulator and of a campaign are flown first where they are not kept.

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


def additions(words: Sequence[str]) -> Page | None:
    """`alula add` until it adds nothing more: what is added, and errors on flights that it never saw.

    Flights are those of the judge's cases (`benchmarks.verdict`). Every third of them is put aside; of the others
    `add` fits some and holds some out, as for a user. First and last version are then compared on those put aside,
    under the noise of the others: an error counts as risen by more than chance and by what matters as `alula add` has
    it, and by 2 % beside that, whatever chance does.

        python -m benchmarks diagnosis additions [--seeds 120000] [--loops 60] [--jobs 1]
    """
    options = options_of(additions.__doc__, jobs=1, resumes="additions", seeds=120000, loops=60)
    chosen = options.parse_args(words)
    return _page_of_additions(chosen, measured(looped, _cases(chosen), chosen, _line, key_of=lambda case: case.key))


def _cases(chosen: argparse.Namespace) -> list[Case]:
    """Some of each set, of which the flights are more than one."""
    sets = read_sets()
    return planned(sets, SETS, chosen.seeds, math.ceil(chosen.loops / len(SETS)))


def looped(case: Case) -> Result:
    """One loop: what it added and why it stopped, and the errors of both versions."""
    with tempfile.TemporaryDirectory() as folder:
        try:
            posed = pose(case, Path(folder))
        except LostFlightsError:
            return {"key": case.key, "lost": "the vehicle kept no path"}
        own = Path(folder) / "logs"
        own.mkdir()
        used, others = _divided(posed, own)
        if not others:
            return {"key": case.key, "lost": "one flight"}
        first = posed.vehicle if isinstance(posed.vehicle, Vehicle) else read_vehicle(posed.vehicle)
        last, steps, stopped = _until_it_stops(used, first)
        expected = posed.expected
        hidden = [*expected.hidden, *(["outside the catalogue"] if expected.outside else [])]
        result = {"key": case.key, "hidden": hidden, "steps": steps, "stopped": stopped}
        false = {name for step in steps for name in step["effects"]} - _true(posed)
        return {**result, "false": sorted(false)} | (_compared(used + others, first, last) if steps else {})


def _true(posed: Posed) -> set[str]:
    """Names of what is hidden, of what no data tells from it, and of what is no falsehood either."""
    hidden = {name for each in posed.expected.hidden for name in (each, *NAMES.get(each, ()))}
    return hidden.union(posed.expected.also, *(group for group in ALIKE if group & hidden))


def _divided(posed: Posed, folder: Path) -> tuple[list[Path], list[Path]]:
    """Logs to add from, and every third to judge by."""
    used, others = list[Path](), list[Path]()
    for number, log in enumerate(posed.logs):
        aside = number % 3 == 2 or (len(posed.logs) == 2 and number == 1)
        name = f"{'aside' if aside else 'flight'}_{number}"
        if isinstance(log, Flight):
            path = log.to_parquet(folder / f"{name}.parquet")
        else:
            path = folder / f"{name}{''.join(log.suffixes)}"
            path.symlink_to(log)
        (others if aside else used).append(path)
    return used, others


def _until_it_stops(logs: Sequence[Path], vehicle: Vehicle) -> tuple[Vehicle, list[dict[str, Any]], str]:
    """The last version, what each step added, and why no other step followed."""
    steps = list[dict[str, Any]]()
    while len(steps) < MAX_STEPS:
        try:
            added = alula.add_effect(list(logs), vehicle)
        except AlulaError as error:
            return vehicle, steps, f"{type(error).__name__}: {str(error)[:200]}"
        report, own = added.report, {use.label: use.parameters for use in vehicle.effects}
        steps.append(
            {
                "effects": [key.partition("[")[0] for key in report.effects],
                "unmoved": [key for key in report.effects if not _moved(key, report.parameters[key], own)],
            }
        )
        vehicle = added.vehicle
    return vehicle, steps, "the last step that is taken"


def _moved(key: str, values: Mapping[str, Any], own: Mapping[str, Mapping[str, float]]) -> bool:
    """Whether an effect has a value whose interval does not hold that of the file before."""
    neutral = {p.name: p.neutral for p in CATALOGUE[key.partition("[")[0]].parameters}
    before = {**neutral, **own.get(key, {})}
    return any(abs(v.value - before[name]) > INTERVAL * v.std for name, v in values.items())


def _compared(logs: Sequence[Path], first: Vehicle, last: Vehicle) -> dict[str, Any]:
    """Errors of both versions on the flights that were put aside."""
    dataset = read_dataset(list(logs), first, hold_out=HELD_OUT)
    judge = HeldOut(noise_of(dataset, first, CATALOGUE), dataset.held_out)
    worse = {**judge.worse_channels(first, last), **judge.worse_open_loop(first, last)}
    proof = alula.prove(list(logs), last, first, hold_out=HELD_OUT).report
    channels = {kind: (error.before, error.after, error.floor) for kind, error in proof.channels.items()}
    return {
        "worse": sorted(worse),
        "risen": sorted(kind for kind, (before, after, _) in channels.items() if after > RISEN * before),
        "at_floor": all(after <= NEAR * floor for _, after, floor in channels.values()),
        "better": judge.improvement(first, last),
    }


def _line(result: Result) -> str:
    if "lost" in result:
        return f"  {result['key']}: {result['lost']}"
    steps = ", then ".join(" + ".join(step["effects"]) for step in result["steps"]) or "nothing"
    worse = f"; worse: {', '.join(result['worse'])}" if result.get("worse") else ""
    false = f"; not there: {', '.join(result['false'])}" if result["false"] else ""
    return f"  {result['key']}: hidden {', '.join(result['hidden']) or 'nothing'}; added {steps}{false}{worse}"


def _page_of_additions(chosen: argparse.Namespace, results: Sequence[Result]) -> Page:
    loops = [result for result in results if "lost" not in result]
    added = [result for result in loops if result["steps"]]
    nothing, outside = ([r for r in loops if r["hidden"] == hidden] for hidden in ([], ["outside the catalogue"]))
    inside = [result for result in loops if result not in (*nothing, *outside)]

    def counted(name: str, these: Sequence[Result], among: Sequence[Result]) -> str:
        return f"| {name} | {len(these)} of {len(among)} |"

    body = [
        "| | loops |",
        "| --- | --- |",
        counted("effects of the catalogue hidden, something added", _with(inside, "steps"), inside),
        counted("something outside the catalogue hidden, something added", _with(outside, "steps"), outside),
        counted("nothing hidden, something added", _with(nothing, "steps"), nothing),
        counted("an effect added that is not there, nor one that no data tells apart", _with(added, "false"), added),
        counted(
            "an error of the flights put aside larger, beyond chance and what matters", _with(added, "worse"), added
        ),
        counted("an error of the flights put aside larger by 2 %", _with(added, "risen"), added),
        counted("open loop there better by two deviations", [r for r in added if r["better"] >= 2], added),
        counted("all errors there within 1.1 of the floor", [r for r in added if r["at_floor"]], added),
        counted("an effect of which every interval holds the file's value", list(_unmoved(added)), added),
        "",
        f"Steps: {dict(sorted(Counter(len(result['steps']) for result in loops).items()))}. Seeds from {chosen.seeds}.",
        "",
        "Not there, or worse:",
        "",
        *(f"-{_line(result)}" for result in added if result["false"] or result["worse"]),
    ]
    return Page("additions", "Adding until nothing more is added", "\n".join(body), trial=chosen.loops < 40)


def _with(results: Sequence[Result], name: str) -> list[Result]:
    return [result for result in results if result[name]]


def _unmoved(results: Sequence[Result]) -> Iterator[Result]:
    return (result for result in results if any(step["unmoved"] for step in result["steps"]))
