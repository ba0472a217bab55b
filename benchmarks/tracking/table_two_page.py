"""Table II as Markdown, and the paper's first figure, from finished flights."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.measurement import ROOT
from benchmarks.tracking.table_two_worker import ANGULAR_BINS, DURATION, HEIGHT, LINEAR_BINS, RAMP, Flown
from dynamics.references.manoeuvres import PAPER
from dynamics.vehicle_file import read_vehicle
from studies.paper import TRACKING_LEARNED, TRACKING_NOMINAL

PICTURE = ROOT / "docs" / "pictures" / "table_two.png"
SHOWN = "Lemniscate"  # as in the paper's first figure
NAMES = {
    "nominal": "nominal",
    "effects": "nominal + effects",
    "pi_mlp": "PI-MLP, T = 1",
    "pi_tcn": "PI-TCN",
    "grey_box": "grey box + residual",
}
COLOURS = {  # Okabe and Ito
    "nominal": "#d55e00",
    "effects": "#009e73",
    "pi_mlp": "#cc79a7",
    "pi_tcn": "#0072b2",
    "grey_box": "#e69f00",
}
INK, SOFT = "#1a1a1a", "#9a9a9a"


def body(flights: Sequence[Flown], quick: Sequence[Flown], effects: Path) -> str:
    """All tables. flights: over the link. quick: in lockstep. effects: the vehicle file of the second model."""
    parts = [
        f"Position RMSE in m, mean ± standard deviation over runs; {DURATION - RAMP:g} s of each flight, after the "
        f"ramp of {RAMP:g} s. Ratio: of means, nominal over it.",
        _errors(flights),
        "## Beside the paper",
        _paper(flights),
        "## How they flew",
        _conduct(flights),
        "Repeated: the machine held up the mock, so that estimates were older than 60 ms; nothing else is repeated.",
        "## Peaks",
        _peaks(flights),
    ]
    if quick:
        parts += ["## The same in lockstep, without link, threads and clocks", _errors(quick)]
    return "\n\n".join([*parts, *_added(effects)])


def _added(effects: Path) -> list[str]:
    """The effects in the second model's vehicle file, in a sentence; none without the file."""
    if not effects.exists():
        return []
    listed = "; ".join(
        f"{use.name} ({', '.join(f'{k} {v:.3g}' for k, v in use.parameters.items())})"
        for use in read_vehicle(effects).effects
    )
    return [f"Diagnosed and added: {listed}."]


def estimates_body(flights: Sequence[Flown], effects: Path) -> str:
    """Errors of whole flights in lockstep, in motion capture and on PX4's estimate. effects: as in `body`."""
    models = _models(flights)
    paces = {"mocap": "motion capture", "px4": "PX4's estimate"}
    heads = [f"{NAMES[model]}, {title}" for model in models for title in paces.values()]
    by_pace = {pace: [flown for flown in flights if flown.run.pace == pace] for pace in paces}
    rows = [
        [name, *(_cell(by_pace[pace], model, name) for model in models for pace in paces)] for name in TRACKING_NOMINAL
    ]
    text = (
        f"Position RMSE by the estimate in m, mean ± standard deviation over runs; {DURATION - RAMP:g} s of each "
        f"flight from the ground to the ground in lockstep, after the ramp of {RAMP:g} s; ratio: nominal over it. "
        f"Lowest point of each manoeuvre {HEIGHT:g} m.\n\n{_table(['manoeuvre', *heads], rows)}"
    )
    return "\n\n".join([text, *_added(effects)])


def _models(flights: Sequence[Flown]) -> list[str]:
    return [model for model in NAMES if any(flown.run.model == model for flown in flights)]


def rmse(flights: Sequence[Flown], model: str, manoeuvre: str) -> np.ndarray:
    """Errors (n,) of a model's flights of a manoeuvre that were flown to their end, m."""
    chosen = [f for f in flights if f.run.model == model and f.run.manoeuvre == manoeuvre and not f.ended]
    return np.array([flown.position_rmse for flown in chosen])


