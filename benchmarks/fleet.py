"""A fleet of one-minute logs: throughput on processes and on a Dask cluster, what a kill costs, what was planted.

Twenty vehicles with a log a week: five hide nothing, five a constant drag, five one that grows, five a constant one
and in one flight a weak rotor. The run on two processes is killed half way and continued; of two Dask workers one is
killed half way.

    python -m benchmarks fleet fleet [--logs 1000] [--one 60] [--cluster 120]
"""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.measurement import Page, options_of
from dynamics.vehicle import EffectUse
from fixtures.dask_cluster import dask_cluster
from fixtures.fleet_flights import MINUTE, write_fleet
from studies.fleet.files import LINES, TABLE
from studies.fleet.flight import FleetFlight
from studies.fleet.store import read_flights
from studies.fleet.summary import FleetReport, summarise

VEHICLES, WEEK = 20, 7  # and days
KINDS = ("nothing", "drag", "growing drag", "drag, once a weak rotor")
DRAG, GROWTH = 2.2e-5, 0.01  # N/(rad/s)/(m/s), and its share a week
LOSS, ROTOR = 0.03, 1
SEED = 52_000
ENVIRONMENT = {**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}


@dataclass(frozen=True)
class Run:
    """A run's elapsed time and mean work on a log, s, and its lines."""

    what: str
    logs: int
    elapsed: float
    work: float
    lines: int
    distinct: int

    @property
    def row(self) -> str:
        """Of the table."""
        cells = (self.what, f"{self.logs}", f"{self.elapsed:.0f}", f"{3600 * self.logs / self.elapsed:,.0f}")
        return "| " + " | ".join([*cells, f"{self.work:.2f}", f"{self.lines}", f"{self.distinct}"]) + " |"


