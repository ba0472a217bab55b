"""The daemon on the companion computer: link, clock, controller, fallbacks, recorder."""
