"""The demo's report: tables as Markdown, CSV and JSON, a picture of every flight, and an HTML page."""

from __future__ import annotations

import csv
import datetime
import importlib.util
import os
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np

from dynamics.arrays import Floats
from dynamics.effects import CATALOGUE
from dynamics.errors import RequestError
from dynamics.workbench_install import workbench_install
from runtime.record.recording import FlightRecording, read_recording
from studies.demo.result import DemoReport, FlownManoeuvre

if TYPE_CHECKING:
    from studies.demo.learning import Learning

LAST_TICKS = 0.03  # s before a phase's end, whose record may hold the next phase's reference already
SOFT, BEFORE, AFTER = "#9a9a9a", "#d55e00", "#0072b2"  # Okabe and Ito: safe for the colour-blind
CHANNELS: Mapping[str, str] = {
    "imu": "force, by the accelerometer",
    "mocap": "force, by the pose",
    "angular": "angular acceleration",
    "attitude_rate": "turning, less the gyro",
}
PAGE_NEEDS = ("plotly", "jinja2")


def write_report(report: DemoReport, folder: Path, learning: Learning | None = None) -> DemoReport:
    """Write report.md, tracking.csv and report.json, and if the install can, tracking.png and report.html.

    Returns the report with the files' names. Raises RequestError when one cannot be written.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        return _write_all(report, folder, learning)
    except OSError as error:
        raise RequestError(f"cannot write the report: {error}. Give a folder that can be written with --out.") from None


def _write_all(report: DemoReport, folder: Path, learning: Learning | None) -> DemoReport:
    files = [_written(folder / "tracking.csv", lambda path: _write_csv(report, path))]
    if importlib.util.find_spec("matplotlib"):
        files.append(_written(folder / "tracking.png", lambda path: draw_tracking(report, path)))
    if learning is not None and all(map(importlib.util.find_spec, PAGE_NEEDS)):
        files.append(_written(folder / "report.html", lambda path: _write_page(report, learning, path)))
    files.append(_written(folder / "report.md", lambda path: path.write_text(_text(report, files), encoding="utf-8")))
    finished = msgspec.structs.replace(report, files=(*map(str, files), str(folder / "report.json")))
    _written(folder / "report.json", lambda path: path.write_bytes(msgspec.json.encode(finished)))
    return finished


def _written(path: Path, write: Callable[[Path], Any]) -> Path:
    """Write under a temporary name and rename, so that no incomplete file is visible."""
    partial = path.with_name(f".part-{path.name}")
    write(partial)
    os.replace(partial, path)
    return path


def _write_csv(report: DemoReport, path: Path) -> None:
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(CSV_HEADINGS)
        flights = [("textbook", flown) for flown in report.nominal]  # the file's word for the nominal model
        flights += [("learned", flown) for flown in (report.learned.flown if report.learned is not None else ())]
        for model, flown in flights:
            numbers = [f"{value:.6g}" for value in (flown.speed_max, flown.position_rmse, flown.position_max)]
            row = (flown.name, model, *numbers, flown.paper_rmse or "", flown.recording)
            writer.writerow((*row, "" if flown.px4_rmse is None else f"{flown.px4_rmse:.6g}"))


def tracking_rows(report: DemoReport) -> list[tuple[str, ...]]:
    """A row a manoeuvre: name, top speed, RMSE with the nominal and the identified model, ratio, the paper's two.

    The last is the RMSE of both on PX4's estimate.
    """
    return [
        (
            before.name,
            f"{before.speed_max:.2f}",
            f"{before.position_rmse:.3f}",
            "" if after is None else f"{after.position_rmse:.3f}",
            "" if after is None else f"{before.position_rmse / after.position_rmse:.1f}",
            " -> ".join(f"{one.paper_rmse:.3f}" for one in (before, after) if one is not None and one.paper_rmse),
            " -> ".join(
                "ended early" if one.px4_rmse is None else f"{one.px4_rmse:.3f}" for one in (before, after) if one
            ),
        )
        for before, after in report.pairs
    ]


CSV_HEADINGS = (
    "manoeuvre",
    "model",
    "speed_max",
    "position_rmse",
    "position_max",
    "paper_rmse",
    "recording",
    "px4_rmse",
)
TRACKING_HEADINGS = (
    "manoeuvre",
    "top speed m/s",
    "nominal m",
    "identified m",
    "ratio",
    "the paper m",
    "on PX4's estimate m",
)
PREDICTION_HEADINGS = ("prediction of", "nominal", "identified", "noise floor", "unit")


def prediction_rows(report: DemoReport) -> list[tuple[str, ...]]:
    """A row a channel: prediction error with the nominal and the identified model, noise floor, unit."""
    if report.learned is None:
        return []
    return [
        (CHANNELS[kind], f"{error.before:.3g}", f"{error.after:.3g}", f"{error.floor:.3g}", error.unit)
        for kind, error in report.learned.channels.items()
    ]


def closing_lines(report: DemoReport) -> list[str]:
    """Sentences beneath the tables: the diagnosis and what was added, or why there is no second half."""
    if report.missing:
        return [
            "The second half, diagnosing these flights and flying the better model, needs "
            f"{' and '.join(report.missing)}, which this install leaves out: {workbench_install()} and run "
            "alula demo again."
        ]
    if report.learned is None:
        return []
    learned = report.learned
    lines = [f"Diagnosis ({learned.verdict}): {learned.sentence}"]
    if not learned.vehicle_file:
        return [*lines, "Nothing was added, so nothing was flown again."]
    lines.append(f"Added: {', '.join(learned.added)}. The vehicle file with it: {learned.vehicle_file}")
    faults = [name for name in learned.added if not CATALOGUE[name].moves_vehicle]
    if faults:
        lines.append(f"{' and '.join(faults)}: of a sensor, not of the motion, so tracking cannot gain by it.")
    return lines


def _text(report: DemoReport, files: list[Path]) -> str:
    how = "in simulated time, by MAVLink's bytes," if report.lockstep else "over MAVLink (UDP), against the clock,"
    lines = [
        "# Alula demo: a vehicle with a hidden effect, flown with the nominal and with the identified model",
        "",
        f"Vehicle {report.vehicle}, flown {how} on the mock flight controller. Hidden from the controller: "
        f"{', '.join(report.hidden_effects) or 'nothing'}. Seed {report.seed}.",
        "",
        "Tracking: position RMSE against the reference, with a pose as from motion capture. The last column is the "
        "same in lockstep on an estimate that errs as PX4's own on GPS and barometer does, by that estimate.",
        "",
        *_table(TRACKING_HEADINGS, tracking_rows(report)),
    ]
    if report.learned is not None:
        lines += ["", "Prediction: RMSE on a flight that nothing was fitted on.", ""]
        lines += _table(PREDICTION_HEADINGS, prediction_rows(report))
    for line in closing_lines(report):
        lines += ["", line]
    if any(file.suffix == ".png" for file in files):
        lines += ["", "![reference and flights](tracking.png)"]
    return "\n".join([*lines, ""])


def _table(headings: tuple[str, ...], rows: list[tuple[str, ...]]) -> list[str]:
    return [f"| {' | '.join(cells)} |" for cells in (headings, ("---",) * len(headings), *rows)]


def _write_page(report: DemoReport, learning: Learning, path: Path) -> None:
    """The demo's page, or where nothing was flown again the page of the diagnosis."""
    from studio.pages.flown import FlownComparison
    from studio.pages.page import Origin
    from studio.pages.report import demo_page, diagnosis_page

    flown = [
        FlownComparison(before.name, _flown_track(before), _flown_track(after))
        for before, after in report.pairs
        if after is not None
    ]
    history = learning.completion.vehicle.history
    origin = Origin(
        command=history[-1].command if history else "",
        made=datetime.datetime.now(tz=datetime.UTC).isoformat(timespec="seconds"),
        inputs={**learning.dataset.hashes, **learning.dataset.held_hashes},
        held_out=tuple(learning.dataset.held_hashes),
    )
    first, dataset = learning.completion.first, learning.dataset
    if flown:
        page = demo_page(flown, first, dataset, origin=origin, hidden=report.hidden_effects)
    else:
        page = diagnosis_page(first, dataset, learning.completion.vehicle, origin=origin)
    path.write_text(page, encoding="utf-8")


