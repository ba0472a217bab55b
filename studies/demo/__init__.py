"""The whole loop on a simulated vehicle: fly, diagnose, add, fly again."""
