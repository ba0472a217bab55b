"""Accelerations from noisy velocities: the paper's UKF against the RTS smoother, Butterworth and plain differences.

Flights of the campaign on the mock, whose truth is known. Each method's cutoff is the best of a list on four training
flights; the table is of the eight test flights.

    python -m benchmarks learning labels [--seed S] [--jobs J]
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np

from benchmarks.measurement import Page, options_of
from dynamics.arrays import Floats
from dynamics.references import PAPER
from flights import Flight, filters
from simulation.campaign import Campaign, CampaignOptions
from training.data import kalman

CUTOFFS = (1.5, 2.0, 3.0, 4.0, 5.0, 6.0, 8.0, 10.0, 12.0, 15.0, 20.0, 25.0, 30.0)  # Hz
TUNING = ("Lemniscate_yz_100", "WarpedEllipse_2_xz_100", "Parabola_yz_100", "Ellipse_2_xz_100")
Method = Callable[[Floats, float, float], Floats]


def butterworth(velocity: Floats, rate: float, cutoff: float) -> Floats:
    return filters.derivative(filters.lowpass(velocity, rate, cutoff), 1 / rate)


def differences(velocity: Floats, rate: float, cutoff: float) -> Floats:
    return filters.derivative(velocity, 1 / rate)


METHODS: Mapping[str, Method] = {
    "plain central differences": differences,
    "Butterworth 4th order both ways, differences": butterworth,
    "Kalman filter (causal)": kalman.kalman_acceleration,
    "UKF, as in the paper (causal)": kalman.ukf_acceleration,
    "RTS smoother": kalman.rts_acceleration,
}


def pairs(folder: Path, names: list[str], quantity: str) -> list[tuple[Floats, Floats]]:
    """Measured quantity and its true derivative, for each flight."""
    errors_by_flight = []
    for name in names:
        measured = Flight.read(next(folder.glob(f"t[er]*[tn]/{name}.parquet")))  # train or test
        truth = Flight.read(folder / "truth" / f"{name}.parquet")
        errors_by_flight.append((measured[quantity], filters.derivative(truth[quantity], truth.period)))
    return errors_by_flight


def error(method: Method, flights: list[tuple[Floats, Floats]], cutoff: float) -> float:
    squares = [np.mean(np.sum((method(values, 100.0, cutoff) - true)[50:-50] ** 2, axis=1)) for values, true in flights]
    return float(np.sqrt(np.mean(squares)))


def labels(words: Sequence[str]) -> Page:
    """The measurement's page."""
    parser = options_of(__doc__)
    parser.add_argument("--seed", type=int, default=7)
    parser.add_argument("--jobs", type=int, default=None)
    parser.add_argument("--flights", type=int, help="so many of each set alone")
    options = parser.parse_args(words)
    heads = (
        "method",
        "linear: best cutoff Hz",
        "RMSE m/s^2",
        "at 5 Hz",
        "angular: best cutoff Hz",
        "RMSE rad/s^2",
        "at 5 Hz",
    )
    lines = [f"| {' | '.join(heads)} |", "|" + " --- |" * len(heads)]
    tuning, tests = list(TUNING)[: options.flights], list(PAPER)[: options.flights]
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        request = CampaignOptions(folder, seed=options.seed, flights=(*tests, *tuning), jobs=options.jobs)
        Campaign(request).run(lambda _: None)
        data = {q: (pairs(folder, tuning, q), pairs(folder, tests, q)) for q in ("velocity", "rate")}
    for label, method in METHODS.items():
        cells = [label]
        for quantity in ("velocity", "rate"):
            of_tuning, of_tests = data[quantity]
            best = min(CUTOFFS, key=lambda cutoff: error(method, of_tuning, cutoff))
            shown = "none" if method is differences else f"{best:g}"
            cells += [shown, f"{error(method, of_tests, best):.3f}", f"{error(method, of_tests, 5.0):.3f}"]
        lines.append(f"| {' | '.join(cells)} |")
    text = (
        f"Errors against the true accelerations on {len(tests)} test flights (campaign's effects and sensors, 100 Hz), "
        f"norms over three axes; cutoffs chosen on {', '.join(tuning)}. Seed {options.seed}. On this linear model the "
        "UKF is the Kalman filter; what the smoother gains is the look ahead, which labels may have, because they are "
        "made afterwards. `training.data.labels.paper_label` uses the RTS smoother, `increment_label` Butterworth "
        "filters of 5 Hz for velocity and 12 Hz for body rates.\n\n"
    )
    return Page("acceleration_labels", "Accelerations from velocities", text + "\n".join(lines))
