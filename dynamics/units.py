"""Units outside SI that autopilots, logs and published tables use, as factors: value in SI = factor * value."""

from math import pi

RPM = 2 * pi / 60  # rad/s in one revolution per minute
