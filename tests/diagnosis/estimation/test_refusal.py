"""Reasons for which effects are not named, in words for people."""

from __future__ import annotations

from typing import get_args

import pytest

from diagnosis.estimation.refusal import Reason, Refused, reason_of
from diagnosis.models.channels import KINDS, NAMES

NUMBERS = {
    "before": 0.4638, "after": 0.4721, "floor": 0.3, "deviations": 1.2, "required": 2.0, "share": 0.1, "motion": 3.0,
    "odds": 3.0, "size": 0.01,
}  # fmt: skip


@pytest.mark.parametrize("reason", get_args(Reason))
@pytest.mark.parametrize("kind", KINDS)
def test_channels_have_the_names_that_tables_have(reason: Reason, kind: str) -> None:
    for numbers in (NUMBERS, NUMBERS | {"signal": 0.1}):
        text = reason_of(Refused("mass", None, reason, numbers, kind))
        assert "imu" not in text
        assert "mocap" not in text
        if kind in reason_of(Refused("mass", None, reason, numbers, f"<{kind}>")):
            assert NAMES[kind] in text
