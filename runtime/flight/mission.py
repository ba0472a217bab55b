"""The course of a flight: its present phase, by the table of `phases`, and the motion of each. Pure."""

from __future__ import annotations

import json
import math
from typing import Literal

import msgspec
import numpy as np

from dynamics import quaternion
from dynamics.arrays import Floats
from dynamics.references.curve import REST_TO_REST_ACCELERATION, REST_TO_REST_SPEED
from dynamics.state import ATTITUDE, POSITION, RATE, VELOCITY
from dynamics.vehicle import Vehicle
from runtime.flight.motion import Descent, Motion, Moved, Transfer
from runtime.flight.phases import PHASES, START, Condition, Path, Phase, PhasePolicy, Trigger, next_phase

STILL = 0.3  # m/s below which braking is over
MAX_BRAKE = 4.0  # s of braking, however fast the vehicle still is
MAX_DRIFT = 0.1  # m sideways by which a vehicle that sinks may be off its reference
MAX_LEAD = 0.3  # m by which the reference of a touch-down may be ahead of the estimate
Origin = Literal["takeoff", "estimate"]


class Plan(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Plan of a flight around the reference: take-off, transfers, hover, landing.

    height: of take-off, m.
    duration: of the reference, s; None: its own.
    speed: of transfers, m/s.
    acceleration: of transfers, m/s^2.
    yaw_rate: of transfers, rad/s.
    settle: s of hover before and after the reference.
    descent: m/s, of landing.
    touchdown: m/s, of landing below the height `low`.
    low: height above the ground at which the touch-down begins, m.
    origin: of the reference's coordinates: the place of take-off, or the estimator's own. A vehicle that is taken over
        in the air flies in the estimator's. Recordings without the key were flown in the estimator's.
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
    origin: Origin = "estimate"


class Mission:
    """The flight's phase and the motion that the controller tracks. Times are the daemon's, s.

    landing_reason: why the flight was cut short, empty when it was not.
    origin: of the reference's coordinates, (3,) m in the estimator's.
    """

    def __init__(self, vehicle: Vehicle, reference: Motion, plan: Plan) -> None:
        self._phase = self._phase_before = START
        self.landing_reason = ""
        self.origin = np.zeros(3)
        self._vehicle = vehicle
        self._reference = self._planned = reference
        self._plan = plan
        self._motion: Motion | None = None
        self._started = 0.0
        self._tracked = False
        # an estimator that moves its frame moves this offset; everything else stays in the frame of take-off
        self._offset = np.zeros(3)
        self._yaw_offset = 0.0
        self._home = np.zeros(4)
        self._ground: float | None = None

    @property
    def phase(self) -> Phase:
        """The present phase."""
        return self._phase

    @property
    def policy(self) -> PhasePolicy:
        """The present phase's row of the table."""
        return PHASES[self._phase]

    @property
    def airborne(self) -> bool:
        """Whether the controller flies the vehicle, as opposed to ramps on the ground."""
        return self.policy.airborne

    @property
    def phase_started(self) -> float:
        """When the present phase started, s."""
        return self._started

    def ramp(self, state: Floats, time: float) -> None:
        """Start the take-off. state: (13,), standing on the ground."""
        self._begin()
        here = self._takeoff_frame_pose(state)
        self._ground = float(here[2])
        if self._plan.origin == "takeoff":
            self.origin = here[POSITION].copy()
        self._home, self._reference = self._home_of(here), self._reference_from(here)
        self._move(Trigger.TAKE_OFF, state, time)

    def _begin(self) -> None:
        """Forget an earlier flight: how it ended, and where its reference was."""
        self.landing_reason, self._tracked = "", False
        self._reference, self.origin, self._ground = self._planned, np.zeros(3), None

    def climb(self, state: Floats, time: float) -> None:
        """Climb to the take-off height above the place of take-off, once the vehicle has lifted off."""
        self._move(Trigger.LIFTED, state, time)

    def take_over(self, state: Floats, time: float) -> None:
        """Start in the air: brake, then fly on. state: (13,)."""
        self._begin()
        self._home = self._takeoff_frame_pose(state)
        self._move(Trigger.TAKE_OVER, state, time)

    def land(self, reason: str, state: Floats, time: float) -> None:
        """Cut the flight short: brake and descend where the vehicle is. A second call does nothing."""
        if self.landing_reason:
            return
        self.landing_reason = reason
        self._move(Trigger.ABORT, state, time)

    def sink(self, state: Floats, time: float) -> None:
        """Descend at touch-down speed, without braking first; at every call the reference stays over the vehicle.

        A controller that has to go elsewhere would give the thrust for it as well. state: (13,).
        """
        if self.policy.path is Path.DOWN:
            here, target = self._takeoff_frame_pose(state), self._target(time)
            if float(np.linalg.norm(target[:2] - here[:2])) > MAX_DRIFT:
                here[2:] = target[2:]
                self._follow(self._descent(here), time)
        self._move(Trigger.SINK, state, time)

    def height(self, state: Floats) -> float | None:
        """Estimated height over the place of take-off, m; None where it is not known. state: (13,)."""
        return None if self._ground is None else float(self._takeoff_frame_pose(state)[2]) - self._ground

    @property
    def ground(self) -> float:
        """Height of the place of take-off in the estimator's frame, m; -infinite where it is not known."""
        return -math.inf if self._ground is None else self._ground + float(self._offset[2])

    def planned(self, state: Floats, *, standing: bool) -> tuple[float, tuple[tuple[Motion, float], ...]]:
        """The height of the ground, m, and the motions of a flight that would begin here, each with its time, s.

        state: (13,). standing: on the ground, which is not known otherwise: its height is -infinite. Motions are in the
        frame of take-off: the transfer to the reference's start, and the reference.
        """
        home, reference, ground = self._takeoff_frame_pose(state), self._planned, -math.inf
        if standing:
            ground = float(home[2]) + float(self._offset[2])
            home, reference = self._home_of(home), self._reference_from(home)
        approach = self._transfer(home, _pose(reference.states(np.zeros(1))[0]))
        duration = min(self._plan.duration or math.inf, reference.duration)
        return ground, ((approach, approach.duration), (reference, duration))

    def _home_of(self, here: Floats) -> Floats:
        """The pose (4,) to which the vehicle climbs from a pose (4,) on the ground."""
        return np.asarray(here + np.array([0.0, 0.0, self._plan.height, 0.0]))

    def _reference_from(self, here: Floats) -> Motion:
        """The reference of a flight that begins on the ground at a pose (4,)."""
        return Moved(self._planned, here[POSITION].copy()) if self._plan.origin == "takeoff" else self._planned

    def settle(self, state: Floats, time: float) -> None:
        """Take thrust away level, after a contact. state: (13,)."""
        self._move(Trigger.CONTACT, state, time)

    def catch(self, state: Floats, time: float) -> None:
        """Fly on after a false contact: descend from here, or brake first where the flight was cut short."""
        self._move(Trigger.NOT_CARRIED, state, time)

    def shut_down(self, state: Floats, time: float) -> None:
        """Ramp the thrust to zero and disarm, once the vehicle stands on the ground. state: (13,)."""
        self._move(Trigger.CARRIED, state, time)

    def disarmed(self, time: float) -> None:
        """End the flight: the autopilot noticed the landing first and disarmed by itself."""
        self._move(Trigger.DISARMED, None, time)

    def shift(self, position: Floats, yaw: float) -> None:
        """Move the reference by an estimator's reset: position (3,) m, yaw rad. The vehicle keeps its motion."""
        self._offset = self._offset + position
        self._yaw_offset += yaw

    def update(self, state: Floats, time: float) -> None:
        """Enter the next phase when the present motion is over. state: (13,)."""
        if self.policy.path is Path.DOWN:
            self._limit_lead(state, time)
        if self._motion is not None and time - self._started >= self._length(state):
            self._move(Trigger.DONE, state, time)

    def window(self, times: Floats, near: Floats) -> tuple[Floats, Floats]:
        """States (n, 13) and rotor speeds (n, rotors) to track.

        times: (n,) s. near: attitude (4,) whose sign the attitudes take.
        """
        if self._motion is None:
            raise ValueError(f"the phase {self.phase.value} has no reference")
        since = times - self._started
        states, inputs = self._motion.states(since), self._motion.inputs(since)
        states[:, POSITION] += self._offset
        if self._yaw_offset:
            rotation = quaternion.from_euler(0.0, 0.0, self._yaw_offset)
            states[:, ATTITUDE] = quaternion.multiply(states[:, ATTITUDE], rotation)
            states[:, RATE] = quaternion.rotate_inverse(rotation, states[:, RATE])
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
        """Duration of the present phase, s, including the hover at its end."""
        duration = self._motion.duration if self._motion else math.inf
        if self.policy.path is Path.REFERENCE and self._cut_short and self._plan.duration:
            return self._plan.duration
        if self.policy.path is Path.STOP and float(np.linalg.norm(state[VELOCITY])) > STILL:
            return duration + MAX_BRAKE
        return duration + self._plan.settle if self.policy.hovers else duration

    def _move(self, trigger: Trigger, state: Floats | None, time: float) -> None:
        """Enter the phase that the table has after the present one, if it has one: the only way into a phase.

        state: (13,), None where the next phase tracks nothing.
        """
        after = next_phase(self._phase, trigger, self._conditions)
        if after is None:
            return
        # a motion that is over leads to where the next one starts; what interrupts one starts at the vehicle
        start = self._target(time) if trigger is Trigger.DONE else None
        self._phase_before, self._phase = self._phase, after
        self._tracked |= self.policy.path is Path.REFERENCE
        self._follow(None if state is None else self._path(state, start), time)

    @property
    def _conditions(self) -> list[Condition]:
        facts = {
            Condition.CUT_SHORT: self._cut_short,
            Condition.ENDING: bool(self.landing_reason),
            Condition.TRACKED: self._tracked,
            Condition.LANDING: PHASES[self._phase_before].lands,
        }
        return [condition for condition, holds in facts.items() if holds]

    def _follow(self, motion: Motion | None, time: float) -> None:
        self._motion, self._started = motion, time

    def _path(self, state: Floats, start: Floats | None) -> Motion | None:
        """The present phase's motion. state: (13,). start: pose (4,) in the frame of take-off, None: the vehicle's."""
        start = self._takeoff_frame_pose(state) if start is None else start
        match self.policy.path:
            case Path.NONE:
                return None
            case Path.TO_HOME:
                return self._transfer(start, self._home)
            case Path.TO_REFERENCE:
                return self._transfer(start, _pose(self._reference.states(np.zeros(1))[0]))
            case Path.REFERENCE:
                return self._reference
            case Path.STOP:
                return self._stop(state)
            case Path.TO_LOW:
                low = start.copy()
                if self._ground is not None:
                    low[2] = min(low[2], self._ground + self._plan.low)
                return self._transfer(start, low, speed=self._plan.descent)
            case Path.DOWN:
                return self._descent(start)

    def _descent(self, here: Floats) -> Motion:
        return Descent(self._vehicle, here, self._plan.touchdown)

    def _limit_lead(self, state: Floats, time: float) -> None:
        """Start a touch-down again near the estimate, when its height has moved by more than a descent can."""
        here, measured = self._target(time), self._takeoff_frame_pose(state)
        if abs(here[2] - measured[2]) > MAX_LEAD:
            here[2] = measured[2] + math.copysign(MAX_LEAD, here[2] - measured[2])
            self._follow(self._descent(here), time)

    def _stop(self, state: Floats) -> Motion:
        """Hold the point at which the vehicle can come to rest."""
        point = self._takeoff_frame_pose(state)
        point[:3] += state[VELOCITY] * float(np.linalg.norm(state[VELOCITY])) / (2 * self._plan.acceleration)
        if self._ground is not None:
            point[2] = max(point[2], self._ground + self._plan.low)
        return Transfer(self._vehicle, point, point, 1.0)

    def _transfer(self, start: Floats, end: Floats, speed: float = 0.0) -> Motion:
        end = end.copy()
        end[3] = start[3] + math.remainder(end[3] - start[3], math.tau)
        distance, angle = float(np.linalg.norm(end[:3] - start[:3])), abs(end[3] - start[3])
        duration = max(
            1.0,
            REST_TO_REST_SPEED * distance / (speed or self._plan.speed),
            math.sqrt(REST_TO_REST_ACCELERATION * distance / self._plan.acceleration),
            REST_TO_REST_SPEED * angle / self._plan.yaw_rate,
        )
        return Transfer(self._vehicle, start, end, duration)

    def _target(self, time: float) -> Floats:
        """The present motion's pose (4,) in the frame of take-off, where the next motion starts."""
        if self._motion is None:
            raise ValueError(f"the phase {self.phase.value} has no reference")
        return _pose(self._motion.states(np.array([time - self._started]))[0])

    def _takeoff_frame_pose(self, state: Floats) -> Floats:
        """The pose (4,) of a measured state in the frame of take-off."""
        return np.asarray(_pose(state) - np.append(self._offset, self._yaw_offset))


def _pose(state: Floats) -> Floats:
    """Position and yaw, (4,), of a state (13,); yaw as in the references, applied before the tilt."""
    w, _, _, z = state[ATTITUDE]
    return np.append(state[POSITION], 2 * math.atan2(z, w))
