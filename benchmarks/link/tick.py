"""From an estimate's arrival to its setpoint's departure: the tick in C and in Python, quiet and beside other work."""

from __future__ import annotations

import contextlib
import json
import multiprocessing
import os
import socket
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from benchmarks.link.flood import LOCAL, Flood, running, send_flood
from benchmarks.link.soak import VEHICLE, give_processor
from benchmarks.measurement import Page, options_of
from dynamics.arrays import Floats
from runtime.flight.phases import PHASES, Handler, Phase
from runtime.record.recording import FlightRecording, read_recording
from runtime.record.records import ObservationRecord, TickRecord
from runtime.urgent_tick import SWITCH
from simulation.mock_process import mock_process

LOOPS = 8  # busy programs
RATES = (100, 200, 500)  # Hz
# a supervisor that computes without a pause: the command line with a thread that never lets go of the interpreter
BUSY_SUPERVISOR = """
import sys, threading
from alula.__main__ import main
def compute():
    total = 0
    while True:
        total += 1
threading.Thread(target=compute, daemon=True).start()
sys.argv = ["alula", *sys.argv[1:]]
main()
"""
# a loop that only waits, as high in priority as the control thread where that is permitted: how late it wakes up, s
IDLE_LOOP = """
import json, os, sys, time
from alula.cli.fly import REALTIME_PRIORITY
rate, seconds = float(sys.argv[1]), float(sys.argv[2])
try:
    os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(REALTIME_PRIORITY))
except OSError:
    pass
start, late = time.monotonic(), []
for number in range(1, round(rate * seconds) + 1):
    due = start + number / rate
    time.sleep(max(0.0, due - time.monotonic()))
    late.append(time.monotonic() - due)
print(json.dumps(late))
"""
STRANGERS = Flood("random bytes", 50_000, from_vehicle=False)
SITUATIONS = ("quiet", "beside eight busy loops", "with a busy supervisor", "under a flood")


@contextlib.contextmanager
def busy_loops(count: int) -> Iterator[None]:
    """Programs that compute without a pause, at the usual priority."""
    processes = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(count)]
    try:
        yield
    finally:
        for process in processes:
            process.kill()
            process.wait()


@contextlib.contextmanager
def flood_of_strangers(port: int) -> Iterator[None]:
    """Datagrams to a port of this machine from an address that is not the vehicle's."""
    sent = multiprocessing.get_context("fork").Value("q", 0, lock=False)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
        stranger.bind((LOCAL, 0))
        with running(send_flood, (LOCAL, port), stranger, STRANGERS, sent):
            yield


def idle_row(rate: int, seconds: float) -> str:
    """Line of a loop that wakes up at a rate and does nothing: what the machine adds to any program."""
    command = [sys.executable, "-c", IDLE_LOOP, str(rate), str(seconds)]
    late = np.array(json.loads(subprocess.run(command, capture_output=True, check=True, timeout=seconds + 60).stdout))
    median, p99, largest = 1e3 * np.percentile(late, [50, 99, 100])
    count = np.count_nonzero(late > 0.5 / rate)
    return f"| {rate} Hz, idle loop, no flight | {late.size} | | {median:.2f} / {p99:.2f} / {largest:.2f} | {count} |"


def fly(rate: int, seconds: float, *, situation: str, python: bool) -> FlightRecording:
    """The recording of a hover of `alula fly` against the mock. python: whether every tick is Python's."""
    loops = LOOPS if situation == SITUATIONS[1] else 0
    program = ["-c", BUSY_SUPERVISOR] if situation == SITUATIONS[2] else ["-m", "alula"]
    with contextlib.ExitStack() as stack:
        mock = stack.enter_context(mock_process(vehicle=VEHICLE))
        stack.enter_context(busy_loops(loops))
        folder = stack.enter_context(tempfile.TemporaryDirectory())
        give_processor(mock.process.pid)
        if situation == SITUATIONS[3]:
            stack.enter_context(flood_of_strangers(mock.port))
        options = ["--vehicle", VEHICLE, "--reference", "hover", "--duration", str(seconds), "--rate", str(rate)]
        options += ["--link", mock.url, "--record", folder, "--json"]
        subprocess.run(
            [sys.executable, *program, "fly", *options],
            env=os.environ | ({SWITCH: "python"} if python else {}),
            capture_output=True,
            check=False,
            timeout=seconds + 120,
        )
        return read_recording(max(Path(folder).glob("*.mcap")))