def _flown_track(flown: FlownManoeuvre) -> Any:
    from studio.pages.flown import FlownTrack

    errors = (flown.position_rmse, flown.position_max, flown.speed_max)
    return FlownTrack(*flown_and_setpoint(Path(flown.recording)), *errors, flown.px4_rmse)


def flown_and_setpoint(path: Path) -> tuple[Floats, Floats, Floats]:
    """Times (n,) s since tracking began, flown and setpoint positions (n, 3) m of a demo's flight."""
    if path.suffix == ".mcap":
        return tracked(read_recording(path))
    from flights import Flight

    flight = Flight.read(path)
    rows = np.isfinite(flight["position"] + flight["position_setpoint"]).all(axis=1)
    return flight.time[rows] - flight.time[0], flight["position"][rows], flight["position_setpoint"][rows]


def tracked(recording: FlightRecording) -> tuple[Floats, Floats, Floats]:
    """Times (n,) s since tracking began, flown and setpoint positions (n, 3) m, while the reference was tracked."""
    phases = recording.table("/phase")
    first = int(np.flatnonzero(phases["phase"] == "track")[0])
    began = phases["time"][first]
    ended = phases["time"][first + 1] if first + 1 < len(phases["time"]) else np.inf
    estimate, reference = recording.table("/estimate"), recording.table("/reference")
    rows = (reference["time"] >= began) & (reference["time"] < ended - LAST_TICKS)
    times = reference["time"][rows]
    columns = [np.interp(times, estimate["time"], axis) for axis in estimate["position_world"].T]
    return times - began, np.column_stack(columns), reference["position_world"][rows]


