"""Peak accelerations of our manoeuvres beside the paper's Table I, and a picture of all eight.

python benchmarks/references_table.py
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from provenance import write_result

from dynamics.references import PAPER, check_feasibility, named_reference
from dynamics.vehicle_file import read_vehicle
from vehicles import FOLDER

PICTURE = Path(__file__).parent.parent / "docs" / "pictures" / "references.png"


def main() -> None:
    vehicle = read_vehicle(FOLDER / "arpl_250g.toml")
    rows = [
        "| manoeuvre | size m | top speed m/s | linear m/s^2 | Table I | angular rad/s^2 | Table I | top rotor rpm "
        "| can be flown |",
        "| --- " * 9 + "|",
    ]
    figure = Figure(figsize=(12, 6.2), layout="constrained")
    places = figure.subplots(2, 4).ravel()
    for name, place in zip(PAPER, places, strict=True):
        reference = named_reference(name, vehicle)
        motion = reference.sample(np.arange(0, reference.duration, 0.002))
        linear, angular = PAPER[name].peaks or (float("nan"), float("nan"))
        size = " x ".join(f"{extent:.2f}" for extent in np.ptp(motion.position, axis=0))
        rpm = motion.rotor_speed.max() * 30 / np.pi
        verdict = "yes" if check_feasibility(reference, vehicle).is_feasible else "no"
        rows.append(
            f"| {name} | {size} | {np.linalg.norm(motion.velocity, axis=1).max():.2f} | "
            f"{np.linalg.norm(motion.acceleration, axis=1).max():.2f} | {linear:.2f} | "
            f"{np.linalg.norm(motion.rate_acceleration, axis=1).max():.2f} | {angular:.2f} | {rpm:.0f} | {verdict} |"
        )
        first, second = sorted(np.argsort(np.ptp(motion.position, axis=0))[-2:])
        place.plot(motion.position[:, first], motion.position[:, second], color="#0072b2", linewidth=1)
        place.set(title=name, xlabel=f"{'xyz'[first]}, m", ylabel=f"{'xyz'[second]}, m", aspect="equal")
        place.margins(0.1)
    PICTURE.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(PICTURE, dpi=110)
    note = (
        "Ellipse_1 cannot have Table I's angular peak: at 1.1 m/s^2 that takes an ellipse of 2 cm radius at 1.1 Hz. "
        "TransposedParabola cannot have its linear peak: with 5 % of the rotors' range kept for control, full thrust "
        "is 18.3 m/s^2, gravity included. Both were measured on a real vehicle, whose peaks hold its noise as well."
    )
    write_result("references", "The manoeuvres against Table I", "\n".join([*rows, "", note]))


if __name__ == "__main__":
    main()
