"""Many trainings: the paper's studies, grids and searches, resumable."""
