"""Tracking of the paper's manoeuvres, and the controller behind it."""
