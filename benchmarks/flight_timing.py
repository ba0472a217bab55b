"""From an estimate's arrival to the setpoint's departure, late setpoints and their causes, start-up: over real UDP.

    python -m benchmarks.flight_timing [--minutes-100 10] [--minutes-200 2] [--plain]

Each row is one flight of `alula fly` (hover) against the mock in a process of its own on this machine. With --plain
the flights run without SCHED_FIFO as well.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from typing import Any

from benchmarks.provenance import write_result

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


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--minutes-100", type=float, default=10.0)
    parser.add_argument("--minutes-200", type=float, default=2.0)
    parser.add_argument("--plain", action="store_true")
    options = parser.parse_args()
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
    write_result("flight_timing", "Timing of the daemon", text + "\n".join(lines))


if __name__ == "__main__":
    main()
