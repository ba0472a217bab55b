"""What the demo gains: prediction and tracking error before and after, over seeds, and for each catalogued effect.

In lockstep, with the mock's estimates, sensor noise, delays, motor lag and inner loops. First the demo's default, then
one effect at a time, at the strengths below, each through the whole demo: fly, diagnose, add, fly again.

    python benchmarks/demo_gain.py [--seeds 5]
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from provenance import write_result

from alula.demo import DemoReport, run_demo
from alula.demo_flights import DemoOptions
from alula.paper import TRACKING_LEARNED, TRACKING_NOMINAL
from dynamics.errors import AlulaError

EFFECTS = (
    "rotor_drag:coefficient=2.2e-5", "linear_drag:coefficient=0.12", "parasitic_drag:coefficient=0.02",
    "rotational_damping", "wind:x=3,y=1", "gust:intensity=1", "ground_effect", "wall_effect", "translational_lift",
    "axial_inflow", "blade_flapping", "rotor_gyroscopic", "motor_lag:time_constant=0.04", "battery_sag",
    "weak_rotor:rotor=1,loss=0.1", "rotor_cant:rotor=1", "thrust_constant:ratio=0.9", "torque_constant:ratio=0.8",
    "inertia", "mass:ratio=1.1", "centre_of_mass:x=0.006,y=-0.004", "slung_load:mass=0.025,length=0.5",
    "imu_bias:x=0.5,y=0.3", "gyro_bias:z=0.05", "time_delay:delay=0.02", "rotor_speed_fault:rotor=1,gain=0.9",
)  # fmt: skip
CATALOGUE_MANOEUVRES = ("Ellipse_2", "ExtendedLemniscate", "WarpedEllipse_2")  # away from the limits of the rotors


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=5)
    seeds = parser.parse_args().seeds
    reports = [_report(DemoOptions(Path(), lockstep=True, seed=seed)) for seed in range(1, seeds + 1)]
    body = [f"## The demo's default, seeds 1 to {seeds}", "", *_default(reports), "", "## Each effect by itself", ""]
    body += _catalogue()
    write_result("demo_gain", "What the demo gains", "\n".join(body))


def _report(options: DemoOptions) -> DemoReport:
    with tempfile.TemporaryDirectory() as folder:
        values = {name: getattr(options, name) for name in options.__struct_fields__} | {"folder": Path(folder)}
        return run_demo(DemoOptions(**values), lambda _: None, lambda _: None)[0]


def _default(reports: Sequence[DemoReport]) -> list[str]:
    rows = [
        "| manoeuvre | textbook m | learned m | ratio | least ratio | the paper m | its ratio |",
        "| --- " * 7 + "|",
    ]
    for index, flown in enumerate(reports[0].nominal):
        pairs = [report.pairs[index] for report in reports]
        before = np.array([one.position_rmse for one, _ in pairs])
        after = np.array([np.nan if other is None else other.position_rmse for _, other in pairs])
        nominal, learned = TRACKING_NOMINAL[flown.name][0], TRACKING_LEARNED[flown.name][0]
        ratio = before / after
        rows.append(
            f"| {flown.name} | {_spread(before)} | {_spread(after)} | {_spread(ratio, 1)} | {ratio.min():.1f} | "
            f"{nominal:.3f} -> {learned:.3f} | {nominal / learned:.1f} |"
        )
    rows += ["", "| prediction of | textbook | learned | noise floor | unit |", "| --- " * 5 + "|"]
    for kind in reports[0].learned.channels if reports[0].learned else ():
        errors = [report.learned.channels[kind] for report in reports if report.learned is not None]
        figures = [np.array([getattr(error, part) for error in errors]) for part in ("before", "after", "floor")]
        rows.append(f"| {kind} | {' | '.join(_spread(figure) for figure in figures)} | {errors[0].unit} |")
    named = sum(report.learned is not None and len(report.learned.added) == 2 for report in reports)
    return [*rows, "", f"Both effects and no third were added in {named} of {len(reports)} demos. Mean +- deviation."]


def _catalogue() -> list[str]:
    names = ", ".join(CATALOGUE_MANOEUVRES)
    rows = [f"Manoeuvres: {names}; the last is held out. Ratio: tracking RMSE with the textbook model over that with "
            "what was learned, for each.", "", "| hidden | verdict | added | prediction of force | ratios |",
            "| --- " * 5 + "|"]  # fmt: skip
    for effect in EFFECTS:
        options = DemoOptions(Path(), lockstep=True, effects=(effect,), manoeuvres=CATALOGUE_MANOEUVRES, seed=1)
        try:
            rows.append(_line(effect, _report(options)))
        except AlulaError as error:
            rows.append(f"| {effect} | none: {error} | | | |")
        print(rows[-1], flush=True)
    return rows


def _line(effect: str, report: DemoReport) -> str:
    learned = report.learned
    assert learned is not None
    force = learned.channels["imu"]
    ratios = [f"{b.position_rmse / a.position_rmse:.2f}" for b, a in report.pairs if a is not None]
    named = ", ".join(learned.added) or "nothing"
    return (
        f"| {effect} | {learned.verdict} | {named} | {force.before / force.floor:.1f} -> "
        f"{force.after / force.floor:.2f} floors | {', '.join(ratios)} |"
    )


def _spread(values: np.ndarray, digits: int = 3) -> str:
    return f"{np.mean(values):.{digits}f} +- {np.std(values):.{digits}f}"


if __name__ == "__main__":
    main()