def spread(values: np.ndarray) -> str:
    """Mean and sample deviation; nothing of nothing."""
    if not len(values):
        return "none"
    return f"{values.mean():.3f} ± {values.std(ddof=1):.3f}" if len(values) > 1 else f"{values.mean():.3f}"


def ratio(flights: Sequence[Flown], model: str, manoeuvre: str) -> float:
    """Mean error with the nominal model over that with another one, NaN where one of them never arrived."""
    nominal, other = rmse(flights, "nominal", manoeuvre), rmse(flights, model, manoeuvre)
    return float(nominal.mean() / other.mean()) if len(nominal) and len(other) else float("nan")


def _cell(flights: Sequence[Flown], model: str, manoeuvre: str) -> str:
    chosen = [f for f in flights if f.run.model == model and f.run.manoeuvre == manoeuvre]
    broken = sum(bool(flown.ended) for flown in chosen)
    cell = spread(rmse(flights, model, manoeuvre))
    if model != "nominal" and np.isfinite(factor := ratio(flights, model, manoeuvre)):
        cell += f" ({factor:.1f})"
    return f"{cell}, {broken} of {len(chosen)} ended early" if broken else cell


def _errors(flights: Sequence[Flown]) -> str:
    models = _models(flights)
    heads = [NAMES[m] if m == "nominal" else f"{NAMES[m]} (ratio)" for m in models]
    rows = [[name, *(_cell(flights, model, name) for model in models)] for name in TRACKING_NOMINAL]
    return _table(["manoeuvre", *heads], rows)


def _paper(flights: Sequence[Flown]) -> str:
    rows = []
    for name, (nominal, deviation) in TRACKING_NOMINAL.items():
        learned, other = TRACKING_LEARNED[name]
        ours = [f"{ratio(flights, model, name):.1f}" for model in _models(flights) if model != "nominal"]
        rows.append(
            [
                name,
                f"{nominal:.3f} ± {deviation:.3f}",
                f"{learned:.3f} ± {other:.3f}",
                f"{nominal / learned:.1f}",
                *ours,
            ]
        )
    heads = [f"ratio here, {NAMES[model]}" for model in _models(flights) if model != "nominal"]
    return _table(["manoeuvre", "the paper: nominal", "the paper: PI-MLP, T = 1", "its ratio", *heads], rows)


def _conduct(flights: Sequence[Flown]) -> str:
    rows = []
    for model in _models(flights):
        mine = [flown for flown in flights if flown.run.model == model]
        late = {cause: sum(f.late.get(cause, 0) for f in mine) for cause in ("ours", "scheduler", "link")}
        ticks = max(sum(flown.ticks for flown in mine), 1)
        ratios = [flown.model_ratio for flown in mine if flown.model_ratio is not None]
        rows.append(
            [
                NAMES[model],
                mine[0].run.key,
                str(len(mine)),
                str(sum(bool(flown.ended) for flown in mine)),
                str(sum(flown.repeats for flown in mine)),
                f"{sum(f.fallbacks for f in mine)}, {sum(f.fallback_seconds for f in mine):.1f} s",
                f"{max(ratios):.1f}" if ratios else "",
                ", ".join(f"{count} {cause}" for cause, count in late.items()) + f" of {ticks}",
            ]
        )
    heads = [
        "model",
        "sha256",
        "flights",
        "ended early",
        "repeated",
        "fallbacks",
        "worst error / training's",
        "late setpoints, by",
    ]
    return _table(heads, rows)


def _peaks(flights: Sequence[Flown]) -> str:
    models = _models(flights)
    rows = []
    for name in TRACKING_NOMINAL:
        cells = []
        for model in models:
            mine = [f for f in flights if f.run.model == model and f.run.manoeuvre == name and not f.ended]
            highest = [
                max((getattr(f, what) for f in mine), default=np.nan) for what in ("peak_linear", "peak_angular")
            ]
            cells.append(f"{highest[0]:.1f}, {highest[1]:.0f}")
        linear, angular = PAPER[name].peaks or (np.nan, np.nan)
        rows.append([name, *cells, f"{linear:.1f}, {angular:.0f}"])
    return _table(["m/s², rad/s²", *(NAMES[m] for m in models), "the paper's Table I"], rows)


