"""The real-time-iteration solver: CasADi model code and a C kernel, behind one foreign call a phase."""
