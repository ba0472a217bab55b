"""The real-time-iteration solver: CasADi model code and a C kernel over HPIPM, behind one foreign call a phase."""
