"""The pairs of signals that must be one motion: turning and body rates, acceleration and specific force, and more.

All are means over a short span on one grid, so that sensors' delays and noise weigh little beside the motion.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from dynamics import quaternion
from dynamics.arrays import Floats
from dynamics.vehicle import GRAVITY
from flights.agreement import SAME_SIZE
from flights.alignment import resample
from flights.hypotheses.scales import usual_force
from flights.log import Stream, spanning_streams
from flights.quantities import MOTION

GRID_RATE = 50.0  # Hz
MAX_ROWS = 20_000  # 400 s: more motion decides nothing further
SPAN = 5  # steps, 0.1 s
MIN_ROWS = 200  # of the grid, 4 s of motion, below which nothing is compared
MIN_SPEED = 0.15  # m/s rms, below which position and velocity cannot be compared
_MAX_TURN = 2.0  # rad in a span: beyond, a rotation vector is not the mean rate times time
_UP = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True, eq=False)
class Motion:
    """The streams of motion on one grid: (n, k) by quantity, NaN where there is none."""

    values: Mapping[str, Floats]

    @classmethod
    def of(cls, streams: Mapping[str, Stream]) -> Motion:
        """Of the streams of a log, by quantity."""
        spanning = spanning_streams(list(streams.values()))
        start = min((float(stream.time[0]) for stream in spanning), default=0.0)
        end = max((float(stream.time[-1]) for stream in spanning), default=0.0)
        count = int(min((end - start) * GRID_RATE + 1, MAX_ROWS))
        grid = np.asarray(start + np.arange(count) / GRID_RATE)
        values = {name: resample(streams[name], grid) for name in MOTION if name in streams}
        if (
            "specific_force" in values
            and not SAME_SIZE[0] < usual_force(values["specific_force"]) / GRAVITY < SAME_SIZE[1]
        ):
            del values["specific_force"]  # whatever it is, no axes can be told from it
        return cls(values)

    def has(self, *names: str) -> bool:
        """Whether all of these quantities are there."""
        return set(names) <= self.values.keys()

    @cached_property
    def rate(self) -> Floats:
        """(m, 3) mean body rates."""
        return span_mean(span_mean(self.values["rate"]))

    @cached_property
    def force(self) -> Floats:
        """(m, 3) mean specific force along the axes of its sensor."""
        return span_mean(span_mean(self.values["specific_force"]))

    @cached_property
    def moved(self) -> Floats:
        """(m, 3) mean change of position, per s."""
        return span_mean(change(self.values["position"]))

    @cached_property
    def velocity(self) -> Floats:
        """(m, 3) mean velocity."""
        return span_mean(span_mean(self.values["velocity"]))

    @cached_property
    def acceleration(self) -> Floats | None:
        """(m, 3) acceleration in the axes of the pose, of the velocity, or of the position where there is none."""
        if "velocity" in self.values:
            return span_mean(change(self.values["velocity"]))
        return change(change(self.values["position"])) if "position" in self.values else None

    def turning(self, attitude: Floats) -> Floats:
        """(m, 3) mean rate by which an attitude (n, 4) turns, along its own body axes, rad/s."""
        turned = quaternion.logarithm(quaternion.multiply(quaternion.conjugate(attitude[:-SPAN]), attitude[SPAN:]))
        short = np.linalg.norm(turned, axis=1, keepdims=True) < _MAX_TURN
        return span_mean(np.where(short, turned, np.nan) * (GRID_RATE / SPAN))

    def thrust_direction(self, attitude: Floats, sensor_to_body: Floats) -> Floats:
        """(m, 3) mean specific force in the world of an attitude (n, 4), of gravity's size where no sensor tells.

        sensor_to_body: (3, 3) from the sensor's axes to those of the attitude's body.
        """
        force = self.values.get("specific_force")
        body = (GRAVITY * _UP if force is None else force) @ sensor_to_body.T
        return span_mean(span_mean(quaternion.rotate(attitude, body)))


def change(values: Floats) -> Floats:
    """(n - 5, k) change of values (n, k) over a span, per s."""
    return (values[SPAN:] - values[:-SPAN]) * (GRID_RATE / SPAN)


def span_mean(values: Floats) -> Floats:
    """(n - 5, k) mean of values (n, k) over a span by the trapezium rule; NaN where one of them is."""
    steps = 0.5 * (values[1:] + values[:-1])
    finite = np.asarray(np.isfinite(steps).all(axis=1))
    sums = np.concatenate(
        [np.zeros((1, values.shape[1])), np.cumsum(np.where(finite.reshape(-1, 1), steps, 0.0), axis=0)]
    )
    gaps = np.concatenate([[0], np.cumsum(~finite)])
    mean = (sums[SPAN:] - sums[:-SPAN]) / SPAN
    return np.where((gaps[SPAN:] - gaps[:-SPAN])[:, None] > 0, np.nan, mean)
