"""A mock flight controller that behaves on the wire as PX4 does, with a plant that may hide any effect."""
