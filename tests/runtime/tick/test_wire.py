"""Bytes in and out: C reads a datagram as the link does, and packs a setpoint as pymavlink does, to the last bit."""

from __future__ import annotations

import ctypes
import struct
from typing import Any

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dynamics.signing_key import SigningKey
from dynamics.vehicle import Limits, Vehicle
from runtime.flight.decision import Decision
from runtime.flight.health import HealthLimits
from runtime.flight.setpoint_output import SetpointOutput
from runtime.flight.takeoff import HandOver
from runtime.flight.thrust import EffectivenessSettings, ThrustMap
from runtime.link.clock import VehicleClock
from runtime.link.dialect import mavlink
from runtime.link.estimate import EstimateLimits, EstimateMonitor, StateEstimate
from runtime.link.framing import FrameParser
from runtime.link.odometry import read_odometry
from runtime.link.peer import Peer
from runtime.link.setpoint_message import rate_setpoint_message
from runtime.tick import context
from tests.support.tick_in_c import FixedSolver, library

KEY = SigningKey(bytes(range(32)))
NOW = 20.0
SETPOINTS = 1  # link id
CONTEXT = library().structs["alula_context"]
RESULT = library().structs["alula_result"]


def packer(*, signed: bool = False, timestamp: int = 1000, sequence: int = 7) -> Any:
    made = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
    made.seq = sequence
    if signed:
        made.signing.secret_key, made.signing.link_id, made.signing.timestamp = KEY.secret, 3, timestamp
        made.signing.sign_outgoing = True
    return made


def odometry(time: float, wire: list[float], frames: tuple[int, int] = (1, 1), reset: int = 0) -> Any:
    x, y, z, q0, q1, q2, q3, vx, vy, vz, p, q, r = wire
    covariance = [float("nan")] * 21
    return mavlink.MAVLink_odometry_message(
        int(time * 1e6), *frames, x, y, z, [q0, q1, q2, q3], vx, vy, vz, p, q, r, covariance, covariance, reset, 1, 0
    )


HOVERING = [0.0, 0.0, -1.0, 1.0, *[0.0] * 9]


class Listener:
    """A peer that follows a vehicle's clock and has an estimate, and a context that knows the same."""

    def __init__(self, *, latest: float = NOW - 0.01) -> None:
        self.peer, clock = Peer(), VehicleClock()
        self.peer.address, self.peer.clock = (1, 1), clock
        for step in range(10):
            sent = NOW - 2.0 + 0.2 * step
            clock.handle(sent, sent + 0.001, sent + 0.0005 - 5.0)
        self.feed(odometry(latest - 5.0, HOVERING).pack(packer()), latest + 0.001)
        self.context = CONTEXT()
        context.write_messages(self.context.messages)
        self.write()

    def write(self) -> None:
        context.write_limits(self.context.limits, EstimateLimits(), HealthLimits())
        context.write_link(
            self.context.link, vehicle=(1, 1), own=(1, 191), clock=self.peer.clock, estimates=self.peer.estimates
        )
        self.context.link.socket = -1

    def feed(self, data: bytes, received: float) -> tuple[StateEstimate | None, list[str]]:
        """By the link's own path: the accepted estimate and the events."""
        estimate, events = None, list[str]()
        for frame in FrameParser().feed(data):
            reaction = self.peer.handle(frame, received)
            estimate = reaction.estimate or estimate
            events += [event.name for event in reaction.events]
        return estimate, events

    def read(self, data: bytes, received: float) -> tuple[str, Any]:
        """By C."""
        result = RESULT()
        result.received = received
        function = library().waiting.alula_read
        reason = function(ctypes.byref(self.context), data, len(data), received, ctypes.byref(result))
        return library().reasons[reason], result


