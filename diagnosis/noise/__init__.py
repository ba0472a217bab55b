"""Random parts of a flight and its logs as state spaces driven by white noise: the twin of `dynamics.effects`."""
