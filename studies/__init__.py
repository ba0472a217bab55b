"""Studies that reproduce the paper and compare models: the demo, evaluations, sweeps, their tables and figures."""
