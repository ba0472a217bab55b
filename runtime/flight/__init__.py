"""The flight logic: engagement, mission, health, failsafe. Pure."""
