"""Training recipes of networks, how each then predicts, and how it flies: one member each.

Needs `alula campaign --out build/campaign_learning`. Trains through `alula train`; interrupted, it resumes.
Flown: 15 s of the Lemniscate in lockstep on the campaign's vehicle with all that it hides, as `table_two.py` does.
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

from benchmarks.learning_goals import BUILD, CAMPAIGN, NAMED, judged, trained
from benchmarks.provenance import write_result
from benchmarks.table_two import FIRST_SEED
from benchmarks.table_two_worker import DURATION, VEHICLE, Run, in_lockstep
from dynamics.vehicle_file import find_vehicle
from export.bundle import ExportOptions, export_bundle
from export.trained import read_model
from runtime.control.rti.problem import Problem
from runtime.control.rti.processor import native_processor
from studies.tables import Table, TableCell, markdown
from training.ground_truth import true_label
from training.prediction import flight_errors, pooled, predict

PLAUSIBLE = ("--physics-points", "plausible", "--physics-weight", "0.01")
SPACE = ("--physics-points", "space", "--physics-weight", "1")
TRAININGS = {
    "lambda 0.01 on plausible histories": ("pi_tcn", *PLAUSIBLE, "--input-noise", "0"),
    "lambda 0.01 on plausible histories, noise 0.3": ("pi_tcn", *PLAUSIBLE, "--input-noise", "0.3"),
    "MSE-TCN, roll-outs of 20 steps, noise 0.1": (
        "mse_tcn", "--rollout", "20", "--input-noise", "0.1", "--steps", "3000",
    ),
    "lambda 1 on the whole space": ("pi_tcn", *SPACE, "--input-noise", "0"),
    "lambda 1 on the whole space, noise 0.3": ("pi_tcn", *SPACE, "--input-noise", "0.3"),
    "lambda 1 on pulses, lag of the rotors fitted": ("pi_tcn", "--input-noise", "0"),
    "lambda 1 on pulses, lag of the rotors fitted, noise 0.3 (default)": ("pi_tcn",),
    "lambda 1 on pulses, all effects named, noise 0.1": ("pi_tcn", *NAMED, "--input-noise", "0.1"),
    "lambda 1 on pulses, all effects named, noise 0.3": ("pi_tcn", *NAMED),
    "PI-MLP, lambda 1 on the whole space": ("pi_mlp",),
}  # fmt: skip


def flown(path: str) -> tuple[TableCell, TableCell, TableCell]:
    """Position RMSE in cm, share of the time that physics flew in the model's place, and why it ended early."""
    flight = in_lockstep(Run("lockstep", "", path, "", "Lemniscate", FIRST_SEED))
    return 100 * flight.position_rmse, flight.fallback_seconds / DURATION, flight.ended


def row(name: str, place: int) -> tuple[TableCell, ...]:
    """How a variant predicts the test flights against the truth, and how it flies."""
    model, *options = TRAININGS[name]
    label = f"flies_{place}"
    member = trained(label, [CAMPAIGN], "--model", model, "--ensemble", "1", *options, jobs=1)
    data = judged(member)
    error = pooled(flight_errors(data, predict(member, data).body, true_label(data, CAMPAIGN, dt=member.config.dt)))
    with tempfile.TemporaryDirectory() as folder:
        bundle = Path(folder) / "bundle"
        export_bundle(read_model(BUILD / f"{label}.pt"), bundle, ExportOptions(Problem(), native_processor()))
        return name, error.combined, *flown(str(bundle))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.parse_args()
    rows = [("nominal model", None, *flown(str(find_vehicle(VEHICLE))))]
    rows += [row(name, place) for place, name in enumerate(TRAININGS)]
    headings = ("trained with", "RMSE against the truth", "Lemniscate, cm", "share that physics flew", "ended early")
    note = "One member and one flight each. Physics takes over where a network makes the vehicle oscillate."
    table = Table("networks_that_fly", "Predicting and flying", headings, tuple(rows), note)
    write_result("networks_that_fly", "Networks that fly", markdown(table))


if __name__ == "__main__":
    main()
