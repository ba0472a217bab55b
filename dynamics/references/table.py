"""A user's own reference from a CSV table, as a smooth curve.

Polynomials of degree nine join the rows and agree with their neighbours in four derivatives, which body rates and
rotor speeds need. Values and derivatives at a row come from a polynomial fitted to the rows around it, which smooths
small noise. A table that begins or ends in motion gets a soft start and stop: its clock reaches full speed in two
seconds.
"""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from dynamics import quaternion
from dynamics.arrays import Floats
from dynamics.errors import RequestError
from dynamics.files import write_whole
from dynamics.references.curve import DERIVATIVES, FLAT, PiecewisePolynomial
from dynamics.references.reference import Reference
from dynamics.references.time_law import TimeLaw
from dynamics.unpacking import read_packed
from dynamics.vehicle import Vehicle

REQUIRED = ("t", "position_x", "position_y", "position_z")
MIN_ROWS = 7
WINDOW, DEGREE = 9, 6  # of the local fits: rows at least, and degree of the polynomial
MIN_SPAN = 0.24  # s of the local fits: the rounding of closer rows would be taken for snap
KNOTS = 0.1  # s between two knots at least: between them the curve's snap amplifies errors by the fourth power of 1 / s
AT_REST = 0.05  # m/s or rad/s
RAMP = 2.0  # s
WRITTEN_STEP = 0.02  # s between the rows of a table that is written
WRITTEN_DIGITS = 9  # after the point
MAX_SPEED = 50.0  # m/s between two rows; beyond it the unit is wrong or the table jumps
_COLUMNS = "Required: columns t (s), position_x, position_y, position_z (m), optionally yaw (rad) or attitude_w..z"


def read_table(path: Path, vehicle: Vehicle) -> Reference:
    """The reference of a CSV file. Raises RequestError that names row and column of an impossible value."""
    columns = _read_columns(path)
    _check(path, columns)
    values = np.column_stack([columns["position_x"], columns["position_y"], columns["position_z"], _yaw(columns)])
    return _through(columns["t"] - columns["t"][0], values, path.name, vehicle)


def as_read_back(reference: Reference) -> Reference:
    """A reference as `read_table` makes it of what `write_table` writes: what a planned flight flies."""
    rows = _rows(reference)
    return _through(rows[:, 0], rows[:, 1:], reference.name, reference.vehicle)


def _through(times: Floats, values: Floats, name: str, vehicle: Vehicle) -> Reference:
    """The reference through rows. times: (n,) from 0, s. values: (n, 4) position and yaw."""
    knots = _knots(times)
    derivatives = _local_fits(times, values, knots)
    moving = np.abs(derivatives[[0, -1], 1]).max() > AT_REST
    if not moving:
        derivatives[[0, -1], 1:] = 0.0
    ramp = min(RAMP, times[-1] / 2) if moving else 0.0
    law = TimeLaw(1.0, ramp, float(times[-1]) + ramp)
    return Reference(name, _joined(times[knots], derivatives), law, vehicle)


def write_table(reference: Reference, path: Path, notes: Sequence[str] = ()) -> Path:
    """Write position and yaw of a reference every 20 ms, notes above them. Raises RequestError."""
    rows = _rows(reference)

    def write(part: Path) -> None:
        with part.open("w", encoding="utf-8", newline="") as file:
            file.writelines(f"# {note}\n" for note in notes)
            file.write(",".join((*REQUIRED, "yaw")) + "\n")
            np.savetxt(file, rows, fmt=f"%.{WRITTEN_DIGITS}f", delimiter=",")

    return write_whole(path, write, advice="Give a file in a folder that can be written.")


def _rows(reference: Reference) -> Floats:
    """(n, 5) time, position and yaw, as they are written."""
    before_the_end = np.arange(math.ceil(reference.duration / WRITTEN_STEP - 1e-3)) * WRITTEN_STEP
    motion = reference.sample(np.append(before_the_end, reference.duration))
    return np.asarray(
        np.round(np.column_stack([motion.time, motion.position, motion.yaw]), WRITTEN_DIGITS), dtype=float
    )


def _knots(times: Floats) -> NDArray[np.intp]:
    """Rows (m,) that the curve's polynomials join, the first and the last among them, KNOTS or more apart."""
    chosen = [0]
    for row in range(1, times.size - 1):
        if times[row] - times[chosen[-1]] >= KNOTS * (1 - 1e-9) and times[-1] - times[row] >= KNOTS * (1 - 1e-9):
            chosen.append(row)
    return np.array([*chosen, times.size - 1])


def _local_fits(times: Floats, values: Floats, rows: NDArray[np.intp]) -> Floats:
    """Values and four derivatives at some rows (m,). times: (n,). values: (n, 4). Returns (m, 5, 4)."""
    result = np.empty((rows.size, DERIVATIVES, FLAT))
    factorials = np.array([math.factorial(order) for order in range(DERIVATIVES)], dtype=float)
    for place, row in enumerate(rows):
        window = _window(times, int(row))
        since = times[window] - times[row]
        scale = np.abs(since).max()
        powers = np.vander(since / scale, min(DEGREE, since.size - 1) + 1, increasing=True)
        coefficients = np.linalg.lstsq(powers, values[window], rcond=None)[0][:DERIVATIVES]
        result[place] = coefficients * (factorials / scale ** np.arange(DERIVATIVES))[:, None]
    return result


