"""Trained models on the campaign: the paper's ratios, slow training, diagnosed effects, recipes that fly."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

from benchmarks.measurement import ROOT, Page, options_of
from benchmarks.tracking.table_two import FIRST_SEED
from benchmarks.tracking.table_two_worker import DURATION, VEHICLE, Run, in_lockstep
from dynamics.vehicle_file import find_vehicle
from export.bundle import ExportOptions, export_bundle
from export.trained import read_model
from runtime.control.rti.problem import Problem
from runtime.control.rti.processor import native_processor
from studies.evaluation.run import draw, run
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


def goals(words: Sequence[str]) -> Page:
    """Two goals of the trained models: the ratios of the paper's own pipeline, and training slow to fly fast.

    Needs `alula campaign --out build/campaign_learning`. Trains through `alula train`; interrupted, it resumes.

    The paper's pipeline: zero-phase filter on inputs and labels, measured rotor speeds, body-frame PI-TCN, two seeds,
    each beside the paper's own ratios; the control, a network without the motors, is the study `motors` of `studies`.
    Trained slow: the flights at six tenths of their speed alone, four members, a network and a grey box whose effects
    are fitted to the same slow flights.

        python -m benchmarks learning goals
    """
    options_of(goals.__doc__).parse_args(words)
    tables = [paper_pipeline(), *trained_slow()]
    return Page("learning_goals", "The paper's pipeline; trained slow, flown fast", "\n\n".join(map(markdown, tables)))


MEMBERS = 4
BASES = {"true effects, fitted": NAMED, "diagnosed effects": ("--effect", "diagnosed")}


def table() -> Table:
    """RMSE of both against the truth on the campaign's eight test flights."""
    rows: list[tuple[TableCell, ...]] = []
    first = 0.0
    for name, effects in BASES.items():
        file = f"base_{effects[-1]}"
        members = ("--ensemble", str(MEMBERS), "--steps", str(GREY_STEPS))
        model = trained(file, [CAMPAIGN], "--model", "grey_box", *members, *effects)
        data = judged(model)
        truth = true_label(data, CAMPAIGN, dt=model.config.dt)
        both = pooled(flight_errors(data, predict(model, data).body, truth))
        assert data.base is not None
        base = pooled(flight_errors(data, data.base[data.ends], truth))
        first = first or both.combined
        named = ", ".join(use.label for use in model.vehicle.effects)
        rows.append((name, named, base.combined, both.linear, both.angular, both.combined, both.combined / first))
    headings = ("base", "effects", "base alone", "linear, m/s²", "angular, rad/s²", "both", "both / true effects")
    note = f"{MEMBERS} members of {GREY_STEPS:,} steps each; all test flights as one. Goal: at most 1.05."
    return Table("diagnosed_base", "RMSE against the truth", headings, tuple(rows), note)


def diagnosed_base(words: Sequence[str]) -> Page:
    """A grey box on the effects that `alula diagnose` names, beside one on the effects that the campaign truly hides.

    Needs `alula campaign --out build/campaign_learning`. Trains through `alula train`, four members each with the same
    seeds; interrupted, it resumes. The vehicle file knows none of the effects.

        python -m benchmarks learning diagnosed_base
    """
    options_of(diagnosed_base.__doc__).parse_args(words)
    return Page("diagnosed_base", "A grey box on diagnosed effects", markdown(table()))


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


def networks_that_fly(words: Sequence[str]) -> Page:
    """Training recipes of networks, how each then predicts, and how it flies: one member each.

    Needs `alula campaign --out build/campaign_learning`. Trains through `alula train`; interrupted, it resumes. Flown:
    15 s of the Lemniscate in lockstep on the campaign's vehicle with all that it hides, as `tracking table_two` does.

        python -m benchmarks learning networks_that_fly
    """
    options_of(networks_that_fly.__doc__).parse_args(words)
    rows = [("nominal model", None, *flown(str(find_vehicle(VEHICLE))))]
    rows += [row(name, place) for place, name in enumerate(TRAININGS)]
    headings = ("trained with", "RMSE against the truth", "Lemniscate, cm", "share that physics flew", "ended early")
    note = "One member and one flight each. Physics takes over where a network makes the vehicle oscillate."
    table = Table("networks_that_fly", "Predicting and flying", headings, tuple(rows), note)
    return Page("networks_that_fly", "Networks that fly", markdown(table))


PICTURES = ROOT / "build" / "learning" / "pictures"


def evaluated(words: Sequence[str]) -> Page:
    """The bundled models on the campaign's test flights: every table of `alula evaluate`.

    Needs `alula campaign --out build/campaign_learning`.

        python -m benchmarks learning evaluated
    """
    options_of(evaluated.__doc__).parse_args(words)
    models = sorted((ROOT / "vehicles").glob("*.pt"))
    results = run([*models, CAMPAIGN], None, mapping=None, timed=True, done=print)
    draw(results, PICTURES)
    head = (
        "Campaign with hidden effects (68 flights): its 8 test flights, of which no model has seen anything. Each "
        "model's card records how it was trained. plant: the model with the hidden effects themselves, moving air "
        "left out."
    )
    return Page("evaluated_models", "The bundled models", "\n\n".join([head, *map(markdown, results.tables)]))
