"""Closed-loop poles: the flight that was lost, the table of what `alula add` can write, and independent cases."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from itertools import product

import msgspec
import numpy as np
import pytest

from dynamics.model import build_model
from dynamics.rate_loop import (
    RateController,
    autopilot_gains,
    rate_controller,
    rate_loop,
    with_gains_kept,
)
from dynamics.trim import find_trim
from dynamics.vehicle import EffectUse, Vehicle
from dynamics.vehicle_file import read_vehicle
from runtime.control.closed_loop import (
    HoverModel,
    LinearController,
    Oscillation,
    Timing,
    closed_loop_poles,
    hover_model,
    least_damped,
    linear_controller,
)
from runtime.control.controller import ControllerOptions
from vehicles import FOLDER

VEHICLES = ("px4_sih", "arpl_250g", "crazyflie")
