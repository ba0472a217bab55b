"""The records of a recording: one plain struct for each topic, and its JSON schema for Foxglove and PlotJuggler.

Times are seconds of the daemon's monotonic clock; the recorder stamps every message with the matching unix time.
World ENU, body FLU, attitude body to world, w first, as everywhere.
"""

from __future__ import annotations

from collections.abc import Mapping
from math import nan
from typing import Annotated, Any

import msgspec
import numpy as np
from msgspec import Meta

from dynamics.arrays import Floats

Seconds = Annotated[float, Meta(description="s")]
Metres = Annotated[Floats, Meta(description="m, world ENU")]
Velocity = Annotated[Floats, Meta(description="m/s, world ENU")]
Attitude = Annotated[Floats, Meta(description="body FLU to world ENU, w x y z")]
Rate = Annotated[Floats, Meta(description="rad/s, body FLU")]
Force = Annotated[float, Meta(description="N")]


class EstimateRecord(msgspec.Struct, frozen=True):
    """A state estimate of the vehicle, in our frames. time: when it held. arrival: when it was received."""

    time: Seconds
    arrival: Seconds
    position_world: Metres
    velocity_world: Velocity
    attitude: Attitude
    rate_body: Rate
    reset_counter: int


class ReferenceRecord(msgspec.Struct, frozen=True):
    """The reference's state at an estimate's time."""

    time: Seconds
    position_world: Metres
    velocity_world: Velocity
    attitude: Attitude
    rate_body: Rate


class SetpointRecord(msgspec.Struct, frozen=True):
    """A setpoint as it was sent, with the collective thrust that it stands for and the effectiveness that scaled it."""

    time: Seconds
    rate_body: Rate
    collective_thrust: Force
    thrust: Annotated[float, Meta(description="0..1 of SET_ATTITUDE_TARGET")]
    effectiveness: Annotated[float, Meta(description="thrust per modelled thrust, 1")]


class TickRecord(msgspec.Struct, frozen=True):
    """A tick of the control thread: trigger, estimate, state, solver and durations."""

    tick: int
    time: Seconds
    trigger: str
    estimate_time: Seconds
    estimate_age: Seconds
    state: str
    phase: str
    fallback: str
    solver_status: int
    feedback_seconds: Seconds
    preparation_seconds: Seconds
    departure_seconds: Annotated[float, Meta(description="s from the tick's trigger to the setpoint's departure")]
    late_cause: str
    model_ratio: Annotated[float, Meta(description="a learned model's error over its error in training, else NaN")] = (
        nan
    )
    model_uncertainty: Annotated[
        float, Meta(description="disagreement of a learned model's members over the limit from training, else NaN")
    ] = nan
    network_share: Annotated[float, Meta(description="share of a network's output that is flown, else NaN")] = nan


class ObservationRecord(msgspec.Struct, frozen=True):
    """All inputs of a tick besides the estimate; with both, a flight can be replayed.

    estimate_arrival: identifies the estimate, NaN before the first.
    connected: whether the vehicle is heard.
    armed, offboard, mode: of the last HEARTBEAT, the mode also of CURRENT_MODE.
    landed: the vehicle's landed state.
    findings: events with their details as a JSON object, empty when there are none.
    reset: whether an estimator was reset, which moved its frame by reset_position and reset_yaw.
    specific_force_z: the newest, NaN when there is no new one.
    specific_force_xy: of the same sample; NaN in recordings of older versions.
    rotor_time: of the newest rotor speeds, NaN when there are no new ones.
    rotor_speed: these, in the vehicle file's order; empty when there are no new ones.
    rotors_measured: whether ESCs measured them, and not the autopilot's outputs command them.
    battery_voltage: the newest, NaN when there is no new one.
    engage: whether engaging is requested at this tick.
    leave: why landing is requested, empty when it is not.
    stop: whether the stream is to end at once; in recordings of older versions it did without a last setpoint.
    answered: whether the setpoint had left, by `alula_tick`, before this was observed: it acts from the next tick on.
    """

    tick: int
    time: Seconds
    estimate_arrival: Seconds
    connected: bool
    armed: bool
    offboard: bool
    mode: str
    landed: bool
    findings: str
    reset: bool
    reset_position: Metres
    reset_yaw: Annotated[float, Meta(description="rad")]
    specific_force_z: Annotated[float, Meta(description="m/s^2, body z, NaN when there is no new one")]
    engage: bool
    leave: str
    specific_force_xy: Annotated[Floats, Meta(description="m/s^2, body x y, NaN when there is no new one")] = (
        msgspec.field(default_factory=lambda: np.full(2, nan))
    )
    rotor_time: Seconds = nan
    rotor_speed: Annotated[Floats, Meta(description="rad/s")] = msgspec.field(default_factory=lambda: np.zeros(0))
    rotors_measured: bool = False
    battery_voltage: Annotated[float, Meta(description="V, NaN when there is no new one")] = nan
    stop: bool = False
    answered: bool = False


class HorizonRecord(msgspec.Struct, frozen=True):
    """The controller's predicted positions and inputs, one value for each shooting node."""

    time: Seconds
    position_x: Metres
    position_y: Metres
    position_z: Metres
    input_mean: Annotated[Floats, Meta(description="mean rotor speed, rad/s")]


