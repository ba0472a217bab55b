"""Learned models: studies, goals, labels."""
