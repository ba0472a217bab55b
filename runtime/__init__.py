"""The daemon that flies beside the flight controller: link, clock, controller, failsafe, recorder."""