def _table(heads: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    return "\n".join(f"| {' | '.join(cells)} |" for cells in (heads, ["---"] * len(heads), *rows))


def draw(flights: Sequence[Flown], path: Path) -> None:
    """The path and the densities of acceleration of one manoeuvre, as in the paper's first figure, then all errors."""
    import matplotlib as mpl
    from matplotlib.figure import Figure

    with mpl.rc_context({"font.size": 9, "axes.spines.top": False, "axes.spines.right": False}):
        figure = Figure(figsize=(11.5, 7.2), layout="constrained")
        above, below = figure.subfigures(2, 1, height_ratios=(1.15, 1))
        way, linear, angular = above.subplots(1, 3, width_ratios=(1.25, 1, 1))
        shown = [f for f in flights if f.run.manoeuvre == SHOWN and not f.ended]
        _draw_path(way, shown)
        _draw_density(linear, shown, "linear", LINEAR_BINS, "linear acceleration, m/s²")
        _draw_density(angular, shown, "angular", ANGULAR_BINS, "angular acceleration, rad/s²")
        _draw_errors(below.subplots(), flights)
        figure.savefig(path.with_suffix(".part"), format="png", dpi=130)
    path.with_suffix(".part").replace(path)


def _draw_path(axes: Any, flights: Sequence[Flown]) -> None:
    for model in _models(flights):
        first = next(flown for flown in flights if flown.run.model == model)
        reference, flown = np.array(first.reference_position), np.array(first.path)
        one, other = sorted(np.argsort(np.ptp(reference, axis=0))[-2:])
        if not axes.lines:
            axes.plot(reference[:, one], reference[:, other], color=SOFT, linewidth=3, alpha=0.6, label="reference")
        axes.plot(flown[:, one], flown[:, other], color=COLOURS[model], linewidth=0.9, label=NAMES[model])
        axes.set(xlabel=f"{'xyz'[one]}, m", ylabel=f"{'xyz'[other]}, m", aspect="equal")
    axes.set_title(SHOWN)


def _draw_density(axes: Any, flights: Sequence[Flown], what: str, bins: np.ndarray, label: str) -> None:
    highest = 0.0
    for model in _models(flights):
        counted = np.sum([getattr(f, what) for f in flights if f.run.model == model], axis=0)
        density = counted / (counted.sum() * np.diff(bins))
        axes.stairs(density, bins, color=COLOURS[model], linewidth=1.3, fill=False)
        axes.stairs(density, bins, color=COLOURS[model], alpha=0.12, fill=True)
        highest = max(highest, float(bins[1:][counted > 0].max()))
    axes.set(xlabel=label, ylabel="density", xlim=(0, 1.03 * highest), ylim=(0, None))
    axes.set_title(f"{SHOWN}: what was reached")


def _draw_errors(axes: Any, flights: Sequence[Flown]) -> None:
    models = _models(flights)
    width, places = 0.8 / max(len(models), 1), np.arange(len(TRACKING_NOMINAL))
    for number, model in enumerate(models):
        errors = [100 * rmse(flights, model, name) for name in TRACKING_NOMINAL]
        means = [values.mean() if len(values) else np.nan for values in errors]
        deviations = [values.std(ddof=1) if len(values) > 1 else 0.0 for values in errors]
        at = places + (number - (len(models) - 1) / 2) * width
        axes.bar(
            at,
            means,
            0.92 * width,
            yerr=deviations,
            color=COLOURS[model],
            label=NAMES[model],
            error_kw={"elinewidth": 0.8, "ecolor": INK},
        )
    for marker, label, table in (("_", "paper, nominal", TRACKING_NOMINAL), ("x", "paper, learned", TRACKING_LEARNED)):
        values = [100 * mean for mean, _ in table.values()]
        axes.plot(places, values, marker, color=INK, markersize=9 if marker == "_" else 5, label=label)
    axes.set_xticks(places, list(TRACKING_NOMINAL))
    axes.set(ylabel="position RMSE, cm", ylim=(0, None))
    axes.legend(ncols=6, frameon=False, loc="upper left")
