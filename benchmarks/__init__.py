"""Measurements: one script a claim, each of which writes its own table."""
