"""The paper's eight test manoeuvres and plainer ones as harmonic curves, in any plane and at any speed.

Each of the eight is shaped so that its peak linear and angular accelerations are those of PI-TCN Table I, as far as a
smooth curve of its kind on the paper's vehicle can have both: `benchmarks campaign references` lists which does.
The paper has no more than a picture of the shapes and these two numbers.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from dynamics.arrays import Floats
from dynamics.references.curve import FLAT, HarmonicCurve

Rows = tuple[tuple[float, float, float], ...]


@dataclass(frozen=True, slots=True)
class Manoeuvre:
    """A closed curve about its centre.

    cosine, sine: amplitude (m) of harmonics 1, 2.. along its own three axes.
    rate: of phase at full speed, rad/s.
    laps: times around.
    plane: the world axes along which its first two axes lie by default.
    peaks: Table I's linear (m/s^2) and angular (rad/s^2) accelerations.
    turns: of yaw for every lap.
    height: of its lowest point above the ground, m.
    """

    cosine: Rows
    sine: Rows
    rate: float
    laps: int
    plane: str
    peaks: tuple[float, float] | None = None
    turns: float = 0.0
    height: float = 1.0

    def curve(self, plane: str, size: float, centre: Floats) -> HarmonicCurve:
        """The curve in a plane such as "xy" or "z-x", its lengths times size, about a centre (3,) m."""
        axes = plane_axes(plane)
        tables = []
        for rows in (self.cosine, self.sine):
            table = np.zeros((1 + max(len(self.cosine), len(self.sine)), FLAT))
            table[1 : 1 + len(rows), :3] = size * np.array(rows).reshape(-1, 3) @ axes
            tables.append(table)
        tables[0][0, :3] = centre
        return HarmonicCurve(tables[0], tables[1], np.array([0.0, 0.0, 0.0, self.turns]))


# The parabola x = -0.566 (z + 0.768)^2, up and down. At its upper end the thrust of 17.5 m/s^2 is nearly level and the
# vehicle falls with 7.5 m/s^2; a level flight would leave 15.6 of it. Flown with the lag and drag of a campaign's
# vehicle, its peaks are Table I's.
_TRANSPOSED: Rows = (
    (1.0974, -1.2799, 0.0), (-0.4384, -0.0204, 0.0), (-0.0137, 0.0101, 0.0), (-0.0046, 0.0136, 0.0), (0.01, 0.0, 0.0),
)  # fmt: skip

PAPER: Mapping[str, Manoeuvre] = {
    "Ellipse_1": Manoeuvre(((1.0, 0.0, 0.0),), ((0.0, 0.7, 0.0),), 1.049, 5, "xy", (1.10, 5.26)),
    "Ellipse_2": Manoeuvre(((0.161, 0.0, 0.0),), ((0.0, 0.417, 0.0),), 3.762, 18, "xy", (5.89, 7.34)),
    "WarpedEllipse_1": Manoeuvre(
        ((0.856, 0.0, 0.0),), ((0.0, 0.441, 0.0), (0.0, 0.0, 0.378)), 1.721, 8, "xy", (4.92, 4.76)
    ),
    "WarpedEllipse_2": Manoeuvre(
        ((1.988, 0.0, 0.0),), ((0.0, 1.392, 0.0), (0.0, 0.0, 0.197)), 2.239, 11, "xy", (9.99, 12.76)
    ),
    "Lemniscate": Manoeuvre(
        ((0.0, 0.0, 0.0), (0.0, 0.0923, 0.0)), ((1.765, 0.0, 0.0), (0.0, -0.1182, 0.0)), 2.654, 12, "xz", (13.14, 31.98)
    ),
    "ExtendedLemniscate": Manoeuvre(
        (), ((1.742, 0.0, 0.0), (0.0, 0.419, 0.0), (0.0, 0.0, 0.375)), 1.435, 7, "xy", (7.76, 27.95)
    ),
    "Parabola": Manoeuvre(((0.0, 0.0, 0.0), (0.0, -0.639, 0.0)), ((1.102, 0.0, 0.0),), 1.457, 7, "xz", (5.91, 6.57)),
    "TransposedParabola": Manoeuvre(_TRANSPOSED, (), 2.385, 11, "xz", (17.86, 54.90)),
}

PLAIN: Mapping[str, Manoeuvre] = {
    "hover": Manoeuvre((), (), 0.2 * np.pi, 2, "xy"),
    "circle": Manoeuvre(((1.5, 0.0, 0.0),), ((0.0, 1.5, 0.0),), 1.6, 5, "xy"),
    "line": Manoeuvre(((1.5, 0.0, 0.0),), (), 1.8, 8, "xy"),
    "bob": Manoeuvre(((0.5, 0.0, 0.0),), (), 2.5, 12, "zx"),
    "yaw_spin": Manoeuvre((), (), 2.0, 6, "xy", turns=1.0),
    "low_flight": Manoeuvre(((0.8, 0.0, 0.0),), ((0.0, 0.5, 0.0),), 1.2, 5, "xy", height=0.15),
}


def plane_axes(plane: str) -> Floats:
    """World directions of a curve's own three axes, rows of a right-handed frame. Raises ValueError.

    plane: two different letters of x, y, z, each with a minus sign before it to reverse it; the third axis completes
    a right-handed frame.
    """
    axes, sign = [], 1.0
    for letter in plane:
        if letter == "-":
            sign = -sign
            continue
        if letter not in "xyz":
            raise ValueError(f"{letter!r} is no axis")
        axes.append(sign * np.eye(3)["xyz".index(letter)])
        sign = 1.0
    if len(axes) != 2 or abs(float(axes[0] @ axes[1])) > 0.5:
        raise ValueError(f"{plane!r} does not name two different axes")
    return np.array([axes[0], axes[1], np.cross(axes[0], axes[1])])
