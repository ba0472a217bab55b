"""The daemon on the link: timing of setpoints, cost of recording, the filter of the vehicle's clock."""

from __future__ import annotations

import contextlib
import json
import os
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.measurement import ROOT, Page, options_of
from fixtures.vehicle_clock import PERIOD, START, Clock, Exchange, simulator_clock
from runtime.link.clock import VehicleClock
from runtime.record.recorder import Recorder
from runtime.record.records import (
    EstimateRecord,
    HorizonRecord,
    ObservationRecord,
    Record,
    ReferenceRecord,
    SetpointRecord,
    TickRecord,
)

ALULA = [sys.executable, "-m", "alula"]


@contextlib.contextmanager
def mock() -> Iterator[int]:
    """A mock of the paper's vehicle; the UDP port that it sends to."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        port = int(probe.getsockname()[1])
    command = [*ALULA, "mock", "--vehicle", "arpl_250g", "--link", f"udpout:127.0.0.1:{port}"]
    process = subprocess.Popen(command, stderr=subprocess.DEVNULL)
    try:
        time.sleep(5.0)  # its own compilation and start are not what is measured
        yield port
    finally:
        process.terminate()
        process.wait()


def fly(rate: int, seconds: float, *, realtime: bool) -> dict[str, Any]:
    """One flight's report, with the time from starting the process to the first setpoint as `whole_start_up`."""
    with mock() as port, tempfile.TemporaryDirectory() as folder:
        options = ["--vehicle", "arpl_250g", "--reference", "hover", "--duration", str(seconds), "--rate", str(rate)]
        options += ["--link", f"udpin:127.0.0.1:{port}", "--record", folder, "--json"]
        command = [*ALULA, "fly", *options, "--realtime" if realtime else "--no-realtime"]
        began = time.monotonic()
        with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
            assert process.stderr is not None
            streaming = next((time.monotonic() for line in process.stderr if "-> STREAMING" in line), float("nan"))
            output, log = process.communicate()
    if not output:
        raise SystemExit(f"the flight at {rate} Hz failed: {log}")
    report: dict[str, Any] = json.loads(output)
    return {**report, "whole_start_up": streaming - began}


def row(name: str, report: dict[str, Any]) -> str:
    """One line of the table."""
    timing = report["timing"]
    latency = " / ".join(f"{1e3 * timing['latency'][key]:.2f}" for key in ("median", "p99", "max"))
    busy = " / ".join(f"{1e3 * timing['busy'][key]:.2f}" for key in ("median", "p99"))
    missed = " + ".join(str(timing["missed"][cause]) for cause in ("ours", "scheduler"))
    error = report["tracking"]["position_rmse"]
    return (
        f"| {name} | {timing['ticks']} | {latency} | {busy} | {missed} | {timing['ticks_by_clock']} | "
        f"{1e3 * timing['worst_late']:.1f} {timing['worst_cause']} | {1e3 * error:.0f} | "
        f"{report['whole_start_up']:.2f} | {report['outcome']} |"
    )


def timing(words: Sequence[str]) -> Page:
    """From an estimate's arrival to the setpoint's departure, late setpoints and their causes, start-up: over real UDP.

        python -m benchmarks link timing [--minutes-100 10] [--minutes-200 2] [--plain]

    Each row is one flight of `alula fly` (hover) against the mock in a process of its own on this machine. With --plain
    the flights run without SCHED_FIFO as well.
    """
    parser = options_of(timing.__doc__)
    parser.add_argument("--minutes-100", type=float, default=10.0)
    parser.add_argument("--minutes-200", type=float, default=2.0)
    parser.add_argument("--plain", action="store_true")
    options = parser.parse_args(words)
    lines = [
        "| flight | setpoints | arrival to departure, ms: median / p99 / max | processor time in it, ms: median, p99 | "
        "late: ours + scheduler | without estimate | worst, ms | hover error, mm | start-up, s | ended |",
        "| --- " * 10 + "|",
    ]
    for realtime in (True, False) if options.plain else (True,):
        for rate, minutes in ((100, options.minutes_100), (200, options.minutes_200)):
            report = fly(rate, 60 * minutes, realtime=realtime)
            lines.append(row(f"{rate} Hz, {minutes:g} min, {'SCHED_FIFO' if realtime else 'plain'}", report))
    load = os.getloadavg()[2]
    text = (
        "Arrival is when the kernel handed over the datagram with the estimate, departure when the setpoint was sent. "
        "A setpoint is late when it leaves more than half a period after it was due; it is ours when this thread's "
        "own work took at least half of that, the scheduler's when it waited for the processor. Start-up is from "
        "starting the process to the first setpoint, the wait for the vehicle's 1 Hz HEARTBEAT included. Mock and "
        f"daemon share {os.cpu_count()} cores, load average over the last 15 min {load:.1f}.\n\n"
    )
    return Page("flight_timing", "Timing of the daemon", text + "\n".join(lines))


