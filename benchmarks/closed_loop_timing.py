"""From an estimate's arrival on the socket to the setpoint's departure, and deadlines kept, in real time over UDP.

`alula fly --realtime` beside `alula mock`, each a process of its own: 100 Hz for ten minutes and 200 Hz for two.
Arrival is the kernel's time stamp of the datagram, departure is when `send` has returned. A deadline is missed when a
setpoint leaves more than a period late; the daemon attributes each to the link, the scheduler or itself.

    python benchmarks/closed_loop_timing.py [--minutes100 10] [--minutes200 2]
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys

from provenance import write_result

from alula.embedded_mock import embedded_mock


def fly(rate: float, seconds: float) -> dict[str, object]:
    with embedded_mock("arpl_250g") as link:
        command = [sys.executable, "-m", "alula", "fly", "--link", link, "--vehicle", "arpl_250g", "--json"]
        command += ["--reference", "circle", "--duration", str(seconds), "--rate", str(rate), "--realtime"]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise SystemExit(done.stderr[-2000:])
    report: dict[str, object] = json.loads(done.stdout)
    return report


def row(rate: float, seconds: float) -> str:
    report = fly(rate, seconds)
    timing, tracking = report["timing"], report["tracking"]
    latency, interval = timing["latency"], timing["interval"]
    missed = ", ".join(f"{count} by {cause}" for cause, count in timing["missed"].items())
    return (
        f"| {rate:.0f} Hz, {seconds / 60:.1f} min | {1e3 * latency['median']:.2f} | {1e3 * latency['p99']:.2f} | "
        f"{1e3 * latency['max']:.2f} | {1e3 * interval['median']:.2f} | {1e3 * interval['p99']:.2f} | "
        f"{timing['ticks']} | {missed} | {tracking['position_rmse']:.3f} | {report['start_up']:.2f} |"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--minutes100", type=float, default=10.0)
    parser.add_argument("--minutes200", type=float, default=2.0)
    arguments = parser.parse_args()
    head = (
        "| flight | latency ms, median | p99 | max | between setpoints ms, median | p99 | setpoints | late setpoints | "
        "position RMSE m | start-up s |"
    )
    lines = [head, "| --- " * 10 + "|"]
    lines.append(row(100.0, 60 * arguments.minutes100))
    lines.append(row(200.0, 60 * arguments.minutes200))
    write_result("closed_loop_timing", "Real-time flight over UDP: latency and deadlines", "\n".join(lines))


if __name__ == "__main__":
    main()
