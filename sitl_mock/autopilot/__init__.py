"""PX4's rules: commander, modes, parameters, offboard, failsafe."""
