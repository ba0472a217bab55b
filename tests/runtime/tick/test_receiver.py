"""The thread in C: every datagram reaches Python once and in order, and an estimate is answered only while armed."""

from __future__ import annotations

import errno
import socket
import struct
import time
from collections.abc import Iterator
from math import inf

import numpy as np
import pytest

from runtime.link.datagram import Datagram
from runtime.link.dialect import mavlink
from runtime.link.framing import FrameParser
from runtime.tick import context
from runtime.tick.receiver import Receiver
from tests.runtime.tick.test_wire import HOVERING, NOW, Listener, odometry, packer
from tests.support.deadline import Deadline
from tests.support.tick_in_c import FixedSolver, library

pytestmark = pytest.mark.realtime

SO_TIMESTAMPNS = 35  # Linux


class Bench:
    """A receiver of a real socket, whose solver answers with 1 rad/s about every axis."""

    def __init__(self) -> None:
        self.ours, self.vehicle = (socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(2))
        for each in (self.ours, self.vehicle):
            each.bind(("127.0.0.1", 0))
        self.ours.connect(self.vehicle.getsockname())
        self.vehicle.connect(self.ours.getsockname())
        self.ours.setsockopt(socket.SOL_SOCKET, socket.SO_RCVTIMEO, struct.pack("@ll", 0, 20_000))
        self.ours.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS, 1)
        self.vehicle.settimeout(5.0)
        self.receiver = Receiver(library(), self.ours.fileno())
        self.solver = FixedSolver(np.ones(3), np.full(4, 900.0))
        self.history = np.zeros(64), np.zeros((64, 4)), np.zeros((64, 0))
        self.set_up()

    def set_up(self) -> None:
        listener = Listener()
        source, target = listener.context, self.receiver.context
        target.messages, target.limits = source.messages, source.limits
        target.limits.stale = target.limits.oldest = target.limits.max_stamp_age = inf
        target.limits.forgotten_after = inf
        self.solver.write(target.solver)
        target.vehicle.rate_limit[:], target.vehicle.thrust_limit, target.vehicle.thrust_max = (5.0,) * 3, 9.0, 9.0
        target.vehicle.node, target.vehicle.max_step = 0.05, inf  # however old the test's estimates are
        plan = target.plan
        times, inputs, hidden = (each.ctypes.data for each in self.history)
        plan.command_times, plan.command_inputs, plan.hidden_states = times, inputs, hidden
        plan.commands, plan.history, plan.tilt_rate, plan.effectiveness = 1, 64, inf, 1.0
        plan.not_before = -inf
        link = self.receiver.link
        context.write_link(
            link, vehicle=(1, 1), own=(1, 191), clock=listener.peer.clock, estimates=listener.peer.estimates
        )
        link.socket, link.clock_valid_until = self.ours.fileno(), inf
        self.receiver.know()

    def send(self, stamp: float) -> None:
        self.vehicle.send(odometry(stamp - 5.0, HOVERING, (1, 12)).pack(packer()))

    def receive(self) -> Datagram:
        deadline = Deadline(5.0)
        while not deadline.passed:
            if (datagram := self.receiver.receive(0.05)) is not None:
                return datagram
        raise AssertionError("nothing came")

    def close(self) -> None:
        self.receiver.close()
        self.ours.close()
        self.vehicle.close()


@pytest.fixture
def bench() -> Iterator[Bench]:
    made = Bench()
    yield made
    made.close()


def test_datagrams_come_once_in_order_with_their_arrival(bench: Bench) -> None:
    before = time.monotonic()
    sent = [number.to_bytes(4, "little") * (1 + number % 300) for number in range(500)]
    got = []
    for chunk in range(0, 500, 50):
        for data in sent[chunk : chunk + 50]:
            bench.vehicle.send(data)
        got += [bench.receive() for _ in range(50)]
    assert [datagram.data for datagram in got] == sent
    assert all(datagram.address == bench.vehicle.getsockname() for datagram in got)
    assert all(datagram.error == 0 and datagram.answered is None for datagram in got)
    assert all(before <= datagram.received <= time.monotonic() for datagram in got)
    assert bench.receiver.receive(0.0) is None


def test_only_an_armed_estimate_is_answered_and_once(bench: Bench) -> None:
    bench.send(NOW)
    assert bench.receive().answered is None
    assert not bench.receiver.claim()
    bench.receiver.arm()
    bench.vehicle.send(b"\xfd")  # of nobody: it disarms, as Python may make something of it
    bench.receive()
    assert not bench.receiver.claim()
    bench.receiver.arm()
    bench.send(NOW + 0.02)
    answered = bench.receive().answered
    assert answered is not None
    assert answered.stamp == pytest.approx(NOW + 0.02 - 5.0)
    bench.send(NOW + 0.03)
    assert bench.receive().answered is None
    assert bench.receiver.claim()
    assert not bench.receiver.claim()
    (frame,) = FrameParser().feed(bench.vehicle.recv(300))
    assert frame.message.get_type() == "SET_ATTITUDE_TARGET"
    assert (frame.message.body_roll_rate, frame.message.body_pitch_rate) == (1.0, -1.0)
    assert bytes(bench.receiver.result.frame[: bench.receiver.result.frame_size]) == frame.data


def test_a_heartbeat_leaves_a_tick_armed_and_a_change_disarms_it(bench: Bench) -> None:
    bench.receiver.arm()
    bench.vehicle.send(mavlink.MAVLink_heartbeat_message(2, 12, 0, 0, 4, 3).pack(packer()))
    bench.receive()
    bench.send(NOW + 0.02)
    assert bench.receive().answered is not None
    assert bench.receiver.claim()
    bench.receiver.arm()
    bench.receiver.disarm()
    bench.send(NOW + 0.04)
    assert bench.receive().answered is None
    assert not bench.receiver.claim()


def test_an_estimate_that_is_not_due_leaves_the_tick_armed(bench: Bench) -> None:
    bench.receiver.context.plan.not_before = inf
    bench.receiver.arm()
    bench.send(NOW + 0.02)
    assert bench.receive().answered is None
    assert not bench.receiver.claim()
    assert bench.solver.calls == 0


def test_estimates_answered_before_the_link_came_to_them_stay_the_newest(bench: Bench) -> None:
    """The link's thread may be late: what it knows then does not bring an older estimate back."""
    for step in range(1, 4):
        bench.receiver.arm()
        bench.send(NOW + 0.02 * step)
        bench.vehicle.recv(300)
        assert bench.receiver.claim()
        bench.receiver.know()
    bench.receiver.arm()
    bench.send(NOW + 0.06)  # once more
    assert all(bench.receive().answered is not None for _ in range(3))
    assert bench.receive().answered is None


def test_sequence_numbers_are_counted_on_by_all_who_send(bench: Bench) -> None:
    first = next(bench.receiver)
    bench.receiver.arm()
    bench.send(NOW + 0.02)
    assert bench.vehicle.recv(300)[4] == (first + 1) & 0xFF
    assert next(bench.receiver) == first + 2


def test_a_socket_s_error_reaches_the_reader() -> None:
    bench = Bench()
    bench.vehicle.close()
    bench.ours.send(b"x")
    assert bench.receive().error == errno.ECONNREFUSED
    bench.close()
