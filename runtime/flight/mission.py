"""The phases of a flight, from the ground through a reference and back to it, and the reference of each. Pure.

Every motion offers what a Reference of `dynamics.references` offers, states (n, 13) and rotor speeds (n, rotors) at
any times, so that the controller's window is read the same way in every phase.
"""

from __future__ import annotations

import json
import math
from enum import Enum
from typing import Protocol

import msgspec
import numpy as np

from dynamics import quaternion
from dynamics.arrays import Floats
from dynamics.references.curve import REST_TO_REST_ACCELERATION, REST_TO_REST_SPEED, rest_to_rest
from dynamics.references.flatness import flat_motion
from dynamics.state import ATTITUDE, POSITION, RATE, RIGID_BODY_STATES, VELOCITY
from dynamics.vehicle import Vehicle


class Phase(Enum):
    """What the flight is about at the moment."""

    GROUND = "ground"
    RAMP = "ramp"
    CLIMB = "climb"
    APPROACH = "approach"
    TRACK = "track"
    BRAKE = "brake"
    RETURN = "return"
    DESCEND = "descend"
    TOUCHDOWN = "touchdown"
    SHUTDOWN = "shutdown"


STILL = 0.3  # m/s
MAX_BRAKE = 4.0  # s
AIRBORNE = frozenset(set(Phase) - {Phase.GROUND, Phase.RAMP, Phase.SHUTDOWN})


class Motion(Protocol):
    """A motion in time since its start, s."""

    @property
    def duration(self) -> float:
        """Time until it rests, s; infinite if it never does."""
        ...

    def states(self, times: Floats) -> Floats:
        """(n, 13) position and velocity (world), attitude, body rates."""
        ...

    def inputs(self, times: Floats) -> Floats:
        """(n, rotors) rotor speeds, rad/s."""
        ...


class Transfer:
    """From rest to rest between two points, straight, with yaw turned along the way; tabulated on creation."""

    def __init__(self, vehicle: Vehicle, start: Floats, end: Floats, duration: float) -> None:
        """start, end: (4,) x, y, z in m and yaw in rad. duration: s."""
        self.start, self.end, self.duration = start, end, duration
        # linear interpolation over 20 ms errs by 0.1 mm at 2 m/s^2; building 500 rows costs less than a millisecond
        rows = int(min(max(duration / 0.02, 1.0), 500.0)) + 1
        times = np.linspace(0.0, duration, rows)
        flat = rest_to_rest(np.array([start, end]), np.array([duration])).derivatives(times)
        motion = flat_motion(times, flat, vehicle)
        self._states = np.hstack([motion.position, motion.velocity, motion.attitude, motion.rate_body])
        self._inputs = motion.rotor_speed

    def states(self, times: Floats) -> Floats:
        """(n, 13) position and velocity (world), attitude, body rates."""
        result = self._read(self._states, times)
        result[:, ATTITUDE] /= np.sqrt(np.sum(result[:, ATTITUDE] ** 2, axis=1))[:, None]
        return result

    def inputs(self, times: Floats) -> Floats:
        """(n, rotors) rotor speeds, rad/s."""
        return self._read(self._inputs, times)

    def _read(self, table: Floats, times: Floats) -> Floats:
        place = np.clip(times * ((len(table) - 1) / self.duration), 0.0, len(table) - 1.000001)
        row = place.astype(np.intp)
        return np.asarray(table[row] + (place - row)[:, None] * (table[row + 1] - table[row]))


class Descent:
    """Straight down at a constant speed, for ever: whoever flies it looks out for the ground."""

    duration = math.inf

    def __init__(self, vehicle: Vehicle, start: Floats, speed: float) -> None:
        """start: (4,) x, y, z in m and yaw in rad. speed: m/s."""
        self._speed = speed
        self._hover_speed = vehicle.hover_speed
        self._rotors = vehicle.rotors.count
        self.start = start
        self._attitude = quaternion.from_euler(0.0, 0.0, start[3])

    def states(self, times: Floats) -> Floats:
        """(n, 13) position and velocity (world), attitude, body rates."""
        result = np.zeros((times.size, RIGID_BODY_STATES))
        result[:, POSITION] = self.start[:3]
        result[:, POSITION][:, 2] -= self._speed * np.maximum(times, 0.0)
        result[:, VELOCITY][:, 2] = -self._speed
        result[:, ATTITUDE] = self._attitude
        return result

    def inputs(self, times: Floats) -> Floats:
        """(n, rotors) rotor speeds, rad/s."""
        return np.full((times.size, self._rotors), self._hover_speed)