numbers = st.floats(-3.0, 3.0, width=32)
attitudes = st.tuples(*[st.floats(-1.0, 1.0, width=32)] * 4).filter(lambda q: np.linalg.norm(q) > 0.1)
near = st.floats(-0.25, 0.25, width=32)
WIRES = st.one_of(
    st.tuples(*[st.floats(width=32)] * 13).map(list),
    st.tuples(*[near] * 13).map(lambda moved: [value + base for value, base in zip(moved, HOVERING, strict=True)]),
    st.tuples(numbers, numbers, numbers, attitudes, *[near] * 6).map(
        lambda parts: [*parts[:3], *(np.array(parts[3]) / np.linalg.norm(parts[3])), *parts[4:]]
    ),
)


def as_floats(wire: list[float]) -> list[float]:
    return list(struct.unpack("<13f", np.array(wire, dtype=np.float32).tobytes()))


@given(
    wire=WIRES,
    frames=st.sampled_from([(1, 1), (1, 12), (1, 12), (1, 1), (4, 1), (1, 8)]),
    age=st.floats(-0.3, 0.5),
    apart=st.floats(0.002, 1.5),
    reset=st.integers(0, 1) | st.just(0),
)
def test_an_estimate_is_read_and_judged_as_by_the_link(
    wire: list[float], frames: tuple[int, int], age: float, apart: float, reset: int
) -> None:
    listener = Listener()
    received = NOW - 0.009 + apart
    data = odometry(received - age - 5.0, as_floats(wire), frames, reset).pack(packer())
    reason, result = listener.read(data, received)
    estimate, events = listener.feed(data, received)
    if reason == "sent":
        assert estimate is not None
        assert not events
        assert estimate.time == result.time
        assert estimate.state.tolist() == list(result.state)
        assert estimate.reset_counter == result.reset_counter
        assert listener.peer.estimates.stamp == result.stamp
    else:  # what C leaves is refused, or is one of the cases that are Python's alone
        assert estimate is None or events or reason in ("not next", "clock", "reset")


@given(apart=st.floats(0.004, 0.05), moved=st.tuples(*[st.floats(-0.0078125, 0.0078125, width=32)] * 13))
def test_what_moves_as_a_vehicle_does_is_never_left_to_python(apart: float, moved: tuple[float, ...]) -> None:
    listener, received = Listener(), NOW + apart
    wire = as_floats([value + base for value, base in zip(moved, HOVERING, strict=True)])
    assert listener.read(odometry(received - 5.005, wire, (1, 12)).pack(packer()), received)[0] == "sent"


@given(data=st.data(), cut=st.integers(1, 5), place=st.integers(0, 400), bit=st.integers(1, 255))
def test_damaged_datagrams_hold_no_estimate_that_the_link_would_not_take(
    data: st.DataObject, cut: int, place: int, bit: int
) -> None:
    listener, received = Listener(), NOW
    good = odometry(received - 5.005, HOVERING, (1, 12)).pack(packer())
    others = [mavlink.MAVLink_heartbeat_message(2, 12, 0, 0, 4, 3), mavlink.MAVLink_timesync_message(0, 5)]
    parts = data.draw(st.permutations([good, *(message.pack(packer()) for message in others)]))
    datagram = bytearray(b"".join(parts))
    datagram[place % len(datagram)] ^= bit
    del datagram[len(datagram) - cut :]
    reason, result = listener.read(bytes(datagram), received)
    estimate, _ = listener.feed(bytes(datagram), received)
    assert reason != "sent" or (estimate is not None and estimate.state.tolist() == list(result.state))


def test_frames_around_an_estimate_do_not_hide_it() -> None:
    listener, received = Listener(), NOW
    parts = [
        mavlink.MAVLink_heartbeat_message(2, 12, 0, 0, 4, 3).pack(packer()),
        odometry(received - 5.005, HOVERING, (1, 12)).pack(packer()),
        mavlink.MAVLink_timesync_message(0, 5).pack(packer(), force_mavlink1=True),
    ]
    assert listener.read(b"".join(parts), received)[0] == "sent"
    assert listener.read(parts[0], received)[0] == "no estimate"
    assert listener.read(parts[1] * 2, received)[0] == "not frames"  # which of the two?
    other = mavlink.MAVLink(None, srcSystem=2, srcComponent=1)
    assert listener.read(odometry(received - 5.005, HOVERING).pack(other), received)[0] == "no estimate"


