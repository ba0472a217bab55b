"""The record of a case that was asked, as the run's folder has it."""

from __future__ import annotations

from typing import Any

import msgspec

from benchmarks.verdict.scoring import Answer, Expected


class Record(msgspec.Struct, frozen=True):
    """A case that was asked.

    key, set_name, seed: of the case. conditions: how it was flown.
    lost: whether there was nothing to ask, as the vehicle did not keep its path.
    took: processor seconds from the logs to the answer.
    """

    key: str
    set_name: str
    seed: int
    expected: Expected
    answer: Answer
    took: float
    conditions: dict[str, Any] = {}
    lost: bool = False
