"""Peak accelerations of our manoeuvres, references and flights, beside the paper's Table I, and a picture of all eight.

Flown as in a campaign: the nominal controller, a vehicle with hidden drags, lags and gusts, sensor noise. Of a flight's
peaks there are two: of the true motion over 10 ms, and of the labels that the paper's processing makes of the measured
one (velocity and rates smoothed at 5 Hz), which is what Table I's must be.

python -m benchmarks.references_table
"""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from benchmarks.provenance import write_result
from dynamics.references import PAPER, check_feasibility, named_reference
from dynamics.vehicle_file import read_vehicle
from flights import Flight
from simulation.campaign import Campaign, CampaignOptions
from training.data.labels import paper_label
from vehicles import FOLDER

PICTURE = Path(__file__).parent.parent / "docs" / "pictures" / "references.png"


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


def main() -> None:
    vehicle = read_vehicle(FOLDER / "arpl_250g.toml")
    rows = [
        "| manoeuvre | size m | top speed m/s | linear m/s^2: Table I | reference | flown, true | flown, label "
        "| angular rad/s^2: Table I | reference | flown, true | flown, label | top rotor rpm, flown | can be flown |",
        "| --- " * 13 + "|",
    ]
    figure = Figure(figsize=(12, 6.2), layout="constrained")
    places = figure.subplots(2, 4).ravel()
    for name, place in zip(PAPER, places, strict=True):
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
    PICTURE.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(PICTURE, dpi=110)
    note = (
        "Ellipse_1's angular peak in Table I is none of its reference, which would take an ellipse of 2 cm radius at "
        "1.1 Hz: it is what gusts and noise leave in the label, here as there. Near full thrust a vehicle turns harder "
        "than its reference, because it corrects what its limits kept it from; so TransposedParabola's has less."
    )
    write_result("references", "The manoeuvres against Table I", "\n".join([*rows, "", note]))


if __name__ == "__main__":
    main()