def test_a_payload_without_its_trailing_zeros_is_whole() -> None:
    listener, received = Listener(), NOW
    x, *rest = HOVERING
    message = mavlink.MAVLink_odometry_message(
        int((received - 5.005) * 1e6), 1, 12, x, *rest[:2], rest[2:6], *rest[6:], [0.0] * 21, [0.0] * 21, 0, 0, 0
    )
    packed = message.pack(packer())
    assert packed[1] < 232
    assert read_odometry(FrameParser().feed(packed)[0].payload).child_frame_id == 12
    assert listener.read(packed, received)[0] == "sent"


@pytest.mark.parametrize(
    ("stamp", "key", "reason"),
    [(1000, KEY, "sent"), (999, KEY, "signature"), (1000, SigningKey(bytes(31) + b"1"), "signature")],
)
def test_signatures_are_judged_as_by_the_link(stamp: int, key: SigningKey, reason: str) -> None:
    listener, received = Listener(), NOW
    link = listener.context.link
    link.is_signed, link.key[:], link.heard[:] = 1, tuple(key.secret), [-1] * 256
    message = odometry(received - 5.005, HOVERING, (1, 12))
    assert listener.read(message.pack(packer(signed=True, timestamp=stamp)), received)[0] == "signature"  # new stream
    link.heard[3] = 999
    assert listener.read(message.pack(packer(signed=True, timestamp=stamp)), received)[0] == reason
    assert listener.read(message.pack(packer()), received)[0] == "signature"


LIMITS = (6.0, 5.0, 2.0)


