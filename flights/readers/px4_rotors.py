"""PX4's motor numbers in our rotor order, from the geometry in the log."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from dynamics.arrays import Floats
from dynamics.autopilot_frames import QUAD_X_ORDER

QUADROTOR = 2  # MAV_TYPE
QUAD_X = QUAD_X_ORDER  # PX4's motor 1 is front right, 2 back left, 3 front left, 4 back right
FIRST_MOTOR_FUNCTION, LAST_MOTOR_FUNCTION = 101, 112
_PWM_LOW, _PWM_SPAN = 1000.0, 1000.0  # microseconds of a motor at rest and its range
_UNUSED_PWM = 800.0  # below: the channel is not used
_QUADRANTS = ((1, 1), (-1, 1), (-1, -1), (1, -1))  # of our rotors 0 to 3: signs of x forward and y left


def rotor_order(parameters: Mapping[str, float], vehicle_type: int | None) -> tuple[tuple[int, ...] | None, str]:
    """For each of our rotors PX4's motor index, or None to leave them in PX4's order; and a note with the reason.

    parameters: PX4's, by name.
    vehicle_type: MAV_TYPE, None where the log has none.
    """
    count = int(parameters.get("CA_ROTOR_COUNT", 0))
    if count == 4:
        positions = [
            (parameters.get(f"CA_ROTOR{i}_PX", 0.0), -parameters.get(f"CA_ROTOR{i}_PY", 0.0)) for i in range(count)
        ]
        quadrants = [(int(np.sign(x)), int(np.sign(y))) for x, y in positions]
        if sorted(quadrants) == sorted(_QUADRANTS):
            order = tuple(quadrants.index(quadrant) for quadrant in _QUADRANTS)
            return order, "rotors put in our order by CA_ROTORn_PX and PY"
    if count == 0 and vehicle_type == QUADROTOR:
        return QUAD_X, "rotors put in our order as PX4's quad x: the log states no geometry"
    if count:
        return None, f"{count} rotors left in PX4's order: they do not stand one in each quadrant"
    return None, "motors left in PX4's order: the log states neither geometry nor a quadrotor"


def in_our_order(motors: Floats, order: tuple[int, ...] | None) -> Floats:
    """Columns of motors as rotors. motors: (n, k). Motors beyond the order are dropped."""
    if order is None or motors.shape[1] < len(order):
        return motors
    return motors[:, list(order)]


def commands_of_pulses(pulses: Floats) -> tuple[Floats, str]:
    """Rotor commands 0..1 of SERVO_OUTPUT_RAW's pulses in us, and a note; no columns when no pulse ever changes.

    pulses: (n, outputs). Returns (n, k), in our order if there are four.
    """
    command = share_of_pulses(pulses)
    used = command.shape[1]
    if used == 0:
        return command, "SERVO_OUTPUT_RAW never changes: no rotor commands from it"
    order = QUAD_X if used == 4 else None
    note = "rotor commands are SERVO_OUTPUT_RAW's pulses from 1000 to 2000 us, output n taken for motor n" + (
        " and put in our order as PX4's quad x" if order else f", {used} motors left in their order"
    )
    return in_our_order(command, order), note


def share_of_pulses(pulses: Floats) -> Floats:
    """Commands 0..1 of pulses from 1000 to 2000 us (n, outputs), of those outputs alone that are used and change."""
    used = int(np.count_nonzero((pulses > _UNUSED_PWM).any(axis=0) & (np.ptp(pulses, axis=0) > 0)))
    return np.asarray(np.clip((pulses[:, :used] - _PWM_LOW) / _PWM_SPAN, 0.0, 1.0))


def join_groups(time: Floats, first: Floats, speed: Floats) -> tuple[Floats, Floats]:
    """ESC reports of a few motors at a time as rows of all motors, at the times of the first motors' reports.

    time: (n,). first: (n,) index of a report's first motor. speed: (n, k). Returns (m,) and (m, motors), without the
    motors at the end that never turned.
    """
    starts = np.unique(first)
    base = time[first == starts[0]]
    parts = []
    for start in starts:
        stamps, values = time[first == start], speed[first == start]
        after = np.clip(np.searchsorted(stamps, base), 0, len(stamps) - 1)
        before = np.maximum(after - 1, 0)
        nearest = np.where(np.abs(stamps[before] - base) < np.abs(stamps[after] - base), before, after)
        parts.append(values[nearest])
    joined = np.concatenate(parts, axis=1)
    turning = np.flatnonzero((joined != 0).any(axis=0))
    count = max(4, int(turning[-1]) + 1) if len(turning) else joined.shape[1]
    return base, joined[:, :count]
