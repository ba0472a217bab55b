"""Learned dynamics models: PI-TCN, its baselines, and grey box + residual (workbench only)."""