def _window(times: Floats, row: int) -> slice:
    """The rows that a local fit takes: WINDOW about the row, and those within MIN_SPAN about it."""
    window = min(WINDOW, times.size)
    first = min(max(row - window // 2, 0), times.size - window)
    near = np.searchsorted(times, times[row] + np.array([-0.5, 0.5]) * MIN_SPAN * (1 + 1e-9))
    return slice(min(first, int(near[0])), max(first + window, int(near[1])))


def _joined(times: Floats, derivatives: Floats) -> PiecewisePolynomial:
    steps = np.diff(times)
    polynomials = [_polynomial(derivatives[i], derivatives[i + 1], step) for i, step in enumerate(steps)]
    return PiecewisePolynomial(times, np.stack(polynomials))


def _polynomial(start: Floats, end: Floats, duration: float) -> Floats:
    """Coefficients (10, 4) of the polynomial with derivatives (5, 4) at both ends of a duration, s."""
    scale = duration ** np.arange(DERIVATIVES)[:, None]
    start, end = start * scale, end * scale
    low = start / np.array([math.factorial(order) for order in range(DERIVATIVES)])[:, None]
    powers = np.arange(2 * DERIVATIVES)
    falling = np.array([[math.perm(power, order) for power in powers] for order in range(DERIVATIVES)], dtype=float)
    high = np.linalg.solve(falling[:, DERIVATIVES:], end - falling[:, :DERIVATIVES] @ low)
    return np.asarray(np.vstack([low, high]) / (duration**powers)[:, None])


def _read_columns(path: Path) -> dict[str, Floats]:
    try:
        content = io.StringIO(str(read_packed(path), "utf-8"), newline="")
        rows = [row for row in csv.reader(content) if row and not row[0].startswith("#")]
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise RequestError(f"cannot read the reference {path}: {error}. Give a CSV file.") from error
    if not rows:
        raise RequestError(f"the reference {path} is empty. {_COLUMNS}.")
    header = [name.strip() for name in rows[0]]
    missing = [name for name in REQUIRED if name not in header]
    if missing:
        raise RequestError(
            f"the reference {path} has no column {', '.join(missing)}; it has {', '.join(header)}. {_COLUMNS}."
        )
    twice = {name for name in header if header.count(name) > 1}
    if twice:
        raise RequestError(f"the reference {path} has the column {', '.join(sorted(twice))} twice. {_COLUMNS}.")
    columns: dict[str, Floats] = {name: np.empty(len(rows) - 1) for name in header}
    for number, row in enumerate(rows[1:], start=2):
        if len(row) != len(header):
            raise RequestError(f"{path}, row {number}: {len(row)} values for {len(header)} columns.")
        for name, text in zip(header, row, strict=True):
            columns[name][number - 2] = _number(path, number, name, text)
    return columns


def _number(path: Path, row: int, column: str, text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        raise RequestError(f"{path}, row {row}, column {column}: {text!r} is not a number.") from None
    if not math.isfinite(value):
        raise RequestError(f"{path}, row {row}, column {column}: {text} is not finite. Leave such rows out.")
    return value


def _check(path: Path, columns: dict[str, Floats]) -> None:
    times = columns["t"]
    if times.size < MIN_ROWS:
        raise RequestError(f"the reference {path} has {times.size} rows, at least {MIN_ROWS} are needed.")
    steps = np.diff(times)
    if np.any(steps <= 0):
        row = int(np.argmax(steps <= 0)) + 3
        raise RequestError(f"{path}, row {row}, column t: {times[row - 2]} s is not later than the row before it.")
    position = np.column_stack([columns[f"position_{axis}"] for axis in "xyz"])
    speed = np.linalg.norm(np.diff(position, axis=0), axis=1) / steps
    if np.any(speed > MAX_SPEED):
        row = int(np.argmax(speed > MAX_SPEED)) + 3
        raise RequestError(
            f"{path}, row {row}: the position moves at {speed[row - 3]:.0f} m/s from the row before, more than "
            f"{MAX_SPEED:g} m/s. Give metres and seconds (not mm, not ms), without jumps."
        )
    yaw = columns.get("yaw")
    if yaw is not None and np.any(np.abs(np.diff(yaw)) > np.pi) and np.abs(yaw).max() > 4 * np.pi:
        raise RequestError(f"{path}, column yaw: values up to {np.abs(yaw).max():.0f} look like degrees. Give radians.")


def _yaw(columns: dict[str, Floats]) -> Floats:
    """Yaw along the table, unwrapped, rad."""
    if "yaw" in columns:
        return np.unwrap(columns["yaw"])
    names = [f"attitude_{part}" for part in "wxyz"]
    if all(name in columns for name in names):
        attitude = np.column_stack([columns[name] for name in names])
        return np.unwrap(quaternion.to_euler(attitude)[:, 2])
    return np.zeros_like(columns["t"])