def departures(recording: FlightRecording) -> tuple[Floats, float, int]:
    """Times (n,) from arrival to departure, s, of ticks by an estimate that the controller flies; the share that C
    answered; and setpoints that left more than half a period late because of this program."""
    answered = {observation.tick: observation.answered for observation in recording.records(ObservationRecord)}
    flown: list[TickRecord] = [
        tick
        for tick in recording.records(TickRecord)
        if tick.trigger == "estimate"
        and PHASES[Phase(tick.phase)].handler is Handler.FLY
        and np.isfinite(tick.departure_seconds)
    ]
    times = np.array([tick.departure_seconds for tick in flown])
    late = sum(tick.late_cause == "ours" for tick in flown)
    return times, sum(answered[tick.tick] for tick in flown) / max(len(flown), 1), late


def row(name: str, recording: FlightRecording) -> str:
    """One line of the table."""
    times, share, late = departures(recording)
    if not times.size:
        return f"| {name} | not flown | | | | |"
    median, p99, largest = 1e3 * np.percentile(times, [50, 99, 100])
    return f"| {name} | {times.size} | {share:.0%} | {median:.2f} / {p99:.2f} / {largest:.2f} | {late} |"


def tick(words: Sequence[str]) -> Page:
    """From an estimate's arrival to its setpoint's departure, in C and in Python, quiet and beside other work.

        python -m benchmarks link tick [--seconds 20] [--rates 100 200 500]

    Each row is one hover of `alula fly` over UDP against the mock in a process of its own on this machine; counted are
    the ticks by an estimate in phases that the controller flies, take-off and ground left out.
    """
    parser = options_of(tick.__doc__, seconds=20.0)
    parser.add_argument("--rates", type=int, nargs="+", default=list(RATES))
    options = parser.parse_args(words)
    lines = [
        "| flight | ticks | answered in C | arrival to departure, ms: median / p99 / max | late by us |",
        "| --- " * 5 + "|",
    ]
    for rate in options.rates:
        for situation in SITUATIONS:
            for python in (False, True):
                recording = fly(rate, options.seconds, situation=situation, python=python)
                lines.append(row(f"{rate} Hz, {situation}, {'Python' if python else 'C'}", recording))
                print(lines[-1], flush=True)
        lines.append(idle_row(rate, options.seconds))
        print(lines[-1], flush=True)
    text = (
        "Arrival is when the kernel handed over the datagram with the estimate, departure when the setpoint was sent; "
        "late is more than half a period. The busy loops are programs of the usual priority; the busy supervisor is a "
        "thread of `alula fly` itself that computes without a pause and keeps the interpreter's lock as long as it "
        f"may; the flood is {STRANGERS.rate:,} datagrams a second of {STRANGERS.kind} to the link's port from an "
        "address of its own. An idle loop, a program that waits for times at the rate and does nothing, says how late "
        "it woke up: what this machine adds by itself. Link, control thread, idle loop and, below them, the mock run "
        "under SCHED_FIFO where the system permits it. Mock and daemon share "
        f"{os.cpu_count()} cores, load average over the last 15 min {os.getloadavg()[2]:.1f}.\n\n"
        "In the two flights of an hour of `python -m benchmarks link soak` (soak.md) 32 of 724,122 setpoints were late "
        "because of this program.\n\n"
    )
    return Page("tick", "The tick in C", text + "\n".join(lines))
