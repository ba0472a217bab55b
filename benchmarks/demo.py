"""The demo's gain, and random hidden effects found by the command line alone."""

from __future__ import annotations

import csv
import hashlib
import json
import os
import secrets
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path

import msgspec
import numpy as np

from benchmarks.measurement import ROOT, Page, Result, measured, options_of, paragraph_of
from dynamics.errors import AlulaError
from fixtures.hidden_effect import Draw, try_command_line, yardstick
from studies.demo.flights import DemoOptions
from studies.demo.result import DemoReport
from studies.demo.run import run_demo
from studies.paper import TRACKING_LEARNED, TRACKING_NOMINAL

EFFECTS = (
    "rotor_drag:coefficient=2.2e-5", "linear_drag:coefficient=0.12", "parasitic_drag:coefficient=0.02",
    "rotational_damping", "wind:x=3,y=1", "gust:intensity=1", "ground_effect", "wall_effect", "translational_lift",
    "axial_inflow", "blade_flapping", "rotor_gyroscopic", "motor_lag:time_constant=0.04", "battery_sag",
    "weak_rotor:rotor=1,loss=0.1", "rotor_cant:rotor=1", "thrust_constant:ratio=0.9", "torque_constant:ratio=0.8",
    "inertia", "mass:ratio=1.1", "centre_of_mass:x=0.006,y=-0.004", "slung_load:mass=0.025,length=0.5",
    "imu_bias:x=0.5,y=0.3", "gyro_bias:z=0.05", "time_delay:delay=0.02", "rotor_speed_fault:rotor=1,gain=0.9",
)  # fmt: skip
CATALOGUE_MANOEUVRES = ("Ellipse_2", "ExtendedLemniscate", "WarpedEllipse_2")  # away from the limits of the rotors


def gain(words: Sequence[str]) -> Page:
    """Gain of the demo: prediction and tracking error before and after, over seeds, and for each catalogued effect.

    In simulated time, with the mock's estimates, sensor noise, delays, motor lag and inner loops. First the demo's
    default, then one effect at a time, at the strengths below, each through the whole demo: fly, diagnose, add, fly
    again. What was flown is kept in a folder, so that an interrupted run resumes.

        python -m benchmarks demo gain [--seeds 5] [--effects NAME,...] [--keep FOLDER] [--minutes 8]
    """
    parser = options_of(gain.__doc__)
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--effects", default="", help="names of those to fly, by default all")
    parser.add_argument("--keep", type=Path, default=Path(tempfile.gettempdir()) / "demo_gain")
    parser.add_argument("--minutes", type=float, default=float("inf"), help="until no further demo is begun")
    arguments = parser.parse_args(words)
    seeds = range(1, arguments.seeds + 1)
    demos = {f"default_{seed}": DemoOptions(arguments.keep, seed=seed) for seed in seeds}
    chosen = arguments.effects.split(",") if arguments.effects else [effect.partition(":")[0] for effect in EFFECTS]
    for effect in EFFECTS:
        name = effect.partition(":")[0]
        if name not in chosen:
            continue
        demos[name] = DemoOptions(arguments.keep, effects=(effect,), manoeuvres=CATALOGUE_MANOEUVRES)
    flown_demos = dict(_demos(demos, until=time.monotonic() + 60 * arguments.minutes))
    if len(flown_demos) < len(demos):
        sys.exit(f"{len(flown_demos)} of {len(demos)} demos are flown; run again to continue.")
    reports = [flown_demos.pop(f"default_{seed}") for seed in seeds]
    body = [f"## The demo's default, seeds 1 to {arguments.seeds}", "", *_default(reports)] if reports else []
    body += ["", "## Each effect by itself", "", *_catalogue(flown_demos)]
    return Page("demo_gain", "What the demo gains", "\n".join(body))


def _demos(demos: Mapping[str, DemoOptions], until: float) -> Iterator[tuple[str, DemoReport | str]]:
    """Each demo's report, or why there is none; those flown before are read again."""
    for name, options in demos.items():
        report_file = options.folder / name / "report.json"
        if not report_file.exists() and time.monotonic() < until:
            options = msgspec.structs.replace(options, folder=report_file.parent)
            try:
                outcome: DemoReport | str = run_demo(options, lambda _: None, lambda *_: None)[0]
            except AlulaError as error:
                outcome = str(error)
            report_file.write_bytes(msgspec.json.encode(outcome))
            print(name, flush=True)
        if report_file.exists():
            yield name, msgspec.json.decode(report_file.read_bytes(), type=DemoReport | str)


