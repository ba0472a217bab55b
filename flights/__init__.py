"""Flights: any log as one aligned table with units and frames, and where it came from."""

from flights.aligned import AlignedFlight, read_aligned
from flights.delays import estimate_delays, remove_delays
from flights.exclusion import find_exclusions, free_flight
from flights.flight import Flight
from flights.log import Log, Origin, Provenance, Repair, Stream
from flights.reading import read_chunks, read_folder, read_log

__all__ = [
    "AlignedFlight", "Flight", "Log", "Origin", "Provenance", "Repair", "Stream", "estimate_delays", "find_exclusions",
    "free_flight", "read_aligned", "read_chunks", "read_folder", "read_log", "remove_delays",
]  # fmt: skip
