"""A long flight of the daemon: memory, threads, descriptors, disk and lateness over time."""

from __future__ import annotations

import json
import os
import subprocess
import tempfile
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path
from typing import Any

import matplotlib as mpl
import msgspec
import numpy as np
from mcap.reader import make_reader

from benchmarks.link.daemon import ALULA
from benchmarks.measurement import ROOT, Page, options_of, paragraph_of
from benchmarks.provenance import RESULTS
from dynamics.arrays import Floats
from dynamics.vehicle_file import find_vehicle, read_vehicle
from runtime.record.parts import parts_of
from simulation.mock_process import mock_process
from sitl_mock.vehicle.battery import usual_battery

VEHICLE = "arpl_250g"
PICTURE = "soak.png"
LAST_RUN = ROOT / "build/soak.json"  # the flights of the last complete run
PERIOD = 1.0  # s between samples of the processes
MOCK_PRIORITY = 1
FIRST, LAST = "-> STREAMING", "ENGAGED -> STANDBY"  # changes of state between which samples are taken
ROWS = 12  # of the table over time
LATE = ("ours", "scheduler")  # causes of a late setpoint
ROOM = 1.3  # of an axis beyond its lines, for the legend
BIN = 10.0  # s of ticks for each point of the picture
FIGURES = (
    "flight, setpoints",
    "ended",
    "memory of the daemon grows, a minute",
    "threads",
    "descriptors",
    "recording, MCAP and tlog, at most",
    "late setpoints of the whole flight: ours, scheduler",
    "latest of them",
    "position error, RMS",
    "events",
)
WARM_UP = 60.0  # s that the growth of memory leaves out
PATIENCE = 180.0  # s for start, take-off and landing
ENDURANCE = 10  # of the battery, in flights: an hour would empty the usual one


class Tick(msgspec.Struct, frozen=True):
    """The timing of a recorded tick, s. departure_seconds: from its trigger to its setpoint, None without one."""

    time: float
    departure_seconds: float | None
    late_cause: str


class Sample(msgspec.Struct, frozen=True):
    """The daemon and the mock at a time. Memory and disk in bytes."""

    time: float
    memory: int
    mock_memory: int
    threads: int
    descriptors: int
    disk: int


class Flight(msgspec.Struct, frozen=True):
    """A flight: samples, report, and the recorded ticks that sent a setpoint."""

    samples: list[Sample]
    report: dict[str, Any]
    ticks: list[Tick]

    @property
    def times(self) -> Floats:
        """Of the ticks, (n,), s."""
        return np.array([tick.time for tick in self.ticks])

    @property
    def lateness(self) -> Floats:
        """From trigger to departure, (n,), s."""
        return np.array([tick.departure_seconds for tick in self.ticks], dtype=float)


def status(process: int, field: str) -> int:
    """A number of /proc/PID/status; kB as bytes. Raises OSError and StopIteration once the process has ended."""
    lines = Path(f"/proc/{process}/status").read_text().splitlines()
    words = next(line for line in lines if line.startswith(f"{field}:")).split()
    return int(words[1]) * (1024 if words[-1] == "kB" else 1)


def sample(flight: int, mock: int, folder: Path) -> Sample:
    """Both processes now. Raises as `status`."""
    disk = 0
    for path in folder.iterdir():
        with suppress(FileNotFoundError):  # the oldest part of a recording goes meanwhile
            disk += path.stat().st_size
    return Sample(
        time.monotonic(),
        status(flight, "VmRSS"),
        status(mock, "VmRSS"),
        status(flight, "Threads"),
        len(list(Path(f"/proc/{flight}/fd").iterdir())),
        disk,
    )


def give_processor(process: int) -> None:
    """Put the mock's threads under SCHED_FIFO, below the daemon's, where that is permitted: a vehicle has processors of
    its own, and estimates that come late because another program runs are none of the daemon's soak.
    """
    with suppress(OSError):
        for task in Path(f"/proc/{process}/task").iterdir():
            os.sched_setscheduler(int(task.name), os.SCHED_FIFO, os.sched_param(MOCK_PRIORITY))


def fly(options: Any, minutes: float, limit: float | None) -> Flight:
    """Fly beside the mock. minutes: of the reference. limit: of the recording, MB, None for none."""
    with tempfile.TemporaryDirectory() as folder:
        samples, report = sampled(options, minutes, limit, Path(folder))
        return Flight(samples, report, list(ticks_of(Path(report["recording"]))))


def fly_both(options: Any) -> list[Flight]:
    """A flight that records all and, beside it, one with a bounded recording."""
    plans = [(options.minutes, None), (options.limited_minutes, options.record_limit)]
    with ThreadPoolExecutor(len(plans)) as pool:
        flights = list(pool.map(lambda plan: fly(options, *plan), plans))
    LAST_RUN.parent.mkdir(parents=True, exist_ok=True)
    LAST_RUN.write_bytes(msgspec.json.encode(flights))
    return flights


def last_flights() -> list[Flight]:
    """Both flights of the last complete run."""
    return msgspec.json.decode(LAST_RUN.read_bytes(), type=list[Flight])


