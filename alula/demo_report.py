"""What the demo leaves behind: a table, its numbers as CSV and JSON, and a picture of every flight."""

from __future__ import annotations

import csv
import importlib.util
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from alula.demo import DemoReport, FlownManoeuvre
from runtime.recording import Recording, read_recording

LAST_TICKS = 0.03  # s before a phase's end, whose record may hold the next phase's reference already
INK, SOFT, FLOWN = "#1a1a1a", "#9a9a9a", "#0072b2"  # Okabe and Ito's blue: told apart by the colour-blind


def write_report(report: DemoReport, folder: Path) -> DemoReport:
    """Write report.md, tracking.csv, report.json and, where matplotlib is installed, tracking.png. Names the files."""
    folder.mkdir(parents=True, exist_ok=True)
    files = [_whole(folder / "tracking.csv", lambda path: _write_csv(report, path))]
    if importlib.util.find_spec("matplotlib"):
        files.append(_whole(folder / "tracking.png", lambda path: draw_tracking(report, path)))
    files.append(_whole(folder / "report.md", lambda path: path.write_text(_text(report, files), encoding="utf-8")))
    finished = msgspec.structs.replace(report, files=(*map(str, files), str(folder / "report.json")))
    _whole(folder / "report.json", lambda path: path.write_bytes(msgspec.json.encode(finished)))
    return finished


def _whole(path: Path, write: Callable[[Path], Any]) -> Path:
    """Write under a temporary name and rename, so that nobody sees half a file."""
    partial = path.with_name(f".part-{path.name}")
    write(partial)
    os.replace(partial, path)
    return path


def _write_csv(report: DemoReport, path: Path) -> None:
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(("manoeuvre", "speed_max", "position_rmse", "position_max", "paper_nominal_rmse", "recording"))
        for flown in report.nominal:
            numbers = [f"{value:.6g}" for value in (flown.speed_max, flown.position_rmse, flown.position_max)]
            writer.writerow((flown.name, *numbers, flown.paper_rmse or "", flown.recording))


def _text(report: DemoReport, files: list[Path]) -> str:
    rows = [
        f"| {flown.name} | {flown.speed_max:.2f} | {flown.position_rmse:.3f} | {flown.position_max:.3f} | "
        f"{'' if flown.paper_rmse is None else f'{flown.paper_rmse:.3f}'} |"
        for flown in report.nominal
    ]
    picture = ["", "![reference and flight](tracking.png)"] if any(f.suffix == ".png" for f in files) else []
    return "\n".join(
        [
            "# Alula demo: the textbook model on a vehicle with a hidden effect",
            "",
            f"Vehicle {report.vehicle}, flown by its textbook model over MAVLink (UDP) on the mock flight controller. "
            f"Hidden from the controller: {', '.join(report.hidden_effects) or 'nothing'}. Seed {report.seed}.",
            "",
            "| manoeuvre | top speed m/s | position RMSE m | greatest m | the paper's nominal model m |",
            "| --- | --- | --- | --- | --- |",
            *rows,
            *picture,
            "",
        ]
    )


def draw_tracking(report: DemoReport, path: Path) -> None:
    """Reference and flight of every manoeuvre in its plane, and the error over time. Needs matplotlib."""
    import matplotlib as mpl
    from matplotlib.figure import Figure

    with mpl.rc_context({"font.size": 9, "axes.spines.top": False, "axes.spines.right": False}):
        figure = Figure(figsize=(4.2 * len(report.nominal), 6.4), layout="constrained")
        axes = figure.subplots(2, len(report.nominal), squeeze=False, height_ratios=(2, 1))
        for column, flown in zip(axes.T, report.nominal, strict=True):
            _draw_flight(flown, read_recording(Path(flown.recording)), *column)
        figure.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside upper right", ncols=2, frameon=False)
        figure.savefig(path, format="png", dpi=130)


def tracked(recording: Recording) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Times (n,) s since tracking began, flown and asked positions (n, 3) m, while the reference was tracked."""
    phases = recording.table("/phase")
    first = int(np.flatnonzero(phases["phase"] == "track")[0])
    began = phases["time"][first]
    ended = phases["time"][first + 1] if first + 1 < len(phases["time"]) else np.inf
    estimate, reference = recording.table("/estimate"), recording.table("/reference")
    rows = (reference["time"] >= began) & (reference["time"] < ended - LAST_TICKS)
    times = reference["time"][rows]
    columns = [np.interp(times, estimate["time"], axis) for axis in estimate["position_world"].T]
    return times - began, np.column_stack(columns), reference["position_world"][rows]


def _draw_flight(flown: FlownManoeuvre, recording: Recording, path_axes: Any, error_axes: Any) -> None:
    times, position, asked = tracked(recording)
    first, second = sorted(np.argsort(np.ptp(asked, axis=0))[-2:])
    path_axes.plot(asked[:, first], asked[:, second], color=SOFT, linewidth=2.5, label="reference")
    path_axes.plot(position[:, first], position[:, second], color=FLOWN, linewidth=0.9, label="flight")
    path_axes.set(xlabel=f"{'xyz'[first]}, m", ylabel=f"{'xyz'[second]}, m", aspect="equal", title=flown.name)
    path_axes.margins(0.08)
    error = np.linalg.norm(position - asked, axis=1)
    error_axes.plot(times, 100 * error, color=FLOWN, linewidth=0.9)
    error_axes.axhline(100 * flown.position_rmse, color=INK, linewidth=0.8, linestyle="--")
    error_axes.set_title(f"RMSE {100 * flown.position_rmse:.1f} cm", fontsize=9)
    error_axes.set(xlabel="time, s", ylabel="position error, cm", ylim=(0, None), xlim=(0, times[-1]))
