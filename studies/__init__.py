"""What reproduces the paper and compares models: the demo, evaluations, sweeps, their tables and figures."""
