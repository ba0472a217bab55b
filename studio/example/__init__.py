"""Logs to try the studio with: a quadrotor of PX4's simulation with twice the drag of its vehicle file."""

from __future__ import annotations

from pathlib import Path

FOLDER = Path(__file__).parent
NAME = "Example: a quadrotor with unmodelled drag"
VEHICLE = "px4_sih"


def example_logs() -> list[Path]:
    """The logs, in the order of their names."""
    return sorted(FOLDER.glob("*.ulg.gz"))
