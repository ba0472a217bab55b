"""A group of thresholds, and the kinds of numbers in it."""

from __future__ import annotations

from typing import Annotated

from msgspec import Meta, Struct

Positive = Annotated[float, Meta(gt=0)]
Score = Annotated[float, Meta(ge=0)]
Share = Annotated[float, Meta(ge=0, le=1)]
Factor = Annotated[float, Meta(ge=1)]
Correlation = Annotated[float, Meta(ge=-1, le=1)]
Count = Annotated[int, Meta(ge=1)]
Range = tuple[Score, Score]
Shares = tuple[Share, Share]
Percent = Annotated[float, Meta(ge=0, le=100)]


class ThresholdGroup(Struct, frozen=True, forbid_unknown_fields=True):
    """Thresholds of one subject. Raises ValueError for a range whose first value is not below its second."""

    def __post_init__(self) -> None:
        """Check the ranges, which are the fields of two values."""
        for name in self.__struct_fields__:
            value = getattr(self, name)
            if isinstance(value, tuple) and len(value) == 2 and not value[0] < value[1]:
                raise ValueError(f"{name} is {value[0]:g} to {value[1]:g}: the first must be below the second")
