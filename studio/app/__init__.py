"""The studio in the browser: a local page on which a user goes from logs to a better model."""
