"""A log as it should be fitted: stamps corrected for delays, and free flight only."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from flights.delays import Delay, estimate_delays, remove_delays
from flights.exclusion import Exclusion, excluded_rows, find_exclusions
from flights.flight import Flight
from flights.reading import read_log


@dataclass(frozen=True, eq=False)
class AlignedFlight:
    """A flight whose streams' delays are removed.

    delays: as estimated before their removal.
    exclusions: segments that are not free flight.
    """

    flight: Flight
    delays: tuple[Delay, ...]
    exclusions: tuple[Exclusion, ...]

    def segments(self) -> tuple[Flight, ...]:
        """The segments of free flight."""
        return self.flight.segments(exclude=excluded_rows(self.flight, self.exclusions))


def read_aligned(path: str | Path, *, mapping: str | Path | None = None, rate: float | None = None) -> AlignedFlight:
    """Read a log, estimate its streams' delays, and remove those known to 8 ms or better, never a command's response.

    mapping: column-mapping TOML for a foreign CSV.
    rate: Hz of the common clock, by default that of the gyro.

    Raises as `Flight.read` does.
    """
    log = read_log(path, mapping=mapping)
    exclusions = find_exclusions(Flight.from_log(log, rate=rate))
    delays = estimate_delays(log, exclusions=exclusions)
    flight = Flight.from_log(remove_delays(log, delays), rate=rate)
    return AlignedFlight(flight, delays, find_exclusions(flight))
