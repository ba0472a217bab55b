"""Whether a flight's columns are what they declare while it flies: the question that `inspect` and `diagnose` share."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from flights.flight import Flight
from flights.hypotheses import Hypothesis, explain
from flights.log import Stream
from flights.quality.findings import Finding
from flights.quantities import MOTION


def declared_wrong(streams: Sequence[Stream]) -> list[Finding]:
    """Hypotheses about the streams, and contradictions between them, as findings."""
    return [Finding("error", one.name, _statement(one), one.advice, fatal=True) for one in explain(streams)]


def _statement(hypothesis: Hypothesis) -> str:
    return f"{hypothesis.text} ({hypothesis.evidence})" if hypothesis.evidence else hypothesis.text


def flying_streams(flight: Flight, free: Sequence[Flight]) -> list[Stream]:
    """The streams of motion of a flight, NaN where it does not fly. free: its segments of free flight."""
    flying = np.zeros(len(flight), dtype=bool)
    for part in free:
        flying |= (flight.time >= part.time[0]) & (flight.time <= part.time[-1])
    if not flying.any():
        return []
    return [Stream(n, flight.time, np.where(flying[:, None], flight[n], np.nan), "") for n in MOTION if flight.has(n)]