def sampled(options: Any, minutes: float, limit: float | None, folder: Path) -> tuple[list[Sample], dict[str, Any]]:
    """Samples from the first setpoint until the vehicle is disarmed, and the report."""
    scenario, recordings = folder / "scenario.toml", folder / "recordings"
    battery = usual_battery(read_vehicle(find_vehicle(VEHICLE)), endurance=ENDURANCE * (60 * minutes + PATIENCE))
    scenario.write_text(
        "\n".join(["[battery]", *(f"{key} = {value}" for key, value in msgspec.structs.asdict(battery).items())])
    )
    recordings.mkdir()
    command = [*ALULA, "fly", "--vehicle", VEHICLE, "--reference", options.reference, "--json"]
    command += ["--duration", str(60 * minutes), "--rate", "100", "--record", str(recordings)]
    command += ["--no-realtime"] if options.plain else []
    command += ["--record-limit", str(limit)] if limit else []
    taken: list[Sample] = []
    with (
        mock_process("--scenario", str(scenario), vehicle=VEHICLE) as mock,
        (folder / "log").open("w+") as log,
        (folder / "report").open("w+") as report,
        subprocess.Popen([*command, "--link", mock.url], stdout=report, stderr=log) as flight,
    ):
        if not options.plain:
            give_processor(mock.process.pid)
        deadline = time.monotonic() + 60 * minutes + PATIENCE
        while flight.poll() is None and time.monotonic() < deadline:
            text = (folder / "log").read_text()
            if FIRST in text and LAST not in text:
                with suppress(OSError, StopIteration):  # it has ended meanwhile
                    taken.append(sample(flight.pid, mock.process.pid, recordings))
            time.sleep(PERIOD)
        flight.terminate()
    text = (folder / "report").read_text()
    if not text:
        raise SystemExit(f"the flight failed: {(folder / 'log').read_text()}")
    return taken, json.loads(text)


def ticks_of(recording: Path) -> Iterator[Tick]:
    """The ticks that sent a setpoint, of all parts that are there."""
    decoder = msgspec.json.Decoder(Tick)
    for path in parts_of(recording).values() or [recording]:
        with path.open("rb") as stream:
            for _, _, message in make_reader(stream).iter_messages(topics=["/tick"]):
                tick = decoder.decode(message.data)
                if tick.departure_seconds is not None:
                    yield tick


def growth(samples: Sequence[Sample]) -> float:
    """Slope of the daemon's memory after the warm-up, bytes/s; NaN of too short a flight."""
    late = [each for each in samples if each.time - samples[0].time > WARM_UP]
    if len(late) < 3:
        return float("nan")
    slope = np.polyfit([each.time for each in late], [each.memory for each in late], 1)[0]
    return float(slope)