def _default(reports: Sequence[DemoReport]) -> list[str]:
    rows = [
        "| manoeuvre | nominal m | identified m | ratio | least ratio | the paper m | its ratio |",
        "| --- " * 7 + "|",
    ]
    for index, flown in enumerate(reports[0].nominal):
        pairs = [report.pairs[index] for report in reports]
        before = np.array([one.position_rmse for one, _ in pairs])
        after = np.array([np.nan if other is None else other.position_rmse for _, other in pairs])
        nominal, learned = TRACKING_NOMINAL[flown.name][0], TRACKING_LEARNED[flown.name][0]
        ratio = before / after
        rows.append(
            f"| {flown.name} | {_spread(before)} | {_spread(after)} | {_spread(ratio, 1)} | {ratio.min():.1f} | "
            f"{nominal:.3f} -> {learned:.3f} | {nominal / learned:.1f} |"
        )
    rows += ["", "| prediction of | nominal | identified | noise floor | unit |", "| --- " * 5 + "|"]
    for kind in reports[0].learned.channels if reports[0].learned else ():
        errors = [report.learned.channels[kind] for report in reports if report.learned is not None]
        figures = [np.array([getattr(error, part) for error in errors]) for part in ("before", "after", "floor")]
        rows.append(f"| {kind} | {' | '.join(_spread(figure) for figure in figures)} | {errors[0].unit} |")
    named = sum(report.learned is not None and len(report.learned.added) == 2 for report in reports)
    return [*rows, "", f"Both effects and no third were added in {named} of {len(reports)} demos. Mean +- deviation."]


def _catalogue(flown_demos: Mapping[str, DemoReport | str]) -> list[str]:
    names = ", ".join(CATALOGUE_MANOEUVRES)
    rows = [
        f"Manoeuvres: {names}; the last is held out. Ratio: tracking RMSE with the nominal model over that with "
        "what was learned, for each.",
        "",
        "| hidden | verdict | added | prediction of force | ratios |",
        "| --- " * 5 + "|",
    ]
    for effect in EFFECTS:
        if (name := effect.partition(":")[0]) not in flown_demos:
            continue
        outcome = flown_demos[name]
        rows.append(f"| {effect} | none: {outcome} | | | |" if isinstance(outcome, str) else _line(effect, outcome))
    return rows


def _line(effect: str, report: DemoReport) -> str:
    learned = report.learned
    assert learned is not None
    force = learned.channels["imu"]
    ratios = [f"{b.position_rmse / a.position_rmse:.2f}" for b, a in report.pairs if a is not None]
    named = ", ".join(learned.added) or "nothing"
    return (
        f"| {effect} | {learned.verdict} | {named} | {force.before / force.floor:.1f} -> "
        f"{force.after / force.floor:.2f} floors | {', '.join(ratios)} |"
    )


def _spread(values: np.ndarray, digits: int = 3) -> str:
    return f"{np.mean(values):.{digits}f} +- {np.std(values):.{digits}f}"


DRAWS = 3  # of a seed, as in tests/acceptance


def draws(words: Sequence[str]) -> Page:
    """Random hidden effects and the command line alone: the acceptance tests' draws with seeds that nobody chose.

    Each draw hides an effect of the whole catalogue, strong or very strong, with usual or threefold noise; one draw of
    each seed hides nothing. A fault is an error or a worse model, a miss is a goal that was not reached.

        python -m benchmarks demo draws [--seeds 2] [--first SEED]
    """
    parser = options_of(draws.__doc__)
    parser.add_argument("--seeds", type=int, default=2)
    parser.add_argument("--first", type=int, default=None, help="a random number by default")
    parser.add_argument("--draws", type=int, default=DRAWS, help="of a seed, that hide something")
    arguments = parser.parse_args(words)
    first = secrets.randbelow(100_000) if arguments.first is None else arguments.first
    rows = ["| seed | draw | outcome |", "| --- | --- | --- |"]
    faults = misses = count = 0
    for seed in range(first, first + arguments.seeds):
        measure = yardstick(seed)
        for draw in (Draw("", 0.0, 1.0, seed), *(Draw.random(seed, number) for number in range(arguments.draws))):
            with tempfile.TemporaryDirectory() as folder:
                outcome = try_command_line(draw, measure, Path(folder))
            rows.append(f"| {seed} | {draw.effect or 'nothing'} | {str(outcome).replace('|', '/')} |")
            faults, misses, count = faults + bool(outcome.faults), misses + bool(outcome.misses), count + 1
    text = f"{count} draws of {arguments.seeds} seeds from {first} on: {faults} with faults, {misses} with misses.\n\n"
    return Page("hidden_effect_draws", "Random hidden effects, by the command line alone", text + "\n".join(rows))


