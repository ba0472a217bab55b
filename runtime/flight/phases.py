"""The phases of a flight: what each one does, and which one follows it.

`Mission` moves from phase to phase by `next_phase` alone, and all else that depends on the phase reads its policy here.
The table below is the whole flight; docs/flight_rules.md is generated from it.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from enum import Enum


class Phase(Enum):
    """A phase of the flight."""

    GROUND = "ground"
    RAMP = "ramp"
    CLIMB = "climb"
    APPROACH = "approach"
    TRACK = "track"
    BRAKE = "brake"
    RETURN = "return"
    DESCEND = "descend"
    TOUCHDOWN = "touchdown"
    CONTACT = "contact"
    SHUTDOWN = "shutdown"


START = Phase.GROUND


class Handler(Enum):
    """The part of the flight logic that makes a phase's setpoints."""

    WAIT = "none: control has not begun"
    TAKE_OFF = "thrust ramp"
    FLY = "controller, or a fallback"
    SETTLE = "level, thrust going away"
    SHUT_DOWN = "thrust to zero, disarm"


class Path(Enum):
    """The motion that the controller tracks in a phase."""

    NONE = "none"
    TO_HOME = "transfer to take-off height above the place of take-off"
    TO_REFERENCE = "transfer to the start of the reference"
    REFERENCE = "the reference"
    STOP = "the point at which the vehicle can come to rest"
    TO_LOW = "transfer down, to `low` above the ground"
    DOWN = "straight down at touch-down speed, without end"


class Trigger(Enum):
    """A cause of the next phase."""

    TAKE_OFF = "control is taken on the ground"
    TAKE_OVER = "control is taken in the air"
    LIFTED = "it has left the ground"
    DONE = "its motion is over"
    ABORT = "a landing is requested: by an event that lands, or a signal"
    SINK = "an event requires to land straight down"
    CONTACT = "the ground may carry the vehicle"
    CARRIED = "the ground carries the vehicle"
    NOT_CARRIED = "the ground does not carry the vehicle"
    DISARMED = "the autopilot has disarmed"


class Condition(Enum):
    """A condition on which the next phase depends."""

    CUT_SHORT = "the plan ends before its reference"
    ENDING = "a landing was requested"
    TRACKED = "the reference has begun"
    LANDING = "the contact came in a landing"
    OTHERWISE = "otherwise"


Target = Phase | Mapping[Condition, Phase] | None


@dataclass(frozen=True)
class PhasePolicy:
    """A row of the table.

    text: for the documentation.
    handler: of the setpoints.
    path: that the controller tracks.
    on: the next phase by its cause, and by the first condition that holds where there are several. None, and a cause
        that is not listed: the phase goes on.
    hovers: whether the plan's time to settle is added to the path's.
    falls_back: whether fallbacks replace its setpoints. Without thrust on the ground nothing is safer than to disarm.
    lands: whether the ground is expected: it may carry a part of the vehicle, and a contact is no crash.
    leaves_ground: whether the vehicle has left the ground in it or before, so that the external force is measured.
    grace: s from its start in which force and motion are not judged for a crash; 0: none.
    tilt_rate: limit of roll and pitch rates, rad/s.
    """

    text: str
    handler: Handler
    path: Path
    on: Mapping[Trigger, Target]
    hovers: bool = False
    falls_back: bool = True
    lands: bool = False
    leaves_ground: bool = True
    grace: float = 0.0
    tilt_rate: float = math.inf

    @property
    def airborne(self) -> bool:
        """Whether the controller flies the vehicle, as opposed to ramps on the ground."""
        return self.handler is Handler.FLY

    @property
    def may_disarm(self) -> bool:
        """Whether the autopilot may disarm in it: the vehicle may stand on the ground."""
        return Trigger.DISARMED in self.on


LIFT_OFF_TIME = 1.0  # s of a climb: lift-off itself is an external force
TOUCHDOWN_RATE = 0.4  # rad/s of tilting: what a soft contact lets it tilt until it is noticed

