"""Cost of recording: the control thread per tick, the writer's thread per second of flight, and the disk.

python -m benchmarks.recorder_cost [--seconds 20]
"""

from __future__ import annotations

import argparse
import tempfile
import time
from pathlib import Path

import numpy as np

from benchmarks.provenance import write_result
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


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=20.0)
    seconds = parser.parse_args().seconds
    rng = np.random.default_rng(1)
    frame = bytes(rng.integers(0, 256, 250, dtype=np.uint8))
    taken = []
    with tempfile.TemporaryDirectory() as folder:
        recorder = Recorder(Path(folder), "flight", metadata={"seed": "1"})
        start, began, cpu, ours = time.monotonic(), time.monotonic(), time.process_time(), time.thread_time()
        for tick in range(round(seconds * RATE)):
            now = start + tick / RATE
            time.sleep(max(0.0, now - time.monotonic()))
            made = records(rng, tick, now)
            before = time.thread_time()
            for record in made:
                recorder.put(record, now)
            recorder.put_frame(frame, now)
            taken.append(time.thread_time() - before)
        recorder.close()
        elapsed = time.monotonic() - began
        writer = (time.process_time() - cpu - (time.thread_time() - ours)) / elapsed
        size = recorder.path.stat().st_size / elapsed
        tlog = recorder.path.with_suffix(".tlog").stat().st_size / elapsed
        trouble = recorder.trouble or "none"
    median, p99 = np.percentile(taken, [50, 99]) * 1e6
    rows = [
        "| what | figure |",
        "| --- | --- |",
        f"| control thread, processor time per tick (median / p99) | {median:.1f} / {p99:.1f} us |",
        f"| writer thread, share of a core | {100 * writer:.1f} % |",
        f"| MCAP, zstd | {size / 1e3:.0f} kB/s |",
        f"| tlog (one frame a tick here) | {tlog / 1e3:.0f} kB/s |",
        f"| dropped or failed | {trouble} |",
    ]
    text = f"{RATE} ticks a second for {seconds:g} s with every stream of a tick on, random numbers throughout.\n\n"
    write_result("recorder_cost", "Cost of recording", text + "\n".join(rows))


if __name__ == "__main__":
    main()
