"""Candidates: the effects that logs could show."""
