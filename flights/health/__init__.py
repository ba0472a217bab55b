"""A flight's health by what logs at default rates have: who gave up first, and what every statement rests on."""

from flights.health.answer import Evidence, Health, HealthEvent, Statement
from flights.health.reading import read_health

__all__ = ["Evidence", "Health", "HealthEvent", "Statement", "read_health"]
