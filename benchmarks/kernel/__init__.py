"""The real-time iteration: its kernel, its quadratic programs, its worst cases, and acados beside it."""
