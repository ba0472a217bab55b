"""Flights: any log as one aligned table with units and frames, and where it came from."""

from flights.flight import Flight
from flights.log import Log, Origin, Provenance, Repair, Stream
from flights.reading import read_folder, read_log, read_pieces

__all__ = ["Flight", "Log", "Origin", "Provenance", "Repair", "Stream", "read_folder", "read_log", "read_pieces"]