def binned(times: Floats, values: Floats, start: float, width: float) -> list[tuple[float, Floats]]:
    """(middle of a bin, s since the start; the values in it) of each bin that has any. times, values: (n,)."""
    number = ((times - start) // width).astype(int)
    return [((each + 0.5) * width, values[number == each]) for each in np.unique(number).tolist()]


def table(flight: Flight, limited: Flight) -> list[str]:
    """Rows over time. limited: flown beside it, at the same times."""
    lines = [
        "| minutes | memory, MB | with --record-limit | mock's memory, MB | threads | descriptors | recording, MB | "
        "with --record-limit | arrival to departure, ms: median / p99 / max | late: ours, scheduler |",
        "| --- " * 10 + "|",
    ]
    start = flight.samples[0].time
    width = max((flight.samples[-1].time - start) / ROWS, 6.0)
    causes = np.array([LATE.index(tick.late_cause) if tick.late_cause in LATE else -1 for tick in flight.ticks])
    counts = dict(binned(flight.times, causes, start, width))
    for middle, values in binned(flight.times, flight.lateness, start, width):
        latest, other = (
            next((each for each in reversed(samples) if abs(each.time - start - middle) <= width / 2), None)
            for samples in (flight.samples, limited.samples)
        )
        if latest is None:
            continue
        late = " / ".join(f"{1e3 * value:.2f}" for value in np.percentile(values, [50, 99, 100]))
        count = ", ".join(str(np.count_nonzero(counts[middle] == cause)) for cause in range(len(LATE)))
        memory, disk = (f"{other.memory / 1e6:.1f}", f"{other.disk / 1e6:.1f}") if other else ("", "")
        lines.append(
            f"| {(middle + width / 2) / 60:.1f} | {latest.memory / 1e6:.1f} | {memory} | "
            f"{latest.mock_memory / 1e6:.1f} | {latest.threads} | {latest.descriptors} | {latest.disk / 1e6:.1f} | "
            f"{disk} | {late} | {count} |"
        )
    return lines


def plot(flight: Flight, limited: Flight) -> None:
    """Memory, threads and descriptors, recording and lateness over time, into the folder of results."""
    mpl.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(2, 2, figsize=(10, 5.5), sharex=True)
    (memory, counts), (disk, late) = axes
    for each, name in ((flight, "whole recording"), (limited, "with --record-limit")):
        since = [(sample.time - each.samples[0].time) / 60 for sample in each.samples]
        memory.plot(since, [sample.memory / 1e6 for sample in each.samples], label=name)
        disk.plot(since, [sample.disk / 1e6 for sample in each.samples], label=name)
        counts.plot(since, [sample.descriptors for sample in each.samples], label=f"descriptors, {name}")
        counts.plot(since, [sample.threads for sample in each.samples], label=f"threads, {name}")
    memory.set_ylabel("resident memory, MB")
    memory.set_ylim(0, ROOM * memory.get_ylim()[1])
    counts.set_ylabel("number")
    counts.set_ylim(0, ROOM * counts.get_ylim()[1])
    disk.set_ylabel("recording, MB")
    bins = binned(flight.times, flight.lateness, flight.samples[0].time, BIN)
    for percent, name in ((50, "median"), (99, "99th percentile"), (100, "greatest")):
        late.semilogy(
            [middle / 60 for middle, _ in bins],
            [1e3 * np.percentile(values, percent) for _, values in bins],
            label=name,
        )
    late.set_ylabel("arrival to departure, ms")
    late.set_ylim(top=10 * late.get_ylim()[1])  # of a logarithmic axis
    for axis in axes.flat:
        axis.legend(frameon=False)
    for axis in axes[1]:
        axis.set_xlabel("minutes of flight")
    figure.tight_layout()
    figure.savefig(RESULTS / PICTURE, dpi=120)
    plt.close(figure)


def column(flight: Flight) -> list[str]:
    """Figures of a flight, in the order of FIGURES."""
    samples, report = flight.samples, flight.report
    threads, descriptors = ({getattr(each, name) for each in samples} for name in ("threads", "descriptors"))
    minutes = (samples[-1].time - samples[0].time) / 60
    timing = report["timing"]
    worst = f"{1e3 * timing['worst_late']:.0f} ms, {timing['worst_cause']}" if timing["worst_cause"] else "none"
    return [
        f"{minutes:.1f} min, {timing['ticks']}",
        report["outcome"],
        f"{60 * growth(samples) / 1e3:.0f} kB",
        f"{min(threads)} to {max(threads)}",
        f"{min(descriptors)} to {max(descriptors)}",
        f"{max(each.disk for each in samples) / 1e6:.1f} MB",
        f"{', '.join(str(timing['missed'][cause]) for cause in LATE)}",
        worst,
        f"{1e3 * report['tracking']['position_rmse']:.0f} mm",
        ", ".join(f"{name} {count}x" for name, count in report["events"].items()) or "none",
    ]


def soak(words: Sequence[str]) -> Page:
    """Long flights at 100 Hz against the mock: does anything of the daemon grow, and does it become late?

    Memory, threads, descriptors and the recording's files are read from /proc and the folder once a second. Lateness is
    from what triggers a tick, an estimate's arrival, to the departure of its setpoint; late is more than half a period.
    Two flights side by side: one records all, the other has a bounded recording.

        python -m benchmarks link soak [--minutes 60] [--limited-minutes 60] [--record-limit MB] [--plain] [--again]

    Mock and daemon are processes of their own on this machine, the mock under SCHED_FIFO as well, since a vehicle has
    its own processors.
    """
    parser = options_of(soak.__doc__)
    parser.add_argument("--minutes", type=float, default=60.0, help="of the reference, with all of the recording")
    parser.add_argument("--limited-minutes", type=float, default=60.0, help="of the reference, bounded recording")
    parser.add_argument("--record-limit", type=float, default=100.0, help="MB of the bounded recording")
    parser.add_argument("--again", action="store_true", help="page and picture of the last run's flights, none flown")
    parser.add_argument("--reference", default="lemniscate", help="as of alula fly")
    parser.add_argument("--plain", action="store_true", help="ordinary scheduling instead of SCHED_FIFO")
    options = parser.parse_args(words)
    flight, limited = (
        msgspec.json.decode(LAST_RUN.read_bytes(), type=list[Flight]) if options.again else fly_both(options)
    )
    completed = flight.report["completed"] and limited.report["completed"]
    if completed and not (options.quick or options.no_page):
        plot(flight, limited)
    lines = [
        paragraph_of(soak.__doc__),
        "",
        f"Flights of `{options.reference}`, {flight.report['scheduling']}. Both processes at niceness {os.nice(0)}; "
        f"load average over the last 15 min {os.getloadavg()[2]:.1f} on {os.cpu_count()} cores.",
        "",
        f"| figure | whole recording | --record-limit {options.record_limit:g} |",
        "| --- | --- | --- |",
        *(f"| {' | '.join(row)} |" for row in zip(FIGURES, column(flight), column(limited), strict=True)),
        "",
        *table(flight, limited),
        "",
        "A whole recording's index is in memory until its end: about 0.9 kB for each chunk of 0.4 s, 130 kB a minute. "
        "A bounded recording writes it with each part. What else grows is not attributed yet.",
        "",
        f"![over time]({PICTURE})",
    ]
    return Page("soak", "A soak of the daemon", "\n".join(lines), trial=not completed)
