"""What a flight's model follows, as a recording has it."""

from __future__ import annotations

import numpy as np

from runtime.flight.flyer import Flyer
from runtime.record.records import FollowedRecord


def followed_record(flyer: Flyer, now: float) -> FollowedRecord | None:
    """What the flying controller's model follows at a time, s; None where it does not follow."""
    if flyer.adaptation is None:
        return None
    filtered, named = flyer.adaptation.filter, flyer.followed
    values = np.array([value.value for value in named.values()])
    deviations = np.array([value.std for value in named.values()])
    estimated = filtered.staying.copy(), filtered.fading.copy(), filtered.trust.copy()
    return FollowedRecord(now, *estimated, " ".join(named), values, deviations)
