"""Two goals of the trained models: the ratios of the paper's own pipeline, and training slow to fly fast.

Needs `alula campaign --out build/campaign_learning`. Trains through `alula train`; interrupted, it resumes.

The paper's pipeline: zero-phase filter on inputs and labels, measured rotor speeds, body-frame PI-TCN, two seeds, each
beside the paper's own ratios; the control, a network without the motors, is the study `motors` of `learning.py`.
Trained slow: the flights at six tenths of their speed alone, four members, a network and a grey box whose effects are
fitted to the same slow flights.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
from pathlib import Path

from benchmarks.provenance import write_result
from studies.paper import prediction_ratio
from studies.sweep.catalogue import SLOW
from studies.tables import Table, TableCell, markdown
from training import checkpoint
from training.calibration import calibration
from training.card import FlightError
from training.checkpoint import TrainedModel
from training.data.labelled_rows import LabelledRows, label_rows
from training.data.logged_flights import find_logs, read_logged_flights
from training.ground_truth import true_label
from training.prediction import flight_errors, pooled, predict

ROOT = Path(__file__).resolve().parents[1]
CAMPAIGN, BUILD = ROOT / "build" / "campaign_learning", ROOT / "build" / "learning_goals"
EFFECTS = (
    "motor_lag",
    "rotor_drag",
    "parasitic_drag",
    "blade_flapping",
    "axial_inflow",
    "translational_lift",
    "thrust_constant",
    "inertia",
)
NAMED = tuple(word for effect in EFFECTS for word in ("--effect", effect))
FILTERED = ("--filtered-inputs", "--label", "instantaneous", "--motors", "measured")
PAPER_STEPS, PAPER_BATCH = 30_000, 512
GREY_STEPS = 12_000


def trained(name: str, logs: list[Path], *arguments: str, jobs: int = 2) -> TrainedModel:
    """The model of `alula train` with these arguments, trained now unless an earlier run has done it."""
    file = BUILD / f"{name}.pt"
    if not file.exists():
        file.parent.mkdir(parents=True, exist_ok=True)
        command = [
            sys.executable,
            "-m",
            "alula",
            "train",
            *map(str, logs),
            "--vehicle",
            "arpl_250g",
            "--out",
            str(file),
            "--resume",
            "--jobs",
            str(jobs),
            *arguments,
        ]
        subprocess.run(command, check=True, env={**os.environ, "OMP_NUM_THREADS": "1"})
    return checkpoint.load(file)


def judged(model: TrainedModel) -> LabelledRows:
    """The eight test flights as the model takes them."""
    recordings = read_logged_flights(find_logs([CAMPAIGN / "test"]), dt=model.config.dt, may_be_tests=True)
    return label_rows(model.config, model.vehicle, recordings)


def paper_pipeline() -> Table:
    """RMSE over NOM's against the filtered labels, every seed by itself, beside the paper's."""
    model = trained(
        "paper_pipeline",
        [CAMPAIGN],
        "--model",
        "pi_tcn",
        "--ensemble",
        "2",
        "--steps",
        str(PAPER_STEPS),
        "--batch",
        str(PAPER_BATCH),
        "--physics-weight",
        "0",
        *FILTERED,
    )
    data = judged(model)
    seeds = [flight_errors(data, predict(model, data, member=place).body) for place in range(len(model.networks))]
    rows = []
    for errors in zip(*seeds, strict=True):
        ours = [error.combined / error.nominal for error in errors]
        paper = prediction_ratio(errors[0].flight, "pi_tcn")
        assert paper is not None
        below = "yes" if max(ours) < paper else "no"
        rows.append((Path(errors[0].flight).stem, errors[0].nominal, *ours, paper, below))
    headings = ("flight", "NOM", *(f"seed {place}, / NOM" for place in range(len(seeds))), "paper, / NOM", "below")
    note = f"{PAPER_STEPS:,} steps of {PAPER_BATCH} windows."
    return Table(
        "paper_pipeline", "The paper's pipeline: RMSE over NOM's, against its labels", headings, tuple(rows), note
    )


def trained_slow() -> list[Table]:
    """Errors against the truth on the eight test flights of models that saw slow flights alone; what they flag."""
    slow = sorted((CAMPAIGN / "train").glob(SLOW))
    network = trained("slow_pi_tcn", slow, "--model", "pi_tcn")
    grey = trained("slow_grey_box", slow, "--model", "grey_box", "--steps", str(GREY_STEPS), *NAMED)
    errors: dict[str, tuple[FlightError, ...]] = {}
    signs = []
    for name, model in (("PI-TCN", network), ("grey box", grey)):
        data = judged(model)
        truth = true_label(data, CAMPAIGN, dt=model.config.dt)
        errors[name] = flight_errors(data, predict(model, data).body, truth)
        if model.config.base == "grey_box":
            assert data.base is not None
            errors["its named effects alone"] = flight_errors(data, data.base[data.ends], truth)
            errors["grey box, not gated"] = flight_errors(data, predict(model, data, gated=False).body, truth)
        reliability = calibration(model, data, truth)
        assert reliability is not None
        signs.append((name, reliability.auroc, reliability.coverage, reliability.faded, sum(model.card.seconds)))
    flights = [error.flight for error in errors["PI-TCN"]]
    rows: list[tuple[TableCell, ...]] = [
        (Path(flight).stem, errors["PI-TCN"][place].nominal, *(each[place].combined for each in errors.values()))
        for place, flight in enumerate(flights)
    ]
    everything = [pooled(each) for each in errors.values()]
    rows.append(("all", everything[0].nominal, *(each.combined for each in everything)))
    return [
        Table("slow", "Trained slow, flown fast: RMSE against the truth", ("flight", "NOM", *errors), tuple(rows)),
        Table(
            "slow_flags",
            "Trained slow: what the four members' disagreement flags",
            ("model", "AUROC, worst tenth", "within 90 % error bars", "residual faded", "s of training, all members"),
            tuple(signs),
        ),
    ]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.parse_args()
    tables = [paper_pipeline(), *trained_slow()]
    write_result("learning_goals", "The paper's pipeline; trained slow, flown fast", "\n\n".join(map(markdown, tables)))


if __name__ == "__main__":
    main()
