"""[controller] of a vehicle file: the controller's weights, horizon and timing, each within bounds.

Everything has a default. The lookaheads' defaults follow from the vehicle's rate loop (`dynamics.controller_defaults`).
"""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise

import msgspec

from dynamics.arrays import Vector3
from dynamics.errors import RequestError

CONTROL_RATE = 100.0  # Hz
CONTROL_PERIOD = 1 / CONTROL_RATE  # s
GRID = 0.01  # s, on which nodes lie where intervals grow: a network's steps fit in whole
MAX_NODES = 100  # the dense QP of 100 nodes has 400 variables and takes longer than any control period

# setting: smallest value, largest value, unit
BOUNDS: Mapping[str, tuple[float, float, str]] = {
    "rate": (20.0, 500.0, "Hz"),
    "nodes": (2, MAX_NODES, "nodes"),
    "horizon": (0.05, 10.0, "s"),
    "growth": (1.0, 2.0, "times the interval before"),
    "position_weight": (0.0, 1e6, "1/m^2"),
    "velocity_weight": (0.0, 1e6, "1/(m/s)^2"),
    "attitude_weight": (0.0, 1e6, "per squared quaternion component"),
    "rate_weight": (0.0, 1e6, "1/(rad/s)^2"),
    "input_weight": (1e-6, 1e6, "per squared rotor speed over hover speed"),
    "terminal_weight": (0.0, 1e3, "times the other nodes' weights"),
    "levenberg_marquardt": (0.0, 1e3, "on the Hessian's diagonal"),
    "tolerance": (1e-9, 1e-2, "of the quadratic program"),
    "iterations": (1, 200, "iterations"),
    "preparation_iterations": (1, 200, "iterations"),
    "soft_penalty": (1e-3, 1e8, "per violation"),
    "rate_lookahead": (0.0, 1.0, "s"),
    "yaw_lookahead": (0.0, 2.0, "s"),
    "delay": (0.0, 0.1, "s"),
    "max_position_error": (0.1, 100.0, "m"),
}


class ControllerSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True):
    """The controller's settings in a vehicle file. The cost is that of PI-TCN eq. 7.

    rate: control rate, Hz.
    nodes: shooting nodes N of the horizon.
    horizon: length of the prediction, s.
    growth: length of each interval between nodes over the one before: 1 for equal ones. See `intervals_of`.
    position_weight: world x, y, z, 1/m^2.
    velocity_weight: world x, y, z, 1/(m/s)^2.
    attitude_weight: on quaternion components.
    rate_weight: on body rates, 1/(rad/s)^2.
    input_weight: on rotor speed over hover speed.
    terminal_weight: factor from these weights to the last node's.
    levenberg_marquardt: added to the Hessian's diagonal.
    tolerance: of the quadratic program's optimality.
    iterations: at most, of the quadratic program once the state is measured.
    preparation_iterations: at most, before the state is measured.
    soft_penalty: price of leaving such a bound, linear and quadratic.
    keep_in_box: whether the prediction keeps to the position box of [limits].
    rate_lookahead: time along the prediction's slope at which roll and pitch rate setpoints are read, s; by default
        the delay with which the autopilot's rate loop follows them.
    yaw_lookahead: the same of the yaw rate, s.
    delay: from a command's departure to its action, s; added to the age of every estimate.
    max_position_error: distance, m, to which the position error is limited; a linearisation does not reach further.
    """

    rate: float = CONTROL_RATE
    nodes: int = 20
    horizon: float = 1.0
    growth: float = 1.0
    position_weight: Vector3 = (60.0, 60.0, 60.0)
    velocity_weight: Vector3 = (1.0, 1.0, 1.0)
    attitude_weight: float = 8.0
    rate_weight: Vector3 = (0.05, 0.05, 0.05)
    input_weight: float = 4.0
    terminal_weight: float = 3.0
    levenberg_marquardt: float = 1e-3
    tolerance: float = 1e-3
    iterations: int = 5
    preparation_iterations: int = 12
    soft_penalty: float = 300.0
    keep_in_box: bool = True
    rate_lookahead: float | None = None
    yaw_lookahead: float | None = None
    delay: float = 0.005
    max_position_error: float = 2.0

    def __post_init__(self) -> None:
        """Refuse values that the solver or a flight cannot use."""
        for name, bounds in BOUNDS.items():
            value = getattr(self, name)
            if value is not None:
                _require_within(name, value if isinstance(value, tuple) else (value,), *bounds)
        if not any(self.position_weight):
            raise RequestError(
                "controller.position_weight is zero in all axes: nothing would hold the vehicle's place."
            )
        shortest = min(intervals_of(self.horizon, self.nodes, self.growth))
        if 1 / self.rate > shortest:
            less = ", a smaller growth" if self.growth > 1 else ""
            raise RequestError(
                f"controller.rate = {self.rate:g} Hz: its period of {1e3 / self.rate:.3g} ms is longer than a node of "
                f"{1e3 * shortest:.3g} ms. Raise the rate, take fewer nodes{less} or a longer horizon."
            )
        for name in ("rate_lookahead", "yaw_lookahead", "delay"):
            value = getattr(self, name)
            if value is not None and value > self.horizon:
                raise RequestError(
                    f"controller.{name} = {value:g} s is beyond the horizon of {self.horizon:g} s; give at most that."
                )


def intervals_of(horizon: float, nodes: int, growth: float) -> tuple[float, ...]:
    """Lengths (N,) of the intervals between nodes, s.

    Each is `growth` times the one before, so that the k-th node is at horizon (growth^k - 1) / (growth^N - 1), then
    rounded to GRID. Equal ones are not rounded. Raises RequestError where one would be shorter than GRID.
    """
    if growth == 1.0:
        return (horizon / nodes,) * nodes
    ends = [round(horizon / GRID * (growth**k - 1) / (growth**nodes - 1)) for k in range(nodes)]
    if any(stop <= start for start, stop in pairwise(ends)):
        raise RequestError(
            f"controller.growth = {growth:g}: the first of {nodes} intervals in {horizon:g} s would be shorter than "
            f"{1e3 * GRID:g} ms. Give a smaller growth, fewer nodes or a longer horizon."
        )
    lengths = [GRID * (stop - start) for start, stop in pairwise(ends)]
    return (*lengths, horizon - GRID * ends[-1])


def _require_within(name: str, values: tuple[float, ...], lower: float, upper: float, unit: str) -> None:
    for value in values:
        if not lower <= value <= upper:  # false for nan as well
            raise RequestError(
                f"controller.{name} = {value:g}: give {lower:g} to {upper:g} ({unit}), or leave it out for the default."
            )
