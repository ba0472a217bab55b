"""The flight logic: engagement, mission, health, fallbacks, thrust. Pure."""