@given(
    rate=st.tuples(*[st.floats(-8.0, 8.0)] * 3),
    speeds=st.tuples(*[st.floats(0.0, 2500.0)] * 4),
    curves=st.tuples(st.sampled_from([0.0, 0.3, 1.0]), st.sampled_from([0.0, 0.4, 1.0])),
    effectiveness=st.floats(0.4, 1.65),
    tilt_rate=st.sampled_from([float("inf"), 1.0]),
    begun=st.none() | st.floats(-0.5, 0.1),
    sequence=st.integers(0, 600),
    signed=st.booleans(),
)
def test_an_answer_is_limited_scaled_and_packed_as_by_python(
    arpl_250g: Vehicle,
    rate: tuple[float, ...],
    speeds: tuple[float, ...],
    curves: tuple[float, float],
    effectiveness: float,
    tilt_rate: float,
    begun: float | None,
    sequence: int,
    signed: bool,
) -> None:
    limits: Limits = msgspec.structs.replace(arpl_250g.limits, rate=LIMITS)
    vehicle = msgspec.structs.replace(arpl_250g, limits=limits)
    thrust_map = ThrustMap(vehicle.rotors.thrust_max, *curves)
    solver, target, result = FixedSolver(np.array(rate), np.array(speeds)), CONTEXT(), RESULT()
    solver.write(target.solver)
    constants = [vehicle.rotors.thrust_constant] * 4
    constant, plan, link = target.vehicle, target.plan, target.link
    constant.rate_limit[:], constant.thrust_limit = LIMITS, vehicle.thrust_limits[1]
    constant.thrust_max, constant.thrust_constants[:4] = thrust_map.thrust_max, constants
    constant.vehicle_curve, constant.autopilot_curve = curves
    constant.node = constant.max_step = 0.05
    target.limits.stale = target.limits.oldest = 1.0
    times, inputs, hidden = np.full(64, -np.inf), np.zeros((64, 4)), np.zeros((64, 0))
    times[0] = NOW - 1.0
    plan.command_times, plan.command_inputs, plan.hidden_states = (each.ctypes.data for each in (times, inputs, hidden))
    plan.commands, plan.history, plan.tilt_rate, plan.effectiveness = 1, 64, tilt_rate, effectiveness
    hand_over = None if begun is None else HandOver(NOW + begun, 3.0)
    if hand_over is not None:
        plan.hands_over, plan.hand_over_started = 1, hand_over.started
        plan.hand_over_thrust, plan.hand_over_duration = hand_over.collective_thrust, hand_over.duration
    link.system, link.component, link.own_system, link.own_component, link.socket = 1, 1, 1, 191, -1
    target.sequence = sequence
    if signed:
        link.is_signed, link.key[:], link.link_id, link.last_timestamp = 1, tuple(KEY.secret), SETPOINTS, 10**12
    result.received = result.time = NOW
    assert library().waiting.alula_answer(ctypes.byref(target), NOW + 0.001, ctypes.byref(result)) == 0

    thrust = 0.0
    for speed, constant in zip(speeds, constants, strict=True):
        thrust += speed * speed * constant
    assert result.solved_thrust == thrust
    rates = np.array(result.solved_rate)
    rates[:2] = np.clip(rates[:2], -tilt_rate, tilt_rate)
    decision, output = Decision(), SetpointOutput(vehicle, thrust_map, EffectivenessSettings())
    output.effectiveness.value = effectiveness
    decision.collective_thrust = thrust if hand_over is None else hand_over.blend(thrust, NOW + 0.001)
    output.finish(decision, rates, 0.0, NOW)
    assert decision.rate_body is not None
    assert decision.rate_body.tolist() == list(result.rate)
    assert decision.thrust == result.thrust
    assert decision.collective_thrust == result.collective_thrust

    frame = bytes(result.frame[: result.frame_size])
    x, y, z = decision.rate_body.tolist()
    message = rate_setpoint_message((1, 1), (x, y, z), decision.thrust, 0.0)
    message.time_boot_ms = int.from_bytes(frame[10:14], "little")  # of the clock when it was packed
    expected = packer(signed=signed, timestamp=result.timestamp, sequence=sequence & 0xFF)
    expected.srcComponent, expected.signing.link_id = 191, SETPOINTS
    assert frame == message.pack(expected)
    assert result.timestamp == (10**12 + 1 if signed else -1)


@pytest.mark.parametrize("status", [-1, 2, 3])
def test_an_answer_that_failed_is_not_sent(status: int) -> None:
    solver, target, result = FixedSolver(np.zeros(3), np.full(4, 900.0), status), CONTEXT(), RESULT()
    solver.write(target.solver)
    times, inputs, hidden = np.zeros(64), np.zeros((64, 4)), np.zeros((64, 0))
    plan = target.plan
    plan.command_times, plan.command_inputs, plan.hidden_states = (each.ctypes.data for each in (times, inputs, hidden))
    plan.commands, plan.history = 1, 64
    target.limits.stale = target.limits.oldest = 1.0
    target.vehicle.max_step = 0.05
    result.received = result.time = NOW
    reason = library().waiting.alula_answer(ctypes.byref(target), NOW, ctypes.byref(result))
    assert library().reasons[reason] == "solver"
    assert solver.calls == 1
    assert result.frame_size == 0


def test_monitors_that_adopt_an_answered_estimate_go_on_from_it() -> None:
    monitor = EstimateMonitor()
    state = np.zeros(13)
    state[6] = 1.0
    monitor.adopt(StateEstimate(1.0, 1.001, state, 0, True, "ODOMETRY"), 6.0)
    assert monitor.latest is not None
    assert monitor.stamp == 6.0
    packed = odometry(6.0, HOVERING).pack(packer())
    again = monitor.handle_odometry(read_odometry(FrameParser().feed(packed)[0].payload), 1.0, 1.002, True)
    assert again.estimate is None  # the same stamp again