def busy(words: Sequence[str]) -> Page:
    """The demo's command beside other work: exit codes, answers and durations under busy loops.

    Each demo is a process of its own with an empty folder of compiled code, as a new user's is. Busy loops of the same
    priority run all the while, and as many demos at once as `--jobs` says, which are further load for each other.

        python -m benchmarks demo busy [--demos 20] [--loops 8] [--jobs 4]
    """
    parser = options_of(busy.__doc__, jobs=4, resumes="demo_busy", demos=20, loops=8)
    arguments = parser.parse_args(words)
    with _busy_loops(arguments.loops):
        results = measured(
            partial(_demo_alone, cores=len(os.sched_getaffinity(0))),
            range(1, arguments.demos + 1),
            arguments,
            line=lambda r: f"{r['key']}: exit {r['exit']}, {r['seconds']:.0f} s, {r['processor']:.0f} s of processor",
            key_of=lambda number: number,
        )
    passed = [result for result in results if result["exit"] == 0]
    seconds, processor = (np.array([result[name] for result in passed]) for name in ("seconds", "processor"))
    figures = [result["figures"] for result in passed if "figures" in result]
    rows = [
        paragraph_of(busy.__doc__),
        "",
        "| | |",
        "| --- | --- |",
        f"| busy loops, demos at once, cores | {arguments.loops}, {arguments.jobs}, {results[0]['cores']} |",
        f"| demos that ended with exit 0 | {len(passed)} of {len(results)} |",
        f"| duration s, median (least to largest) | {_range(seconds)} |",
        f"| processor time s | {_range(processor)} |",
    ]
    if figures:
        rows.append(f"| different tables of tracking errors, of {len(figures)} | {len(set(figures))} |")
    rows += [f"| demo {r['key']} | exit {r['exit']}: {r['end']} |" for r in results if r["exit"]]
    return Page("demo_busy", "The demo beside other work", "\n".join(rows))


def _demo_alone(number: int, *, cores: int) -> Result:
    begin = time.monotonic()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        output = folder / "output.txt"
        environment = {**os.environ, "ALULA_CACHE": str(folder / "compiled")}
        with output.open("wb") as file:
            process = subprocess.Popen(
                [sys.executable, "-m", "alula", "demo", "--out", str(folder / "demo")],
                stdout=file,
                stderr=subprocess.STDOUT,
                env=environment,
                cwd=ROOT,
            )
            _, status, usage = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
        table = folder / "demo/tracking.csv"
        return {
            "key": number,
            "exit": process.returncode,
            "seconds": time.monotonic() - begin,
            "processor": usage.ru_utime + usage.ru_stime,
            "figures": _digest(table) if table.exists() else None,
            "end": output.read_text(errors="replace").strip().rpartition("\n")[2],
            "cores": cores,
        }


def _digest(table: Path) -> str:
    """Hash of the figures in a table of tracking errors, without the recordings' paths."""
    with table.open(newline="", encoding="utf-8") as file:
        rows = [{**row, "recording": ""} for row in csv.DictReader(file)]
    return hashlib.sha256(json.dumps(rows).encode()).hexdigest()


@contextmanager
def _busy_loops(count: int) -> Iterator[None]:
    loops = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(count)]
    try:
        yield
    finally:
        for loop in loops:
            loop.kill()
            loop.wait()


def _range(values: np.ndarray) -> str:
    return f"{np.median(values):.0f} ({values.min():.0f} to {values.max():.0f})" if len(values) else "none"
