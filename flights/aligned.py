"""A log as it should be fitted: its streams' clocks put right, and only its free flight."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from flights.delays import Delay, estimate_delays, remove_delays
from flights.exclusion import Exclusion, excluded_rows, find_exclusions
from flights.flight import Flight
from flights.reading import read_log


@dataclass(frozen=True, eq=False)
class AlignedFlight:
    """A whole flight with its clocks put right. delays: as found before. exclusions: what is no free flight."""

    flight: Flight
    delays: tuple[Delay, ...]
    exclusions: tuple[Exclusion, ...]

    def segments(self) -> tuple[Flight, ...]:
        """The segments of free flight."""
        return self.flight.segments(exclude=excluded_rows(self.flight, self.exclusions))


def read_aligned(path: str | Path, *, mapping: str | Path | None = None, rate: float | None = None) -> AlignedFlight:
    """Read a log, find what is no free flight and how late its streams are, and put their stamps right.

    mapping: column-mapping TOML for a foreign CSV. rate: Hz of the common clock, by default that of the gyro. Delays
    that are known to 8 ms or better are taken off, a command's response never. Raises as `Flight.read` does.
    """
    log = read_log(path, mapping=mapping)
    exclusions = find_exclusions(Flight.from_log(log, rate=rate))
    delays = estimate_delays(log, exclusions=exclusions)
    flight = Flight.from_log(remove_delays(log, delays), rate=rate)
    return AlignedFlight(flight, delays, find_exclusions(flight))
