"""Followed parameters of a flight, as a recording has them."""

from __future__ import annotations

import math

import msgspec
import numpy as np

from runtime.flight.flyer import Flyer
from runtime.record.records import FollowedRecord


def followed_record(flyer: Flyer, now: float) -> FollowedRecord | None:
    """Parameters that the flying controller's model follows at a time, s; None where it does not follow."""
    if flyer.controllers.adaptation is None:
        return None
    filtered, named = flyer.controllers.adaptation.filter, flyer.controllers.followed
    values = np.array([value.value for value in named.values()])
    deviations = np.array([value.std for value in named.values()])
    estimated = filtered.staying.copy(), filtered.fading.copy(), filtered.trust.copy()
    record = FollowedRecord(
        now,
        *estimated,
        " ".join(named),
        values,
        deviations,
        filtered.disturbance_deviations,
        flyer.effectiveness.value,
        math.sqrt(flyer.effectiveness.variance),
    )
    layer = flyer.controllers.adaptation.network
    if layer is None:
        return record
    return msgspec.structs.replace(
        record,
        network_trust=layer.trust,
        network_change=np.linalg.norm(layer.change, axis=1),
        network_errors=np.sqrt(layer.squares),
    )
