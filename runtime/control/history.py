"""A learned model's history: measured states on its grid of columns, predictions after the newest measurement."""

from __future__ import annotations

import numpy as np

from dynamics.arrays import Floats
from dynamics.state import ATTITUDE, RIGID_BODY_STATES

CAPACITY = 256  # rows; when all are used the newer half moves to the front
MAX_SPACING = 1.5  # columns between two measurements; a longer interval keeps the predictions in it
MAX_GAP = 0.1  # s between two measurements; after a longer one the history restarts


class ColumnHistory:
    """Measured states, then predicted ones, and the commanded rotor speeds. Times in seconds of one clock.

    columns: of the model's history.
    dt: s between them.
    rotors: number of rotors.
    """

    def __init__(self, columns: int, dt: float, rotors: int) -> None:
        self.columns, self.dt = columns, dt
        self._times = np.zeros(CAPACITY)
        self._states = np.zeros((CAPACITY, RIGID_BODY_STATES))
        self._command_times = np.zeros(CAPACITY)
        self._speeds = np.zeros((CAPACITY, rotors))
        self._measurements = self._count = self._commands = 0
        self._since = np.inf
        self._offsets = -dt * np.arange(columns, 0, -1, dtype=np.float64)

    def clear(self) -> None:
        """Forget everything."""
        self._measurements = self._count = self._commands = 0
        self._since = np.inf

    def add_measurement(self, time: float, state: Floats) -> Floats:
        """Append a measured state (13,) in place of the predictions. Returns it with its attitude's sign continuous."""
        last = self._measurements - 1
        if last >= 0 and time <= self._times[last]:
            self._count = self._measurements
            return np.asarray(self._states[last] if time == self._times[last] else state)
        gap = time - self._times[last] if last >= 0 else np.inf
        if gap > MAX_GAP:
            self._measurements, self._since = 0, time
        elif gap > MAX_SPACING * self.dt:
            self._measurements = max(
                self._measurements, int(np.searchsorted(self._times[: self._count], time - 0.5 * self.dt, side="left"))
            )
        near = self._states[self._measurements - 1, ATTITUDE] if self._measurements else np.array([1.0, 0.0, 0.0, 0.0])
        self._count = self._measurements
        self._append(time, state)
        row = self._states[self._count - 1]
        if float(row[ATTITUDE] @ near) < 0:
            row[ATTITUDE] *= -1
        self._measurements = self._count
        return np.asarray(row)

    def add_prediction(self, time: float, state: Floats) -> None:
        """Append a prediction (13,) after the measurements."""
        if self._count and time > self._times[self._count - 1]:
            self._append(time, state)

    def add_command(self, time: float, speed: Floats) -> None:
        """Append rotor speeds (n,) rad/s that act from a time on."""
        if self._commands == CAPACITY:
            half = CAPACITY // 2
            self._command_times[:half], self._speeds[:half] = self._command_times[half:], self._speeds[half:].copy()
            self._commands = half
        self._command_times[self._commands], self._speeds[self._commands] = time, speed
        self._commands += 1

    def reaches(self, end: float) -> bool:
        """Whether measurements without a gap, and commands, cover the columns before a time."""
        first = end + self._offsets[0] if self.columns else end
        return (
            self._measurements > 0 and self._commands > 0 and max(self._since, self._command_times[0]) <= first + 1e-9
        )

    def write_columns(self, end: float, out: Floats) -> None:
        """Write the columns (columns, 13 + rotors) before a time; those before the oldest row repeat it."""
        if not self.columns or self._count == 0:
            return
        times = end + self._offsets
        rows = self._times[: self._count]
        after = np.clip(np.searchsorted(rows, times, side="right"), 1, max(self._count - 1, 1))
        if self._count == 1:
            out[:, :RIGID_BODY_STATES] = self._states[0]
        else:
            before = after - 1
            share = np.clip((times - rows[before]) / (rows[after] - rows[before]), 0.0, 1.0)[:, None]
            out[:, :RIGID_BODY_STATES] = self._states[before] + share * (self._states[after] - self._states[before])
            out[:, ATTITUDE] /= np.linalg.norm(out[:, ATTITUDE], axis=1, keepdims=True)
        if self._commands:
            acting = np.searchsorted(self._command_times[: self._commands], times + 1e-9, side="right") - 1
            out[:, RIGID_BODY_STATES:] = self._speeds[np.maximum(acting, 0)]

    def prediction_at(self, time: float) -> Floats | None:
        """The prediction (13,) for a time from the last measurement, None where it does not reach that time."""
        first = self._measurements - 1
        rows = self._times[: self._count]
        if first < 0 or self._count - first < 2 or not rows[first] < time <= rows[-1]:
            return None
        after = int(np.searchsorted(rows, time, side="left"))
        share = (time - rows[after - 1]) / (rows[after] - rows[after - 1])
        return np.asarray(self._states[after - 1] + share * (self._states[after] - self._states[after - 1]))

    @property
    def last_measured(self) -> tuple[float, Floats] | None:
        """Time and state (13,) of the newest measurement."""
        return (
            (float(self._times[self._measurements - 1]), self._states[self._measurements - 1])
            if self._measurements
            else None
        )

    def _append(self, time: float, state: Floats) -> None:
        if self._count == CAPACITY:
            half = CAPACITY // 2
            self._times[:half], self._states[:half] = self._times[half:], self._states[half:].copy()
            self._since = max(self._since, float(self._times[0]))
            self._count, self._measurements = half, max(self._measurements - half, 0)
        self._times[self._count], self._states[self._count] = time, state
        self._count += 1