def kind_of(vehicle: str) -> str:
    """Hidden effect of a vehicle of a name."""
    return KINDS[int(vehicle.removeprefix("v")) * len(KINDS) // VEHICLES]


def hidden(vehicle: int, flights: int) -> list[list[EffectUse]]:
    """The effects of each flight of a vehicle."""
    kind = KINDS[vehicle * len(KINDS) // VEHICLES]
    made = []
    for week in range(flights):
        growth = 1 + GROWTH * week if kind == "growing drag" else 1.0
        uses = [] if kind == "nothing" else [EffectUse("rotor_drag", {"coefficient": DRAG * growth})]
        if kind == KINDS[3] and week == weak_flight(flights):
            uses.append(EffectUse("weak_rotor", {"loss": LOSS}, ROTOR))
        made.append(uses)
    return made


def weak_flight(flights: int) -> int:
    """The flight with a weak rotor."""
    return 2 * flights // 3


def part(folder: Path, name: str, logs: int) -> Path:
    """The first logs of every vehicle, as another fleet."""
    other = folder.parent / name
    for vehicle in sorted(path for path in folder.iterdir() if path.is_dir()):
        (other / vehicle.name).mkdir(parents=True)
        for path in [*sorted(vehicle.iterdir())[: logs // VEHICLES], vehicle / "vehicle.toml"]:
            (other / vehicle.name / path.name).hardlink_to(path)
    return other


def alula(fleet: Path, *options: object) -> subprocess.Popen[bytes]:
    """Start the command."""
    words = [sys.executable, "-m", "alula", "diagnose", "--fleet", str(fleet), *map(str, options)]
    return subprocess.Popen(words, env=ENVIRONMENT, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)


def count_lines(out: Path) -> int:
    """Lines that were written so far."""
    try:
        return (out / LINES).read_bytes().count(b"\n")
    except FileNotFoundError:
        return 0


def wait_for_lines(out: Path, count: int, process: subprocess.Popen[bytes]) -> None:
    """Until a run has written so many lines."""
    while count_lines(out) < count:
        if process.poll() is not None:
            raise RuntimeError(f"ended with {process.returncode} before {count} lines")
        time.sleep(0.1)


def finished(what: str, out: Path, logs: int, elapsed: float) -> Run:
    """The figures of a run that has ended."""
    lines = [json.loads(line) for line in (out / LINES).read_text().splitlines()]
    work = float(np.mean([line["seconds"] for line in lines]))
    return Run(what, logs, elapsed, work, len(lines), len({line["log"] for line in lines}))


def complete(runs: Sequence[Run]) -> int:
    """Runs with each log in one line."""
    return sum(run.lines == run.distinct == run.logs for run in runs)


def end_well(process: subprocess.Popen[bytes]) -> None:
    """Wait for a command's end. Raises RuntimeError when it failed."""
    _, wrong = process.communicate()
    if process.returncode:
        raise RuntimeError(wrong.decode()[-2000:])


def local(fleet: Path, out: Path, logs: int, workers: int, *, kill: bool) -> Run:
    """A run on processes of this machine. kill: end it by force half way, and give the same command again."""
    began = time.monotonic()
    process = alula(fleet, "--workers", workers, "--out", out)
    if kill:
        wait_for_lines(out, logs // 2, process)
        process.send_signal(signal.SIGKILL)
        process.communicate()
        process = alula(fleet, "--workers", workers, "--out", out)
    end_well(process)
    what = f"{workers} process{'es' if workers > 1 else ''}{', killed half way and continued' if kill else ''}"
    return finished(what, out, logs, time.monotonic() - began)


def cluster(fleet: Path, out: Path, logs: int, folder: Path) -> Run:
    """A run on two Dask workers of which one is killed half way."""
    with dask_cluster(folder) as (address, workers):
        began = time.monotonic()
        process = alula(fleet, "--scheduler", address, "--out", out)
        wait_for_lines(out, logs // 2, process)
        workers[0].kill()
        end_well(process)
        elapsed = time.monotonic() - began
    return finished("2 Dask workers, one killed half way", out, logs, elapsed)


def same_results(left: Path, right: Path) -> tuple[int, int]:
    """Flights that two runs have in common, and how many of them have the same verdict and values."""
    ours = {flight.log: flight for flight in read_flights(left)}
    both = [(ours[flight.log], flight) for flight in read_flights(right) if flight.log in ours]
    return len(both), sum((a.verdict, a.effects, a.channels) == (b.verdict, b.effects, b.channels) for a, b in both)


def verdict_lines(flights: Sequence[FleetFlight]) -> list[str]:
    """Verdicts by what was hidden."""
    names = ("explained", "effect", "ambiguous", "unknown", "refused", "failed")
    lines = [
        "| hidden | flights | " + " | ".join(names) + " | effects named |",
        "| --- |" + " --- |" * (len(names) + 2),
    ]
    for kind in KINDS:
        own = [flight for flight in flights if kind_of(flight.vehicle) == kind]
        counts = Counter(flight.verdict or flight.status for flight in own)
        effects = Counter(effect.name for flight in own for effect in flight.effects)
        named = ", ".join(f"{name} {count}" for name, count in effects.most_common()) or "-"
        lines.append(f"| {kind} | {len(own)} | " + " | ".join(str(counts[name]) for name in names) + f" | {named} |")
    return lines


def summary_lines(report: FleetReport, flights: int) -> list[str]:
    """Planted drifts and outliers against those that were reported."""
    planted = DRAG * GROWTH / WEEK
    size = [drift for drift in report.drifts if drift.quantity == "rotor_drag coefficient"]
    growing = [drift for drift in size if kind_of(drift.vehicle) == "growing drag"]
    constant = [drift for drift in size if kind_of(drift.vehicle) != "growing drag"]
    other = [drift for drift in report.drifts if drift not in growing and kind_of(drift.vehicle) != "growing drag"]
    inside = sum(drift.low <= planted <= drift.high for drift in growing)
    off = np.median([abs(drift.slope / planted - 1) for drift in growing]) if growing else np.nan
    logs = {flight.log: flight for flight in report.flights}
    weak = [log for log in logs if is_weak(log, sorted(logs), flights)]
    outside = {outlier.log for outlier in report.outliers}
    return [
        f"Drift: a drag that grows by {GROWTH:.0%} a week is reported for {sum(d.is_drift for d in growing)} of "
        f"{len(growing)} vehicles; the slope's 95 % interval holds the planted one for {inside}, the slope is off by "
        f"{off:.1%} in the median. Of {len(constant)} drags that stay the same {sum(d.is_drift for d in constant)} are "
        f"reported as drifts; of all {len(other)} quantities of vehicles that stay the same, "
        f"{sum(d.is_drift for d in other)}.",
        "",
        f"Outliers: {len(outside & set(weak))} of {len(weak)} flights with a rotor {LOSS:.0%} weaker are reported, and "
        f"{len(outside - set(weak))} of the other {len(logs) - len(weak)} flights.",
    ]


def is_weak(log: str, logs: Sequence[str], flights: int) -> bool:
    """Whether a log is of the flight with a weak rotor."""
    vehicle = log.split("/")[0]
    own = [one for one in logs if one.startswith(f"{vehicle}/")]
    return kind_of(vehicle) == KINDS[3] and own.index(log) == weak_flight(flights)


def fleet(words: Sequence[str]) -> Page:
    """Fly the fleet, run it three times and write the table."""
    options = options_of(__doc__)
    options.add_argument("--logs", type=int, default=1000, help="logs on two processes")
    options.add_argument("--one", type=int, default=60, help="logs on one process")
    options.add_argument("--cluster", type=int, default=120, help="logs on the Dask cluster")
    chosen = options.parse_args(words)
    each = chosen.logs // VEHICLES
    folder = Path(tempfile.mkdtemp(prefix="alula-fleet-"))
    try:
        began = time.monotonic()
        fleet = folder / "fleet"
        effects = {f"v{i:02d}": hidden(i, each) for i in range(VEHICLES)}
        write_fleet(fleet, effects, days=WEEK, manoeuvres=MINUTE, suffix=".parquet", seed=SEED)
        flown = time.monotonic() - began
        size = sum(path.stat().st_size for path in fleet.rglob("*.parquet"))
        alone, some = part(fleet, "alone", chosen.one), part(fleet, "some", chosen.cluster)
        runs = [
            local(alone, folder / "alone.out", chosen.one, 1, kill=False),
            local(fleet, folder / "fleet.out", each * VEHICLES, 2, kill=True),
            cluster(some, folder / "some.out", chosen.cluster, folder),
        ]
        shared, same = same_results(folder / "fleet.out", folder / "some.out")
        flights = read_flights(folder / "fleet.out")
        report = summarise("fleet", sorted(flights, key=lambda flight: flight.log))
        began = time.monotonic()
        end_well(alula(fleet, "--workers", 2, "--out", folder / "fleet.out", "--html", folder / "fleet.html"))
        again = time.monotonic() - began
        sizes = [(folder / "fleet.out" / LINES), (folder / "fleet.out" / TABLE), folder / "fleet.html"]
        stored = ", ".join(f"{path.name} {path.stat().st_size / 1e6:.1f} MB" for path in sizes)
    finally:
        shutil.rmtree(folder, ignore_errors=True)
    lines = [
        f"{each * VEHICLES} logs of {np.median([flight.duration for flight in flights]):.0f} s at 100 Hz of {VEHICLES} "
        f"vehicles (Parquet, {size / 1e6 / len(flights):.1f} MB each; simulated by `fixtures.compiled_flights` in "
        f"{flown:.0f} s); the goal is 1,000. Time is that of the command with its start, beside whatever else ran on "
        "the machine (load below). Seconds a log: the work alone, mean of the lines.",
        "",
        "| | logs | s | logs an hour | work on a log, s | lines | distinct logs in them |",
        "| --- | --- | --- | --- | --- | --- | --- |",
        *(run.row for run in runs),
        "",
        f"Nothing is lost and nothing is twice: {complete(runs)} of {len(runs)} runs have as many lines as logs, each "
        f"log in one. Of {shared} flights that both the cluster and the two processes diagnosed, {same} have the same "
        f"verdict, values and errors to the last digit. The same command on the finished fleet, with its page, takes "
        f"{again:.1f} s. {stored}.",
        "",
        "## Verdicts by what was hidden",
        "",
        *verdict_lines(flights),
        "",
        "One flight a diagnosis; the vehicle files have none of the effects.",
        "",
        "## Drifts and outliers",
        "",
        *summary_lines(report, each),
    ]
    return Page("fleet", "A fleet", "\n".join(lines))
