"""A long flight of the daemon: memory, threads, descriptors, disk and lateness over time."""

from __future__ import annotations

import json
import os
import subprocess
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib as mpl
import msgspec
import numpy as np
from mcap.reader import make_reader

from benchmarks.link.daemon import ALULA
from benchmarks.measurement import Page, options_of, paragraph_of
from benchmarks.provenance import RESULTS
from dynamics.arrays import Floats
from dynamics.vehicle_file import find_vehicle, read_vehicle
from runtime.record.parts import parts_of
from simulation.mock_process import mock_process
from sitl_mock.vehicle.battery import usual_battery

VEHICLE = "arpl_250g"
PICTURE = "soak.png"
PERIOD = 1.0  # s between samples of the processes
MOCK_PRIORITY = 1
FIRST, LAST = "-> STREAMING", "ENGAGED -> STANDBY"  # changes of state between which samples are taken
ROWS = 10  # of the table over time
ROOM = 1.3  # of an axis beyond its lines, for the legend
BIN = 10.0  # s of ticks for each point of the picture
FIGURES = (
    "flight, setpoints",
    "ended",
    "memory of the daemon grows, a minute",
    "threads",
    "descriptors",
    "recording, MCAP and tlog, at most",
    "late setpoints of those recorded: ours, scheduler",
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


@dataclass(frozen=True)
class Sample:
    """The daemon and the mock at a time. Memory and disk in bytes."""

    time: float
    memory: int
    mock_memory: int
    threads: int
    descriptors: int
    disk: int


@dataclass(frozen=True)
class Flight:
    """A flight: samples, report, and of each recorded tick with a setpoint time and lateness (n,), s, and its cause."""

    samples: list[Sample]
    report: dict[str, Any]
    times: Floats
    lateness: Floats
    causes: list[str]


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
        ticks = list(ticks_of(Path(report["recording"])))
    lateness = [tick.departure_seconds for tick in ticks]
    causes = [tick.late_cause for tick in ticks]
    return Flight(samples, report, np.array([tick.time for tick in ticks]), np.array(lateness, dtype=float), causes)


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


def table(flight: Flight) -> list[str]:
    """Rows over time."""
    lines = [
        "| minutes | memory, MB | mock's memory, MB | threads | descriptors | recording, MB | "
        "arrival to departure, ms: median / p99 / max |",
        "| --- " * 7 + "|",
    ]
    start = flight.samples[0].time
    width = max((flight.samples[-1].time - start) / ROWS, 6.0)
    for middle, values in binned(flight.times, flight.lateness, start, width):
        since = [each for each in flight.samples if abs(each.time - start - middle) <= width / 2]
        if not since:
            continue
        latest = since[-1]
        late = " / ".join(f"{1e3 * value:.2f}" for value in np.percentile(values, [50, 99, 100]))
        lines.append(
            f"| {(middle + width / 2) / 60:.1f} | {latest.memory / 1e6:.1f} | {latest.mock_memory / 1e6:.1f} | "
            f"{latest.threads} | {latest.descriptors} | {latest.disk / 1e6:.1f} | {late} |"
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
    late = [flight.causes.count(cause) for cause in ("ours", "scheduler")]
    return [
        f"{minutes:.1f} min, {report['timing']['ticks']}",
        report["outcome"],
        f"{60 * growth(samples) / 1e3:.0f} kB",
        f"{min(threads)} to {max(threads)}",
        f"{min(descriptors)} to {max(descriptors)}",
        f"{max(each.disk for each in samples) / 1e6:.1f} MB",
        f"{late[0]}, {late[1]} of {len(flight.causes)}",
        f"{1e3 * report['tracking']['position_rmse']:.0f} mm",
        ", ".join(f"{name} {count}x" for name, count in report["events"].items()) or "none",
    ]


def soak(words: Sequence[str]) -> Page:
    """Long flights at 100 Hz against the mock: does anything of the daemon grow, and does it become late?

    Memory, threads, descriptors and the recording's files are read from /proc and the folder once a second; lateness is
    that of the recorded ticks, from what triggers one, an estimate's arrival, to the departure of its setpoint. Beside
    it a flight with a bounded recording.

        python -m benchmarks link soak [--minutes 10] [--limited-minutes 4] [--record-limit MB] [--plain]

    Mock and daemon are processes of their own on this machine, the mock under SCHED_FIFO as well, since a vehicle has
    its own processors. An hour is --minutes 60.
    """
    parser = options_of(soak.__doc__)
    parser.add_argument("--minutes", type=float, default=10.0, help="of the reference, with all of the recording")
    parser.add_argument("--limited-minutes", type=float, default=4.0, help="of the reference, with a bounded recording")
    parser.add_argument("--record-limit", type=float, default=10.0, help="MB of the bounded recording")
    parser.add_argument("--reference", default="lemniscate", help="as of alula fly")
    parser.add_argument("--plain", action="store_true", help="ordinary scheduling instead of SCHED_FIFO")
    options = parser.parse_args(words)
    flight = fly(options, options.minutes, None)
    limited = fly(options, options.limited_minutes, options.record_limit)
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
        *table(flight),
        "",
        "A whole recording's index is in memory until its end: about 0.9 kB for each chunk of 0.4 s, 130 kB a minute. "
        "A bounded recording writes it with each part. What else grows is not attributed yet.",
        "",
        f"![over time]({PICTURE})",
    ]
    return Page("soak", "A soak of the daemon", "\n".join(lines), trial=not completed)
