"""Results on disk as pages: of `evaluate`, `sweep`, `train`, `fly` and `diagnose --fleet`, also while they run."""
