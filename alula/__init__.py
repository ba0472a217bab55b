"""Alula makes a quadrotor's flight model true and flies with it."""

__version__ = "0.1.0"