RATE = 100


def records(rng: np.random.Generator, tick: int, now: float) -> list[Record]:
    """Records of one tick; every tenth has a horizon."""
    v3, v4 = rng.normal(size=3), rng.normal(size=4)
    made: list[Record] = [
        EstimateRecord(now, now, v3, v3, v4, v3, 3),
        ObservationRecord(
            tick, now, now, True, True, True, "OFFBOARD", False, "", False, np.zeros(3), 0.0, 9.8, False, ""
        ),
        TickRecord(
            tick, now, "estimate", now, 0.02, "ENGAGED", "track", "none", 0, 1e-4, 2e-4, 4e-4, ""
        ),
        ReferenceRecord(now, v3, v3, v4, v3),
        SetpointRecord(now, v3, 2.4, 0.5, 1.0),
    ]  # fmt: skip
    if tick % 10 == 0:
        line = rng.normal(size=21)
        made.append(HorizonRecord(now, line, line, line, line[:-1]))
    return made


def recorder(words: Sequence[str]) -> Page:
    """Cost of recording: the control thread per tick, the writer's thread per second of flight, and the disk.

    python -m benchmarks link recorder [--seconds 20]
    """
    parser = options_of(recorder.__doc__)
    parser.add_argument("--seconds", type=float, default=20.0)
    seconds = parser.parse_args(words).seconds
    rng = np.random.default_rng(1)
    frame = bytes(rng.integers(0, 256, 250, dtype=np.uint8))
    taken = []
    with tempfile.TemporaryDirectory() as folder:
        writer = Recorder(Path(folder), "flight", metadata={"seed": "1"})
        start, began, cpu, ours = time.monotonic(), time.monotonic(), time.process_time(), time.thread_time()
        for tick in range(round(seconds * RATE)):
            now = start + tick / RATE
            time.sleep(max(0.0, now - time.monotonic()))
            made = records(rng, tick, now)
            before = time.thread_time()
            for record in made:
                writer.put(record, now)
            writer.put_frame(frame, now)
            taken.append(time.thread_time() - before)
        writer.close()
        elapsed = time.monotonic() - began
        share = (time.process_time() - cpu - (time.thread_time() - ours)) / elapsed
        size = writer.path.stat().st_size / elapsed
        tlog = writer.path.with_suffix(".tlog").stat().st_size / elapsed
        trouble = writer.trouble or "none"
    median, p99 = np.percentile(taken, [50, 99]) * 1e6
    rows = [
        "| what | figure |",
        "| --- | --- |",
        f"| control thread, processor time per tick (median / p99) | {median:.1f} / {p99:.1f} us |",
        f"| writer thread, share of a core | {100 * share:.1f} % |",
        f"| MCAP, zstd | {size / 1e3:.0f} kB/s |",
        f"| tlog (one frame a tick here) | {tlog / 1e3:.0f} kB/s |",
        f"| dropped or failed | {trouble} |",
    ]
    text = f"{RATE} ticks a second for {seconds:g} s with every stream of a tick on, random numbers throughout.\n\n"
    return Page("recorder_cost", "Cost of recording", text + "\n".join(rows))


RECORDED = ROOT / "tests" / "data" / "px4_sih_flights" / "clocks.npz"
SECONDS = 60.0
SETTLED = 1.0  # s after which the clock has to be valid
HEADER = "| clock | restarts | invalid, s | steps followed | error RMS, ms | 99 % | greatest |"
# name, drift s/s, count s, round trip s, steps a minute
MADE = (
    ("drift -12 ms/s, counts in 4 ms, round trip 0.6 ms", -0.012, 4e-3, 6e-4, 6.0),
    ("the same, round trip 6 ms", -0.012, 4e-3, 6e-3, 6.0),
    ("drift +12 ms/s, counts in 4 ms", 0.012, 4e-3, 6e-4, 6.0),
    ("drift -12 ms/s, counts in 1 us", -0.012, 1e-6, 6e-4, 6.0),
    ("20 steps a minute", -0.012, 4e-3, 6e-4, 20.0),
    ("quiet: 20 ppm, round trip 3 ms", 2e-5, 1e-6, 3e-3, 0.0),
)


