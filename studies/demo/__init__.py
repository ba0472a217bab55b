"""The main job end to end on a simulated vehicle: fly, diagnose, add, fly again."""