class FollowedRecord(msgspec.Struct, frozen=True):
    """Followed parameters in flight. names: of the parameters, one word each."""

    time: Seconds
    staying: Annotated[Floats, Meta(description="m/s^2 world ENU, rad/s^2 body FLU: the disturbance's lasting part")]
    fading: Annotated[Floats, Meta(description="m/s^2 world ENU, rad/s^2 body FLU: the part that fades")]
    trust: Annotated[Floats, Meta(description="share that is flown, linear and angular")]
    names: str
    value: Annotated[Floats, Meta(description="of the parameters, SI")]
    deviation: Annotated[Floats, Meta(description="standard deviations of the parameters, SI")]
    disturbance_deviation: Annotated[Floats, Meta(description="standard deviations of the sum of both parts")] = (
        msgspec.field(default_factory=lambda: np.full(6, nan))
    )
    effectiveness: Annotated[float, Meta(description="thrust per modelled thrust, 1")] = nan
    effectiveness_deviation: Annotated[float, Meta(description="its standard deviation, 1")] = nan
    network_trust: Annotated[float, Meta(description="share of the last layer's change that is flown, else NaN")] = nan
    network_change: Annotated[Floats, Meta(description="m/s^2, its RMS over the training's inputs, by axis")] = (
        msgspec.field(default_factory=lambda: np.full(3, nan))
    )
    network_errors: Annotated[Floats, Meta(description="m/s^2, of forecasts with the change and without")] = (
        msgspec.field(default_factory=lambda: np.full(2, nan))
    )


class PhaseRecord(msgspec.Struct, frozen=True):
    """A change of the mission's phase. parameters: of its motion, as JSON text."""

    time: Seconds
    phase: str
    parameters: str


class EventRecord(msgspec.Struct, frozen=True):
    """A named event raised or cleared."""

    time: Seconds
    name: str
    active: bool
    severity: int
    text: str


class StateRecord(msgspec.Struct, frozen=True):
    """A change of the daemon's state, with its reason."""

    time: Seconds
    before: str
    after: str
    reason: str


class ImuRecord(msgspec.Struct, frozen=True):
    """One sample of the vehicle's inertial sensors."""

    time: Seconds
    specific_force_body: Annotated[Floats, Meta(description="m/s^2, body FLU")]
    rate_body: Rate


class RotorRecord(msgspec.Struct, frozen=True):
    """Rotor speeds from the ESCs, in the autopilot's motor order, from motor `first` on."""

    time: Seconds
    first: int
    speed: Annotated[Floats, Meta(description="rad/s")]


class MotorRecord(msgspec.Struct, frozen=True):
    """Commands to the autopilot's outputs, in its own order."""

    time: Seconds
    pulse: Annotated[Floats, Meta(description="us, of SERVO_OUTPUT_RAW")]


class BatteryRecord(msgspec.Struct, frozen=True):
    """The battery as the vehicle reports it."""

    time: Seconds
    voltage: Annotated[float, Meta(description="V")]
    current: Annotated[float, Meta(description="A")]
    remaining: Annotated[float, Meta(description="0..1")]


class ParameterRecord(msgspec.Struct, frozen=True):
    """A parameter read from the vehicle."""

    time: Seconds
    name: str
    value: float


class TextRecord(msgspec.Struct, frozen=True):
    """A STATUSTEXT. source: vehicle, link or daemon. severity: MAVLink's, 0 emergency to 7 debug."""

    time: Seconds
    source: str
    severity: int
    text: str


Record = (
    EstimateRecord
    | ReferenceRecord
    | SetpointRecord
    | TickRecord
    | ObservationRecord
    | HorizonRecord
    | FollowedRecord
    | PhaseRecord
    | EventRecord
    | StateRecord
    | ImuRecord
    | RotorRecord
    | MotorRecord
    | BatteryRecord
    | ParameterRecord
    | TextRecord
)

LASTING = (ParameterRecord, StateRecord, PhaseRecord)  # hold until the next one: each part of a recording has the last

TOPICS: Mapping[type[Record], str] = {
    EstimateRecord: "/estimate",
    ReferenceRecord: "/reference",
    SetpointRecord: "/setpoint",
    TickRecord: "/tick",
    ObservationRecord: "/observation",
    HorizonRecord: "/horizon",
    FollowedRecord: "/followed",
    PhaseRecord: "/phase",
    EventRecord: "/event",
    StateRecord: "/state",
    ImuRecord: "/imu",
    RotorRecord: "/rotors",
    MotorRecord: "/motors",
    BatteryRecord: "/battery",
    ParameterRecord: "/parameter",
    TextRecord: "/text",
}


def _describe_array(kind: type) -> dict[str, Any]:
    if kind is np.ndarray:
        return {"type": "array", "items": {"type": "number"}}
    raise NotImplementedError(kind)


def schema_of(kind: type[Record]) -> dict[str, Any]:
    """The JSON schema of a record, without references, which Foxglove does not follow."""
    _, components = msgspec.json.schema_components((kind,), schema_hook=_describe_array)
    return dict(components[kind.__name__])


def _array_as_list(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        return value.tolist()
    raise NotImplementedError(type(value))


_encoder = msgspec.json.Encoder(enc_hook=_array_as_list)


def encode(record: Record) -> bytes:
    """A record as JSON. Floats are written so that reading gives the same bits; NaN becomes null."""
    return _encoder.encode(record)
