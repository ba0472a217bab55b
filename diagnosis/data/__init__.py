"""Flights as diagnosis needs them: segments, filters, command curves, and the checks on them."""