class Plan(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """What to fly besides the reference. height: m of take-off. duration: s of the reference, None: all of it.

    speed, acceleration: of transfers, m/s and m/s^2. settle: s of hover before the reference. descent, touchdown:
    speeds of landing, m/s, the second from `low` m above the ground on.
    """

    height: float = 1.5
    duration: float | None = None
    speed: float = 1.5
    acceleration: float = 2.0
    yaw_rate: float = 1.0
    settle: float = 1.0
    descent: float = 0.7
    touchdown: float = 0.3
    low: float = 0.3


class Mission:
    """Which phase the flight is in and what the controller is to follow. Times are the daemon's, s."""

    def __init__(self, vehicle: Vehicle, reference: Motion, plan: Plan) -> None:
        self.phase = Phase.GROUND
        self.landing_reason = ""
        self._vehicle = vehicle
        self._reference = reference
        self._plan = plan
        self._motion: Motion | None = None
        self._started = 0.0
        self._tracked = False
        # an estimator that moves its frame moves this offset; everything else here stays in the frame of take-off
        self._offset = np.zeros(3)
        self._yaw_offset = 0.0
        self._home = np.zeros(4)
        self._ground: float | None = None

    @property
    def airborne(self) -> bool:
        """Whether the controller flies the vehicle, as opposed to ramps on the ground."""
        return self.phase in AIRBORNE

    @property
    def time_in_phase_began(self) -> float:
        """When the present phase began, s."""
        return self._started

    def ramp(self, state: Floats, time: float) -> None:
        """Begin the take-off. state: (13,), standing on the ground."""
        self._home = self._pose(state)
        self._ground = float(self._home[2])
        self._home[2] += self._plan.height
        self._enter(Phase.RAMP, None, time)

    def climb(self, state: Floats, time: float) -> None:
        """The vehicle left the ground: climb to the take-off height above where it stood."""
        self._go(Phase.CLIMB, self._pose(state), self._home, time)

    def take_over(self, state: Floats, time: float) -> None:
        """Begin in the air: brake, then fly on. state: (13,)."""
        self._home = self._pose(state)
        self._brake(state, time)

    def land(self, reason: str, state: Floats, time: float) -> None:
        """Cut the flight short: brake and come down where the vehicle is. Does nothing twice or on the ground."""
        if self.landing_reason:
            return
        self.landing_reason = reason
        if self.phase in (Phase.GROUND, Phase.RAMP):
            self._enter(Phase.SHUTDOWN, None, time)
        elif self.phase not in (Phase.DESCEND, Phase.TOUCHDOWN, Phase.SHUTDOWN):
            self._brake(state, time)

    def shut_down(self, time: float) -> None:
        """The vehicle stands on the ground: take the thrust away and disarm."""
        self._enter(Phase.SHUTDOWN, None, time)

    def shift(self, position: Floats, yaw: float) -> None:
        """Follow an estimator that moved its frame: position (3,) m, yaw rad. The vehicle feels nothing."""
        self._offset = self._offset + position
        self._yaw_offset += yaw

    def update(self, state: Floats, time: float) -> None:
        """Move on when the present motion is over. state: (13,)."""
        if self._motion is None or time - self._started < self._length(state):
            return
        here = self._target(time)
        match self.phase:
            case Phase.CLIMB:
                self._approach(here, time)
            case Phase.APPROACH:
                self._tracked = True
                self._enter(Phase.TRACK, self._reference, time)
            case Phase.TRACK if self._cut_short:
                self._brake(state, time)
            case Phase.TRACK:
                self._return(here, time)
            case Phase.RETURN:
                self._descend(here, time)
            case Phase.BRAKE if self.landing_reason:
                self._descend(here, time)
            case Phase.BRAKE if self._tracked:
                self._return(here, time)
            case Phase.BRAKE:
                self._approach(here, time)
            case Phase.DESCEND:
                self._enter(Phase.TOUCHDOWN, Descent(self._vehicle, here, self._plan.touchdown), time)
            case _:
                pass

    def window(self, times: Floats, near: Floats) -> tuple[Floats, Floats]:
        """States (n, 13) and rotor speeds (n, rotors) to follow at times (n,) s, signs nearest to near (4,)."""
        if self._motion is None:
            raise ValueError(f"the phase {self.phase.value} has no reference")
        since = times - self._started
        states, inputs = self._motion.states(since), self._motion.inputs(since)
        states[:, POSITION] += self._offset
        if self._yaw_offset:
            turn = quaternion.from_euler(0.0, 0.0, self._yaw_offset)
            states[:, ATTITUDE] = quaternion.multiply(states[:, ATTITUDE], turn)
            states[:, RATE] = quaternion.rotate_inverse(turn, states[:, RATE])
        states[:, ATTITUDE] *= np.where(states[:, ATTITUDE] @ near < 0, -1.0, 1.0)[:, None]
        return states, inputs

    def describe(self) -> str:
        """The present motion's parameters as JSON text, for the recording."""
        fields = {name: getattr(self._motion, name, None) for name in ("name", "start", "end", "duration")}
        plain = {name: value.tolist() if isinstance(value, np.ndarray) else value for name, value in fields.items()}
        return json.dumps({name: value for name, value in plain.items() if value not in (None, math.inf)})

    @property
    def _cut_short(self) -> bool:
        return self._plan.duration is not None and self._plan.duration < self._reference.duration

    def _length(self, state: Floats) -> float:
        """How long the present phase lasts, s, hovering at its end included."""
        duration = self._motion.duration if self._motion else math.inf
        if self.phase is Phase.TRACK:
            return self._plan.duration if self._cut_short and self._plan.duration else duration
        if self.phase in (Phase.APPROACH, Phase.RETURN):
            return duration + self._plan.settle
        if self.phase is Phase.BRAKE and float(np.linalg.norm(state[VELOCITY])) > STILL:
            return duration + MAX_BRAKE
        return duration

    def _approach(self, here: Floats, time: float) -> None:
        self._go(Phase.APPROACH, here, _pose(self._reference.states(np.zeros(1))[0]), time)

    def _return(self, here: Floats, time: float) -> None:
        self._go(Phase.RETURN, here, self._home, time)

    def _descend(self, here: Floats, time: float) -> None:
        low = here.copy()
        if self._ground is not None:
            low[2] = min(low[2], self._ground + self._plan.low)
        self._go(Phase.DESCEND, here, low, time, speed=self._plan.descent)

    def _brake(self, state: Floats, time: float) -> None:
        """Hold the point where the vehicle can come to rest."""
        point = self._pose(state)
        point[:3] += state[VELOCITY] * float(np.linalg.norm(state[VELOCITY])) / (2 * self._plan.acceleration)
        if self._ground is not None:
            point[2] = max(point[2], self._ground + self._plan.low)
        self._enter(Phase.BRAKE, Transfer(self._vehicle, point, point, 1.0), time)

    def _go(self, phase: Phase, start: Floats, end: Floats, time: float, speed: float = 0.0) -> None:
        end = end.copy()
        end[3] = start[3] + math.remainder(end[3] - start[3], math.tau)
        distance, turn = float(np.linalg.norm(end[:3] - start[:3])), abs(end[3] - start[3])
        duration = max(
            1.0,
            REST_TO_REST_SPEED * distance / (speed or self._plan.speed),
            math.sqrt(REST_TO_REST_ACCELERATION * distance / self._plan.acceleration),
            REST_TO_REST_SPEED * turn / self._plan.yaw_rate,
        )
        self._enter(phase, Transfer(self._vehicle, start, end, duration), time)

    def _enter(self, phase: Phase, motion: Motion | None, time: float) -> None:
        self.phase, self._motion, self._started = phase, motion, time

    def _target(self, time: float) -> Floats:
        """The pose (4,) that the present motion asks for, in the frame of take-off: what follows begins there."""
        if self._motion is None:
            raise ValueError(f"the phase {self.phase.value} has no reference")
        return _pose(self._motion.states(np.array([time - self._started]))[0])

    def _pose(self, state: Floats) -> Floats:
        """The pose (4,) of a measured state in the frame of take-off."""
        return np.asarray(_pose(state) - np.append(self._offset, self._yaw_offset))


def _pose(state: Floats) -> Floats:
    """Position and yaw, (4,), of a state (13,); yaw as the reference means it, turned before the tilt."""
    w, _, _, z = state[ATTITUDE]
    return np.append(state[POSITION], 2 * math.atan2(z, w))
