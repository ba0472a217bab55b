"""The paper's eight manoeuvres with the nominal model, over MAVLink in real time, on a mock with nothing hidden.

All latencies on: the mock's estimate delay and jitter, motor lag, actuation delay, sensor noise. 100 Hz. Beside the
nominal column of the paper's Table II, which was flown by a real vehicle with all its aerodynamics.

Draws three flights of the last run into docs/pictures/tracking.png.

    python -m benchmarks tracking manoeuvres [--runs 3]
"""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from pathlib import Path

import msgspec
import numpy as np

from benchmarks.measurement import ROOT, Page, add_names, options_of
from studies.demo.flights import DemoOptions
from studies.demo.report import draw_tracking
from studies.demo.run import run_demo
from studies.paper import TRACKING_NOMINAL

PICTURE = ROOT / "docs" / "pictures" / "tracking.png"
SHOWN = ("WarpedEllipse_2", "ExtendedLemniscate", "Parabola")


def manoeuvres(words: Sequence[str]) -> Page:
    """The measurement's page."""
    parser = options_of(__doc__)
    parser.add_argument("--runs", type=int, default=3)
    add_names(parser, "--manoeuvres", TRACKING_NOMINAL)
    chosen = parser.parse_args(words)
    runs = chosen.runs
    errors: dict[str, list[float]] = {name: [] for name in chosen.manoeuvres}
    speeds: dict[str, float] = {}
    with tempfile.TemporaryDirectory() as folder:
        for run in range(runs):
            options = DemoOptions(
                Path(folder) / str(run),
                effects=(),
                manoeuvres=tuple(chosen.manoeuvres),
                duration=25.0,
                seed=100 + run,
                realtime=True,
                learn=False,
            )
            report, _ = run_demo(options, lambda _: None, lambda name, _: print(name))
            for flown in report.nominal:
                errors[flown.name].append(flown.position_rmse)
                speeds[flown.name] = max(speeds.get(flown.name, 0.0), flown.speed_max)
        shown = tuple(flown for flown in report.nominal if flown.name in SHOWN)
        if not (chosen.no_page or chosen.quick):
            draw_tracking(msgspec.structs.replace(report, nominal=shown), PICTURE)
    rows = ["| manoeuvre | top speed m/s | position RMSE m, mean +- std | the paper's nominal m |", "| --- " * 4 + "|"]
    for name, values in errors.items():
        paper, spread = TRACKING_NOMINAL[name]
        ours = f"{np.mean(values):.3f} +- {np.std(values):.3f}"
        rows.append(f"| {name} | {speeds[name]:.2f} | {ours} | {paper:.3f} +- {spread:.3f} |")
    rows += ["", f"{runs} runs each, seeds 100 to {99 + runs}."]
    return Page("manoeuvres", "Tracking with the nominal model, nothing hidden", "\n".join(rows))
