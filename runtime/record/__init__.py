"""Recordings of flights: writing, reading, replaying."""
