"""Estimates of parameters beside planted truths: intervals, identification flights, vehicle constants."""
