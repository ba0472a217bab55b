"""What a learned model looks back at: measured states on its grid of columns, predictions where none has come yet."""

from __future__ import annotations

import numpy as np

from dynamics.arrays import Floats
from dynamics.state import RIGID_BODY_STATES

CAPACITY = 256  # rows kept; when they are used up the newer half moves to the front
BRIDGED = 1.5  # columns between two measurements, from which on what was predicted in between stays
WIDEST_GAP = 0.1  # s between two measurements, from which on the history begins anew


class ColumnHistory:
    """Measured states, then predicted ones, and the rotor speeds given meanwhile. Times in seconds of one clock.

    columns: how many the model looks back. dt: s between them. rotors: number of them.
    """

    def __init__(self, columns: int, dt: float, rotors: int) -> None:
        self.columns, self.dt = columns, dt
        self._times = np.zeros(CAPACITY)
        self._states = np.zeros((CAPACITY, RIGID_BODY_STATES))
        self._given = np.zeros(CAPACITY)
        self._speeds = np.zeros((CAPACITY, rotors))
        self._known = self._count = self._commands = 0
        self._since = np.inf
        self._offsets = -dt * np.arange(columns, 0, -1, dtype=np.float64)

    def clear(self) -> None:
        """Forget everything."""
        self._known = self._count = self._commands = 0
        self._since = np.inf

    def measured(self, time: float, state: Floats) -> Floats:
        """Take a measured state (13,); predictions are forgotten. Returns it with its attitude's sign continuous."""
        last = self._known - 1
        if last >= 0 and time <= self._times[last]:
            self._count = self._known
            return np.asarray(self._states[last] if time == self._times[last] else state)
        gap = time - self._times[last] if last >= 0 else np.inf
        if gap > WIDEST_GAP:
            self._known, self._since = 0, time
        elif gap > BRIDGED * self.dt:
            self._known = max(
                self._known, int(np.searchsorted(self._times[: self._count], time - 0.5 * self.dt, side="left"))
            )
        near = self._states[self._known - 1, 6:10] if self._known else np.array([1.0, 0.0, 0.0, 0.0])
        self._count = self._known
        self._append(time, state)
        kept = self._states[self._count - 1]
        if float(kept[6:10] @ near) < 0:
            kept[6:10] *= -1
        self._known = self._count
        return np.asarray(kept)

    def predicted(self, time: float, state: Floats) -> None:
        """Take a prediction (13,) behind what is known."""
        if self._count and time > self._times[self._count - 1]:
            self._append(time, state)

    def commanded(self, time: float, speed: Floats) -> None:
        """Rotor speeds (n,) rad/s that act from a time on."""
        if self._commands == CAPACITY:
            half = CAPACITY // 2
            self._given[:half], self._speeds[:half] = self._given[half:], self._speeds[half:].copy()
            self._commands = half
        self._given[self._commands], self._speeds[self._commands] = time, speed
        self._commands += 1

    def reaches(self, end: float) -> bool:
        """Whether measurements without a hole, and commands, cover the columns before a time."""
        first = end + self._offsets[0] if self.columns else end
        return self._known > 0 and self._commands > 0 and max(self._since, self._given[0]) <= first + 1e-9

    def fill(self, end: float, out: Floats) -> None:
        """Write the columns (columns, 13 + rotors) before a time; where nothing is known, the oldest that is."""
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
            out[:, 6:10] /= np.linalg.norm(out[:, 6:10], axis=1, keepdims=True)
        if self._commands:
            acting = np.searchsorted(self._given[: self._commands], times + 1e-9, side="right") - 1
            out[:, RIGID_BODY_STATES:] = self._speeds[np.maximum(acting, 0)]

    def prediction_at(self, time: float) -> Floats | None:
        """What was predicted (13,) for a time from the last measurement, None where nothing reaches there."""
        first = self._known - 1
        rows = self._times[: self._count]
        if first < 0 or self._count - first < 2 or not rows[first] < time <= rows[-1]:
            return None
        after = int(np.searchsorted(rows, time, side="left"))
        share = (time - rows[after - 1]) / (rows[after] - rows[after - 1])
        return np.asarray(self._states[after - 1] + share * (self._states[after] - self._states[after - 1]))

    @property
    def last_measured(self) -> tuple[float, Floats] | None:
        """Time and state (13,) of the newest measurement."""
        return (float(self._times[self._known - 1]), self._states[self._known - 1]) if self._known else None

    def _append(self, time: float, state: Floats) -> None:
        if self._count == CAPACITY:
            half = CAPACITY // 2
            self._times[:half], self._states[:half] = self._times[half:], self._states[half:].copy()
            self._since = max(self._since, float(self._times[0]))
            self._count, self._known = half, max(self._known - half, 0)
        self._times[self._count], self._states[self._count] = time, state
        self._count += 1
