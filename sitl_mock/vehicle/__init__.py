"""The simulated vehicle: plant, inner loops, sensors, battery, ground."""
