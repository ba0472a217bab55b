"""Flights as diagnosis needs them: segments, channels, filters, and the checks on them."""