def clock_row(name: str, clocks: Iterable[VehicleClock], steps: int, invalid: float, errors: list[float]) -> str:
    """A row of the table. errors: s."""
    error = 1e3 * np.array(errors)
    figures = f"{np.sqrt(np.mean(error**2)):.2f} | {np.percentile(error, 99):.1f} | {np.max(error):.1f}"
    return f"| {name} | {sum(clock.resets for clock in clocks)} | {invalid:.1f} | {steps} | {figures} |"


def made(name: str, drift: float, quantum: float, round_trip: float, steps: float, seeds: int) -> str:
    """The row of a made clock over some seeds; a count of 4 ms is an error of 1.2 ms RMS by itself."""
    clocks, followed, invalid, errors = [], 0, 0.0, []
    for seed in range(seeds):
        vehicle = simulator_clock(100 + seed, drift, quantum, SECONDS, steps)
        exchange = Exchange(round_trip, seed)
        exchange.run(SETTLED, vehicle)
        while exchange.now < START + SECONDS - 2.0:
            exchange.run(PERIOD, vehicle)
            invalid += PERIOD * (not exchange.clock.is_valid(exchange.now))
            errors.append(exchange.error(vehicle))
        clocks.append(exchange.clock)
        followed += exchange.verdicts.count("stepped")
    return clock_row(f"{name} ({seeds} x {SECONDS:.0f} s)", clocks, followed, invalid, errors)


def recorded(name: str, ours: np.ndarray, vehicle: np.ndarray) -> str:
    """The row of a recorded clock; its error contains the link's delay and the clock's count, 4 ms each."""
    clock, verdicts, invalid, errors = VehicleClock(), [], 0.0, []
    for received, stamp in zip(ours.tolist(), vehicle.tolist(), strict=True):
        verdicts.append(clock.handle(received - 6e-4, received, stamp))
        if received > ours[0] + SETTLED:
            invalid += PERIOD * (not clock.is_valid(received))
            errors.append(abs(clock.to_vehicle(received) - stamp))
    return clock_row(f"recorded: {name}", [clock], verdicts.count("stepped"), invalid, errors)


def noticed(jump: float, seeds: int) -> str:
    """How many true jumps, s, are noticed, and within which time."""
    times = []
    for seed in range(seeds):
        exchange, vehicle = Exchange(6e-4, seed), simulator_clock(200 + seed, -0.011, 4e-3, SECONDS)
        exchange.run(30.0, vehicle)
        before = len(exchange.verdicts)
        jumped: Clock = lambda ours, clock=vehicle: clock(ours) + jump  # type: ignore[misc]  # noqa: E731
        exchange.run(2.0, jumped)
        reports = [n for n, verdict in enumerate(exchange.verdicts[before:]) if verdict in ("jumped", "ran_backwards")]
        times += reports[:1]
    slowest = f"{PERIOD * (max(times) + 1):.1f} s" if times else "-"
    return f"| {jump:+g} s | {len(times)} of {seeds} | {slowest} |"


def clock(words: Sequence[str]) -> Page:
    """How the filter of the vehicle's clock follows clocks as PX4's simulator has them, recorded and made, and quiet
    ones.

    A restart of the filter is an event of the flight and makes the clock invalid for half a second; before the filter
    judged clocks by the spread of their own stamps, the recorded ones restarted it 17 to 37 times.

        python -m benchmarks link clock [--seeds N]
    """
    parser = options_of(clock.__doc__)
    parser.add_argument("--seeds", type=int, default=10)
    seeds = parser.parse_args(words).seeds
    with np.load(RECORDED) as data:
        names = [name.removesuffix("_ours_usec") for name in data.files if name.endswith("_ours_usec")]
        rows = [
            recorded(name, 100 + data[f"{name}_ours_usec"] * 1e-6, 50 + data[f"{name}_vehicle_msec"] * 1e-3)
            for name in names
        ]
    rows += [made(*case, seeds) for case in MADE]
    jumps = [noticed(jump, seeds) for jump in (-30.0, -0.5, 0.1, 1.0)]
    table = [HEADER, "| --- | ---: | ---: | ---: | ---: | ---: | ---: |", *rows]
    table += [
        "",
        "True jumps on a simulator's clock:",
        "",
        "| jump | noticed | slowest |",
        "| --- | --- | --- |",
        *jumps,
    ]
    return Page("clock_filter", "The filter of the vehicle's clock", "\n".join(table))
