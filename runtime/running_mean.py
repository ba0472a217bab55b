"""Running means of numbers and vectors (first-order low-pass)."""

from __future__ import annotations

from typing import Generic, TypeVar

from dynamics.arrays import Floats

Value = TypeVar("Value", float, Floats)


class RunningMean(Generic[Value]):
    """The mean of a quantity over about the last `averaging` s.

    value: the present mean, initially the constructor's.
    """

    def __init__(self, averaging: float, value: Value) -> None:
        self._averaging = averaging
        self.value: Value = value

    def add(self, sample: Value, elapsed: float) -> None:
        """Add a value that held for `elapsed` s."""
        self.value = self.value + min(elapsed / self._averaging, 1.0) * (sample - self.value)
