"""Learning what the vehicle file does not say: PI-TCN, its baselines, and grey box + residual (workbench only)."""
