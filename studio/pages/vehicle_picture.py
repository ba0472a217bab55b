"""A vehicle's layout as a picture: rotors from above, with their numbers, the autopilot's, and how they turn."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from dynamics.arrays import Floats
from dynamics.errors import RequestError
from dynamics.files import write_whole
from dynamics.rotor_places import rotor_names
from dynamics.vehicle import Vehicle

FORMATS = (".png", ".svg", ".pdf")
TURNING = {-1: ("tab:blue", "counter-clockwise"), 1: ("tab:orange", "clockwise")}  # by spin, seen from above


def draw_layout(vehicle: Vehicle, path: Path) -> Path:
    """Draw a vehicle from above, forward up. Raises RequestError for another format or a path that is not writable."""
    if path.suffix not in FORMATS:
        raise RequestError(f"{path}: a picture is {', '.join(FORMATS)}; give one of these endings.")
    from matplotlib.figure import Figure
    from matplotlib.patches import Circle, FancyArrowPatch

    position = np.array(vehicle.rotors.position)
    radius = vehicle.rotors.disc_radius
    figure = Figure(figsize=(7.0, 7.0), layout="constrained")
    axes = figure.add_subplot()
    for number, (name, spin) in enumerate(zip(rotor_names(vehicle), vehicle.rotors.spin, strict=True)):
        x, y = -position[number, 1], position[number, 0]  # left of the page is the vehicle's left
        colour = TURNING[spin][0]
        axes.plot([0, x], [0, y], color="0.8", linewidth=4, solid_capstyle="round", zorder=1)
        axes.add_patch(Circle((x, y), radius, facecolor=colour, alpha=0.12, edgecolor=colour, zorder=2))
        angles = np.radians(np.linspace(60.0, 330.0, 60) if spin < 0 else np.linspace(120.0, -150.0, 60))
        arc = np.array([x, y]) + 0.8 * radius * np.stack([np.cos(angles), np.sin(angles)], axis=1)
        axes.plot(*arc.T, color=colour, zorder=3)
        arrow = FancyArrowPatch(arc[-2], arc[-1], arrowstyle="-|>", mutation_scale=18, color=colour, zorder=4)
        axes.add_patch(arrow)
        shift = _coaxial_shift(position, number) * radius
        axes.text(x, y + shift, _label(name), ha="center", va="center", fontsize=9, zorder=5,
                  bbox={"facecolor": "white", "alpha": 0.8, "edgecolor": "none", "pad": 1})  # fmt: skip
    reach = float(np.abs(position[:, :2]).max()) + 1.25 * radius
    axes.annotate("", (0, 0.45 * reach), (0, 0), arrowprops={"arrowstyle": "->", "color": "crimson"}, zorder=6)
    axes.text(0, 0.47 * reach, "forward", ha="center", color="crimson", fontsize=9, zorder=6)
    centre = vehicle.body.centre_of_mass
    axes.plot(-centre[1], centre[0], "k+", markersize=10, zorder=6)
    axes.set(xlim=(-reach, reach), ylim=(-reach, reach), aspect="equal", xlabel="to the right, m", ylabel="forward, m")
    axes.set_title(f"{vehicle.name}, seen from above")
    for colour, turning in TURNING.values():
        axes.plot([], [], color=colour, label=f"turns {turning}")
    figure.legend(loc="outside lower center", ncols=2, frameon=False)
    kind = path.suffix[1:]
    return write_whole(
        path, lambda part: figure.savefig(part, format=kind, dpi=120), advice="Give a folder that can be written."
    )


def _coaxial_shift(position: Floats, number: int) -> float:
    """Where a label goes among rotors on one axis, in radii: 0 for one that is alone."""
    same = np.flatnonzero(np.linalg.norm(position[:, :2] - position[number, :2], axis=1) < 1e-6)
    return 0.0 if len(same) < 2 else 0.35 * (1 - 2 * int(np.flatnonzero(same == number)[0]))


def _label(name: str) -> str:
    """A rotor's name in lines: "rotor 1", its place, the autopilots' motors."""
    head, _, inside = name.partition(" (")
    parts = inside.removesuffix(")").replace("; ", "\n").replace(", ", "\n").replace(" and ", ",\n")
    return f"{head}\n{parts}" if parts else head
