"""The mean of a quantity over about the last seconds, of numbers or of vectors."""

from __future__ import annotations

from typing import Generic, TypeVar

from dynamics.arrays import Floats

Value = TypeVar("Value", float, Floats)


class RunningMean(Generic[Value]):
    """value: the mean over about the last `averaging` s; it begins as given."""

    def __init__(self, averaging: float, value: Value) -> None:
        self._averaging = averaging
        self.value: Value = value

    def add(self, sample: Value, elapsed: float) -> None:
        """A value that held for `elapsed` s."""
        self.value = self.value + min(elapsed / self._averaging, 1.0) * (sample - self.value)
