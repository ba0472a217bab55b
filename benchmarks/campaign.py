"""The paper's campaign: time and memory to fly it again, and its manoeuvres beside Table I."""

from __future__ import annotations

import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import msgspec
import numpy as np
from matplotlib.figure import Figure

from benchmarks.measurement import ROOT, Page, add_names, options_of
from dynamics.references import PAPER, check_feasibility, named_reference
from dynamics.vehicle_file import read_vehicle
from flights import Flight
from simulation.campaign import MANIFEST, Campaign, CampaignManifest, CampaignOptions
from training.data.labels import paper_label
from vehicles import FOLDER

PATIENCE = 7200.0  # s


def label_peaks(folder: Path) -> tuple[float, float]:
    """The greatest linear (m/s^2) and angular (rad/s^2) acceleration among all flights' labels."""
    labels = [
        paper_label(Flight.read(file)) for split in ("train", "test") for file in (folder / split).glob("*.parquet")
    ]
    linear, angular = (
        max(float(np.nanmax(np.linalg.norm(label[:, part], axis=1))) for label in labels)
        for part in (slice(0, 3), slice(3, 6))
    )
    return linear, angular


def speed(words: Sequence[str]) -> Page:
    """How long the paper's 58 minutes take to fly again, and how much memory: the whole campaign, as a user runs it.

    python -m benchmarks campaign speed [--flights PATTERN] [--jobs J]
    """
    parser = options_of(speed.__doc__)
    parser.add_argument("--flights", default="*")
    parser.add_argument("--jobs", type=int, default=2)
    options = parser.parse_args(words)
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
    return Page("campaign_speed", "The paper's campaign, flown again", text + "\n".join(lines))


PICTURE = ROOT / "docs" / "pictures" / "references.png"


@dataclass(frozen=True)
class Flown:
    """Peaks of one flight: (linear m/s^2, angular rad/s^2) of the truth and of the labels, and of the rotors, rpm."""

    true: tuple[float, float]
    label: tuple[float, float]
    rpm: float


def peak(vectors: np.ndarray) -> float:
    return float(np.nanmax(np.linalg.norm(vectors, axis=1)))


def fly(name: str) -> Flown:
    with tempfile.TemporaryDirectory() as folder:
        manifest = Campaign(CampaignOptions(Path(folder), flights=(name,), jobs=1)).run(lambda _: None)
        label = paper_label(Flight.read(Path(folder) / "test" / f"{name}.parquet"))
    (summary,) = manifest.flights
    true = summary.peak_acceleration, summary.peak_angular_acceleration
    return Flown(true, (peak(label[:, :3]), peak(label[:, 3:])), summary.peak_rotor_rpm)


def references(words: Sequence[str]) -> Page:
    """Peak accelerations of our manoeuvres, references and flights, beside the paper's Table I, and a picture of all
    eight.

    Flown as in a campaign: the nominal controller, a vehicle with hidden drags, lags and gusts, sensor noise. Of a
    flight's peaks there are two: of the true motion over 10 ms, and of the labels that the paper's processing makes of
    the measured one (velocity and rates smoothed at 5 Hz), which is what Table I's must be.

    python -m benchmarks campaign references
    """
    parser = options_of(references.__doc__)
    add_names(parser, "--manoeuvres", PAPER)
    chosen = parser.parse_args(words)
    vehicle = read_vehicle(FOLDER / "arpl_250g.toml")
    rows = [
        "| manoeuvre | size m | top speed m/s | linear m/s^2: Table I | reference | flown, true | flown, label "
        "| angular rad/s^2: Table I | reference | flown, true | flown, label | top rotor rpm, flown | can be flown |",
        "| --- " * 13 + "|",
    ]
    figure = Figure(figsize=(12, 6.2), layout="constrained")
    places = figure.subplots(2, 4).ravel()
    for name, place in zip(chosen.manoeuvres, places, strict=False):
        reference = named_reference(name, vehicle)
        motion = reference.sample(np.arange(0, reference.duration, 0.002))
        linear, angular = PAPER[name].peaks or (float("nan"), float("nan"))
        size = " x ".join(f"{extent:.2f}" for extent in np.ptp(motion.position, axis=0))
        flown = fly(name)
        verdict = "yes" if check_feasibility(reference, vehicle).is_feasible else "no"
        rows.append(
            f"| {name} | {size} | {peak(motion.velocity):.2f} | {linear:.2f} | {peak(motion.acceleration):.2f} | "
            f"{flown.true[0]:.2f} | {flown.label[0]:.2f} | {angular:.2f} | {peak(motion.rate_acceleration):.2f} | "
            f"{flown.true[1]:.2f} | {flown.label[1]:.2f} | {flown.rpm:.0f} | {verdict} |"
        )
        first, second = sorted(np.argsort(np.ptp(motion.position, axis=0))[-2:])
        place.plot(motion.position[:, first], motion.position[:, second], color="#0072b2", linewidth=1)
        place.set(title=name, xlabel=f"{'xyz'[first]}, m", ylabel=f"{'xyz'[second]}, m", aspect="equal")
        place.margins(0.1)
    if not (chosen.no_page or chosen.quick):
        PICTURE.parent.mkdir(parents=True, exist_ok=True)
        figure.savefig(PICTURE, dpi=110)
    note = (
        "Ellipse_1's angular peak in Table I is none of its reference, which would take an ellipse of 2 cm radius at "
        "1.1 Hz: it is what gusts and noise leave in the label, here as there. Near full thrust a vehicle turns harder "
        "than its reference, because it corrects what its limits kept it from; so TransposedParabola's has less."
    )
    return Page("references", "The manoeuvres against Table I", "\n".join([*rows, "", note]))
