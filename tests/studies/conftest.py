"""A small campaign for the sweeps' tests."""

from __future__ import annotations

from pathlib import Path

import pytest

from dynamics.vehicle import Vehicle
from tests.support.small_campaign import fly_campaign

EFFECTS = ("motor_lag:time_constant=0.035", "rotor_drag:coefficient=6e-5")
FLIGHTS = {
    "test/Lemniscate": "Lemniscate:laps=1,ramp=1",
    "train/Parabola_xy_60": "Parabola:laps=2,ramp=1",
    "train/circle_xy_60": "circle:laps=1,ramp=1",
}


@pytest.fixture(scope="session")
def campaign(tmp_path_factory: pytest.TempPathFactory, arpl_250g: Vehicle) -> Path:
    return fly_campaign(tmp_path_factory.mktemp("small") / "campaign", arpl_250g, EFFECTS, FLIGHTS)