# control may be taken again after a flight, whatever phase it ended in
_TAKES_CONTROL: Mapping[Trigger, Target] = {Trigger.TAKE_OFF: Phase.RAMP, Trigger.TAKE_OVER: Phase.BRAKE}
_FLIES: Mapping[Trigger, Target] = {
    **_TAKES_CONTROL,
    Trigger.ABORT: Phase.BRAKE,
    Trigger.SINK: Phase.TOUCHDOWN,
    Trigger.CONTACT: Phase.CONTACT,
}
_LANDS: Mapping[Trigger, Target] = {**_FLIES, Trigger.ABORT: None}
_ON_GROUND: Mapping[Trigger, Target] = {
    **_TAKES_CONTROL,
    Trigger.ABORT: None,
    Trigger.SINK: None,
    Trigger.DISARMED: Phase.SHUTDOWN,
}

PHASES: Mapping[Phase, PhasePolicy] = {
    Phase.GROUND: PhasePolicy(
        "stands before control is taken",
        Handler.WAIT,
        Path.NONE,
        {**_TAKES_CONTROL, Trigger.ABORT: Phase.SHUTDOWN},
        leaves_ground=False,
    ),
    Phase.RAMP: PhasePolicy(
        "raises thrust until the vehicle leaves the ground",
        Handler.TAKE_OFF,
        Path.NONE,
        {**_TAKES_CONTROL, Trigger.LIFTED: Phase.CLIMB, Trigger.ABORT: Phase.SHUTDOWN},
        leaves_ground=False,
    ),
    Phase.CLIMB: PhasePolicy(
        "climbs to the height of take-off",
        Handler.FLY,
        Path.TO_HOME,
        {**_FLIES, Trigger.DONE: Phase.APPROACH},
        grace=LIFT_OFF_TIME,
    ),
    Phase.APPROACH: PhasePolicy(
        "flies to the start of the reference",
        Handler.FLY,
        Path.TO_REFERENCE,
        {**_FLIES, Trigger.DONE: Phase.TRACK},
        hovers=True,
    ),
    Phase.TRACK: PhasePolicy(
        "flies the reference",
        Handler.FLY,
        Path.REFERENCE,
        {**_FLIES, Trigger.DONE: {Condition.CUT_SHORT: Phase.BRAKE, Condition.OTHERWISE: Phase.RETURN}},
    ),
    Phase.BRAKE: PhasePolicy(
        "comes to rest",
        Handler.FLY,
        Path.STOP,
        {
            **_FLIES,
            Trigger.DONE: {
                Condition.ENDING: Phase.DESCEND,
                Condition.TRACKED: Phase.RETURN,
                Condition.OTHERWISE: Phase.APPROACH,
            },
        },
    ),
    Phase.RETURN: PhasePolicy(
        "flies back above the place of take-off",
        Handler.FLY,
        Path.TO_HOME,
        {**_FLIES, Trigger.DONE: Phase.DESCEND},
        hovers=True,
    ),
    Phase.DESCEND: PhasePolicy(
        "descends to just above the ground",
        Handler.FLY,
        Path.TO_LOW,
        {**_LANDS, Trigger.DONE: Phase.TOUCHDOWN},
        lands=True,
        grace=math.inf,
    ),
    Phase.TOUCHDOWN: PhasePolicy(
        "sinks until the ground carries the vehicle",
        Handler.FLY,
        Path.DOWN,
        {**_LANDS, Trigger.SINK: None, Trigger.DISARMED: Phase.SHUTDOWN},
        lands=True,
        grace=math.inf,
        tilt_rate=TOUCHDOWN_RATE,
    ),
    Phase.CONTACT: PhasePolicy(
        "takes thrust away level, until the ground is known to carry the vehicle or not to be there",
        Handler.SETTLE,
        Path.NONE,
        {
            **_ON_GROUND,
            Trigger.CARRIED: Phase.SHUTDOWN,
            Trigger.NOT_CARRIED: {Condition.LANDING: Phase.TOUCHDOWN, Condition.OTHERWISE: Phase.BRAKE},
        },
        falls_back=False,
    ),
    Phase.SHUTDOWN: PhasePolicy(
        "ends thrust and disarms",
        Handler.SHUT_DOWN,
        Path.NONE,
        _ON_GROUND,
        falls_back=False,
    ),
}


def next_phase(phase: Phase, trigger: Trigger, holding: Collection[Condition] = ()) -> Phase | None:
    """The phase that follows; None: the present one goes on. holding: conditions that hold now."""
    target = PHASES[phase].on.get(trigger)
    if target is None or isinstance(target, Phase):
        return target
    return next(after for condition, after in target.items() if condition in {*holding, Condition.OTHERWISE})
