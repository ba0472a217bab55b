"""The link and the daemon: parsing, floods, clocks, timing, recording."""
