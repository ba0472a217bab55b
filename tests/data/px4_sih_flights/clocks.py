"""Writes clocks.npz in this folder: PX4's clock against the companion's in four of the flights, ten times a second.

Needs the full recordings, which are too large to be kept here:
    PYTHONPATH=. python tests/data/px4_sih_flights/clocks.py FOLDER_OF_FULL_RECORDINGS
PX4 in simulation counts in steps of 4 ms; a recording has an estimate's arrival and its time on the companion's clock,
whose differences round to PX4's steps. The link's delay of ODOMETRY, up to 4 ms, is left in.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

from runtime.record.recording import read_recording

FLIGHTS = ("nothing_1_circle", "drag2_4_lemniscate", "tipped_44deg", "crash_circle")
STEP = 0.004  # s

if __name__ == "__main__":
    columns = {}
    for name in FLIGHTS:
        table = read_recording(Path(sys.argv[1]) / f"{name}.mcap").table("/estimate")
        arrival = table["arrival"]
        steps = np.concatenate([[0], np.cumsum(np.round(np.diff(table["time"]) / STEP))])
        rows = np.unique(np.searchsorted(arrival, np.arange(arrival[0], arrival[-1], 0.1)))
        columns[f"{name}_ours_usec"] = np.round((arrival[rows] - arrival[0]) * 1e6).astype(np.int32)
        columns[f"{name}_vehicle_msec"] = (steps[rows] * STEP * 1e3).astype(np.int32)
    np.savez_compressed(Path(__file__).with_name("clocks.npz"), **columns)