def draw_tracking(report: DemoReport, path: Path) -> None:
    """Reference and flights of every manoeuvre in its plane, and the error over time. Needs matplotlib."""
    import matplotlib as mpl
    from matplotlib.figure import Figure

    with mpl.rc_context({"font.size": 9, "axes.spines.top": False, "axes.spines.right": False}):
        figure = Figure(figsize=(4.2 * len(report.nominal), 6.4), layout="constrained")
        axes = figure.subplots(2, len(report.nominal), squeeze=False, height_ratios=(2, 1))
        for column, (before, after) in zip(axes.T, report.pairs, strict=True):
            _draw_manoeuvre(before, after, *column)
        figure.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside upper right", ncols=3, frameon=False)
        figure.savefig(path, format="png", dpi=130)


def _draw_manoeuvre(before: FlownManoeuvre, after: FlownManoeuvre | None, path_axes: Any, error_axes: Any) -> None:
    flights = (
        [("flight", AFTER, before)] if after is None else [("nominal", BEFORE, before), ("identified", AFTER, after)]
    )
    for label, colour, flown in flights:
        times, position, setpoint = flown_and_setpoint(Path(flown.recording))
        first, second = sorted(np.argsort(np.ptp(setpoint, axis=0))[-2:])
        if flown is before:
            path_axes.plot(setpoint[:, first], setpoint[:, second], color=SOFT, linewidth=2.5, label="reference")
        path_axes.plot(position[:, first], position[:, second], color=colour, linewidth=0.9, label=label)
        error_axes.plot(times, 100 * np.linalg.norm(position - setpoint, axis=1), color=colour, linewidth=0.9)
        error_axes.axhline(100 * flown.position_rmse, color=colour, linewidth=0.8, linestyle="--")
    path_axes.set(xlabel=f"{'xyz'[first]}, m", ylabel=f"{'xyz'[second]}, m", aspect="equal", title=before.name)
    path_axes.margins(0.08)
    errors = " and ".join(f"{100 * flown.position_rmse:.1f}" for _, _, flown in flights)
    error_axes.set_title(f"RMSE {errors} cm", fontsize=9)
    error_axes.set(xlabel="time, s", ylabel="position error, cm", ylim=(0, None), xlim=(0, times[-1]))
