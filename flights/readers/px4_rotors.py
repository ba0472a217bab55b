"""PX4's motor numbers in our rotor order, from the geometry in the log, and its outputs on the link."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from dynamics.arrays import Floats
from dynamics.autopilot_frames import QUAD_X_ORDER
from flights.assembly import Assembly
from flights.movement import moving_columns
from flights.rotor_ranges import PX4_KINDS, infer_range

QUADROTOR = 2  # MAV_TYPE
QUAD_X = QUAD_X_ORDER  # PX4's motor 1 is front right, 2 back left, 3 front left, 4 back right
FIRST_MOTOR_FUNCTION, LAST_MOTOR_FUNCTION = 101, 112
_COUNTS = (8, 6, 4)  # rotors of usual multirotors
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


def add_servo_outputs(assembly: Assembly, time: Floats, outputs: Floats, source: str, *, of_px4: bool = True) -> None:
    """Add rotor commands of pulses of outputs, those of PX4 in our order if there are four.

    time: (n,) s. outputs: (n, outputs). Those that move and are no motors are kept as unused.
    """
    moving = moving_columns(outputs)
    fields = [f"output[{column}]" for column in range(outputs.shape[1])]
    motors = _first_run(moving)
    ranged = infer_range(time, outputs[:, motors], (), PX4_KINDS) if motors else None
    if ranged is None:
        reason = "their range is none that is known" if motors else "none of them moves"
        assembly.note(f"{source}: no rotor commands from it: {reason}")
        assembly.leave_out("rotor_command", source, fields, outputs, reason)
        return
    order = QUAD_X if of_px4 and len(motors) == 4 else None
    named = ", ".join(str(column + 1) for column in motors)
    put = "put in our order as PX4's quad x" if order else "left in their order"
    taken = f"taken for motors 1 to {len(motors)} and {put}"
    assembly.infer(f"rotor commands are {source}'s outputs {named}, {taken}: {ranged}")
    assembly.add("rotor_command", time, in_our_order(ranged.scaled(outputs[:, motors]), order), source)
    others = [column for column in moving if column not in motors]
    if others:
        left = [fields[column] for column in others]
        assembly.leave_out("rotor_command", source, left, outputs[:, others], "they are not beside the motors' outputs")


def _first_run(columns: Sequence[int]) -> list[int]:
    """The first columns that lie side by side, and as many as a multirotor has rotors where there are that many."""
    run = [column for place, column in enumerate(columns) if column == columns[0] + place]
    return run[: next((count for count in _COUNTS if count <= len(run)), len(run))]


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
