"""C macros of the state's layout, generated from dynamics.state for the headers that index it."""

from __future__ import annotations

from dynamics import state
from dynamics.vehicle import GRAVITY

STATE_HEADER = "state.h"


def state_header() -> str:
    """The text of state.h: where each part of the rigid-body state begins, its length, and gravity in m/s^2."""
    numbers = {
        "POSITION": state.POSITION.start,
        "VELOCITY": state.VELOCITY.start,
        "ATTITUDE": state.ATTITUDE.start,
        "RATE": state.RATE.start,
        "RIGID_BODY_STATES": state.RIGID_BODY_STATES,
        "GRAVITY": repr(GRAVITY),
    }
    return "".join(f"#define {name} {value}\n" for name, value in numbers.items())
