"""The MAVLink link to a vehicle."""
