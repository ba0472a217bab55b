"""How long the paper's 58 minutes take to fly again, and how much memory: the whole campaign, as a user runs it.

python -m benchmarks.campaign_speed [--flights PATTERN] [--jobs J]
"""

from __future__ import annotations

import argparse
import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import msgspec
import numpy as np

from benchmarks.provenance import write_result
from flights import Flight
from simulation.campaign import MANIFEST, CampaignManifest
from training.data.labels import paper_label

PATIENCE = 7200.0  # s


def label_peaks(folder: Path) -> tuple[float, float]:
    """The greatest linear (m/s^2) and angular (rad/s^2) acceleration among all flights' labels."""
    labels = [paper_label(Flight.read(file)) for split in ("train", "test") for file in (folder / split).iterdir()]
    linear, angular = (
        max(float(np.nanmax(np.linalg.norm(label[:, part], axis=1))) for label in labels)
        for part in (slice(0, 3), slice(3, 6))
    )
    return linear, angular


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--flights", default="*")
    parser.add_argument("--jobs", type=int, default=2)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        command = ["campaign", "--out", name, "--flights", options.flights, "--jobs", str(options.jobs), "--json"]
        start, load = time.perf_counter(), os.getloadavg()[0]
        subprocess.run(
            [sys.executable, "-m", "alula", *command], check=True, timeout=PATIENCE, stdout=subprocess.DEVNULL
        )
        wall = time.perf_counter() - start
        load = max(load, os.getloadavg()[0])
        manifest = msgspec.json.decode((Path(name) / MANIFEST).read_bytes(), type=CampaignManifest)
        labels = label_peaks(Path(name))
        size = sum(file.stat().st_size for file in Path(name).rglob("*.parquet"))
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    processor = used.ru_utime + used.ru_stime
    slower = [flight for flight in manifest.flights if flight.speed < 1.0]
    rows = [
        ("flights", f"{len(manifest.flights)}"),
        ("simulated", f"{manifest.duration / 60:.1f} min"),
        ("wall time", f"{wall / 60:.1f} min, {manifest.duration / wall:.0f} x real time"),
        ("processor time", f"{processor / 60:.1f} min, {manifest.duration / processor:.0f} x real time on one core"),
        ("largest process", f"{used.ru_maxrss / 1024:.0f} MB"),
        ("on disk, truth included", f"{size / 2**20:.0f} MB"),
        ("peak speed", f"{manifest.peak_speed:.1f} m/s (paper 6)"),
        ("peak acceleration, true", f"{manifest.peak_acceleration:.1f} m/s^2 (paper 18)"),
        ("peak acceleration, label", f"{labels[0]:.1f} m/s^2 (paper 18)"),
        ("peak angular acceleration, true, over 10 ms", f"{manifest.peak_angular_acceleration:.1f} rad/s^2 (paper 54)"),
        ("peak angular acceleration, label", f"{labels[1]:.1f} rad/s^2 (paper 54)"),
        ("peak rotor speed", f"{manifest.peak_rotor_rpm:.0f} rpm (paper 16,628)"),
        ("flown slower than the reference", ", ".join(f"{f.name} at {f.speed:.2f}" for f in slower) or "none"),
    ]
    lines = ["| | |", "| --- | --- |", *(f"| {name} | {value} |" for name, value in rows)]
    text = (
        f"`alula campaign` in {options.jobs} processes, seed {manifest.recipe.seed}. The machine was shared: load "
        f"average up to {load:.1f} on {os.cpu_count()} cores, so that the processor time is the more reliable one. "
        "True peaks are the vehicle's; labels are made of what it measured by the paper's processing at 5 Hz, as the "
        "paper's peaks must be.\n\n"
    )
    write_result("campaign_speed", "The paper's campaign, flown again", text + "\n".join(lines))


if __name__ == "__main__":
    main()
