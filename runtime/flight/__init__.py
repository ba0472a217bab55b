"""The flight logic: engagement, mission, health, fallbacks, thrust.

Modules and classes that are called pure have state, but read no clock and do no input or output: times are arguments.
"""
