"""A running link finds its vehicle, follows its clock, publishes its estimates, and survives any message."""

from __future__ import annotations

import os
import random
import socket
import threading
import time
import tty
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import development as mavlink
from pymavlink.generator.mavcrc import x25crc

from dynamics.errors import VehicleError
from runtime.link.connection import Endpoint
from runtime.link.framing import FrameParser
from runtime.link.link import Link, LinkCallbacks, LinkSettings
from runtime.link.peer import Peer
from runtime.link.telemetry import BatterySample, ImuSample, LinkEvent, MotorOutputs, RotorSpeeds
from runtime.link.texts import TextAssembler, text_messages
from runtime.link.transport import UdpTransport
from tests.support.deadline import wait_until
from tests.support.fake_vehicle import FakeVehicle, odometry

pytestmark = pytest.mark.realtime

LOCAL = "127.0.0.1"


def port_of(link: Link) -> int:
    assert isinstance(link.transport, UdpTransport)
    return link.transport.port


def open_link(settings: LinkSettings | None = None, callbacks: LinkCallbacks | None = None) -> Link:
    return Link(Endpoint("udpin", LOCAL, 0), settings, callbacks)


@pytest.fixture
def events() -> list[LinkEvent]:
    return []


@pytest.fixture
def link(events: list[LinkEvent]) -> Iterator[Link]:
    with open_link(callbacks=LinkCallbacks(event=events.append)) as opened:
        yield opened


@pytest.fixture
def vehicle(link: Link) -> Iterator[FakeVehicle]:
    with FakeVehicle((LOCAL, port_of(link))) as fake:
        link.wait_for_vehicle(5.0)
        yield fake


def test_the_vehicle_is_found_and_followed(link: Link, vehicle: FakeVehicle, events: list[LinkEvent]) -> None:
    status = link.status
    assert (status.system, status.component, status.autopilot, status.kind) == (1, 1, "px4", "quadrotor")
    assert (status.mode, status.armed) == ("HOLD", False)
    vehicle.custom_mode, vehicle.armed = 6 << 16, True
    wait_until(lambda: link.status.mode == "OFFBOARD" and link.status.armed)
    assert {"vehicle_found", "mode_changed", "armed"} <= {event.name for event in events}
    assert link.is_connected(time.monotonic())


def test_we_speak_as_the_companion_on_board(link: Link, vehicle: FakeVehicle) -> None:
    wait_until(lambda: vehicle.count("HEARTBEAT") >= 2)
    heartbeat = next(message for message in vehicle.received if message.get_type() == "HEARTBEAT")
    assert (heartbeat.get_srcSystem(), heartbeat.get_srcComponent()) == (1, 191)
    assert heartbeat.type == mavlink.MAV_TYPE_ONBOARD_CONTROLLER
    assert heartbeat.autopilot == mavlink.MAV_AUTOPILOT_INVALID


def test_a_ground_station_s_heartbeat_is_sent_on_request() -> None:
    with open_link(LinkSettings(gcs_heartbeat=True)) as link, FakeVehicle((LOCAL, port_of(link)), system=7) as vehicle:
        wait_until(lambda: vehicle.count("HEARTBEAT") >= 4)
        kinds = {(m.get_srcSystem(), m.type) for m in vehicle.received if m.get_type() == "HEARTBEAT"}
        assert kinds == {(7, mavlink.MAV_TYPE_ONBOARD_CONTROLLER), (7, mavlink.MAV_TYPE_GCS)}


def test_the_vehicle_s_clock_becomes_valid(link: Link, vehicle: FakeVehicle) -> None:
    wait_until(lambda: link.peer.clock.is_valid(time.monotonic()))
    assert link.peer.clock.offset(time.monotonic()) == pytest.approx(vehicle.clock_offset, abs=0.02)
    vehicle.send_odometry(x=1.0)
    estimate = link.wait_for_estimate(None, time.monotonic() + 5.0)
    assert estimate is not None
    assert estimate.is_synchronised
    assert estimate.time == pytest.approx(estimate.received, abs=0.02)


def test_the_vehicle_s_own_timesync_requests_are_answered(link: Link, vehicle: FakeVehicle) -> None:
    vehicle.send(mavlink.MAVLink_timesync_message(0, 123456789))
    wait_until(lambda: any(m.get_type() == "TIMESYNC" and m.ts1 == 123456789 for m in vehicle.received))
    answer = next(m for m in vehicle.received if m.get_type() == "TIMESYNC" and m.ts1 == 123456789)
    assert answer.tc1 * 1e-9 == pytest.approx(time.monotonic(), abs=5.0)


def test_a_waiting_thread_gets_each_new_estimate(link: Link, vehicle: FakeVehicle) -> None:
    previous = None
    for n in range(20):
        threading.Timer(0.002, vehicle.send_odometry, kwargs={"x": 0.01 * n}).start()
        estimate = link.wait_for_estimate(previous, time.monotonic() + 5.0)
        assert estimate is not None
        assert estimate is not previous
        previous = estimate
    assert link.wait_for_estimate(previous, time.monotonic() + 0.02) is None
    assert link.wait_for_estimate(None, time.monotonic()) is previous


def test_setpoints_are_body_rates_and_thrust_in_the_vehicle_s_axes(link: Link, vehicle: FakeVehicle) -> None:
    assert link.send_rate_setpoint((0.1, 0.2, 0.3), 0.6)
    wait_until(lambda: vehicle.count("SET_ATTITUDE_TARGET"))
    setpoint = next(m for m in vehicle.received if m.get_type() == "SET_ATTITUDE_TARGET")
    assert (setpoint.target_system, setpoint.target_component, setpoint.type_mask) == (1, 1, 128)
    rates = (setpoint.body_roll_rate, setpoint.body_pitch_rate, setpoint.body_yaw_rate)
    assert rates == pytest.approx((0.1, -0.2, -0.3))
    assert setpoint.thrust == pytest.approx(0.6)


@pytest.mark.parametrize("bad", [float("nan"), float("inf"), float("-inf")])
def test_a_setpoint_that_is_no_number_is_never_sent(link: Link, vehicle: FakeVehicle, bad: float) -> None:
    assert not link.send_rate_setpoint((bad, 0.0, 0.0), 0.5)
    assert not link.send_rate_setpoint((0.0, 0.0, bad), 0.5)
    assert not link.send_rate_setpoint((0.0, 0.0, 0.0), bad)
    assert link.send_rate_setpoint((0.0, 0.0, 0.0), 0.5)
    wait_until(lambda: vehicle.count("SET_ATTITUDE_TARGET"))
    assert vehicle.count("SET_ATTITUDE_TARGET") == 1


def test_messages_of_all_threads_carry_one_sequence(link: Link, vehicle: FakeVehicle) -> None:
    senders = [threading.Thread(target=lambda: [link.send_text("text") for _ in range(50)]) for _ in range(2)]
    for sender in senders:
        sender.start()
    for _ in range(50):
        link.send_rate_setpoint((0.0, 0.0, 0.0), 0.5)
    for sender in senders:
        sender.join()
    wait_until(lambda: vehicle.count("STATUSTEXT") == 100 and vehicle.count("SET_ATTITUDE_TARGET") == 50)
    sequence = sorted(message.get_seq() for message in vehicle.received)
    assert len(set(sequence)) == len(sequence)


def test_other_systems_are_heard_but_never_answered(link: Link, vehicle: FakeVehicle, events: list[LinkEvent]) -> None:
    with FakeVehicle((LOCAL, port_of(link)), system=9) as other:
        wait_until(lambda: (9, 1) in link.peer.heard)
        for _ in range(20):
            other.send_odometry(x=5.0)
            link.send_rate_setpoint((0.0, 0.0, 0.0), 0.5)
        wait_until(lambda: vehicle.count("SET_ATTITUDE_TARGET") == 20)
        assert not other.received
        assert link.estimate is None
        assert link.status.system == 1
        assert "other_vehicle" in {event.name for event in events}


def test_a_vehicle_that_changes_its_port_is_followed(link: Link, vehicle: FakeVehicle) -> None:
    vehicle.sends = False
    with FakeVehicle((LOCAL, port_of(link))) as moved:
        wait_until(lambda: moved.count("HEARTBEAT") > 0)


def test_a_wrong_system_id_is_reported_with_those_heard() -> None:
    with open_link(LinkSettings(target_system=42)) as link, FakeVehicle((LOCAL, port_of(link))):
        with pytest.raises(VehicleError, match=r"No vehicle with system id 42.*Heard.*1/1 \(quadrotor, px4\)"):
            link.wait_for_vehicle(0.5)
        assert not link.status.is_known


def test_a_silent_link_is_reported_with_what_to_check(link: Link) -> None:
    with pytest.raises(VehicleError, match=r"No MAVLink arrived on udpin.*nothing at all.*14540") as refusal:
        link.wait_for_vehicle(0.1)
    assert refusal.value.exit_code == 4


def test_bytes_that_are_no_mavlink_are_distinguished_from_silence(link: Link) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as noise:
        noise.sendto(b"hello there" * 10, (LOCAL, port_of(link)))
        wait_until(lambda: link.parser.skipped_bytes > 0)
    with pytest.raises(VehicleError, match="wrong baud rate"):
        link.wait_for_vehicle(0.1)


def test_a_vehicle_s_silence_and_its_return_are_reported(
    link: Link, vehicle: FakeVehicle, events: list[LinkEvent]
) -> None:
    vehicle.sends = False
    wait_until(lambda: "vehicle_silent" in {event.name for event in events})
    assert not link.is_connected(time.monotonic())
    vehicle.sends = True
    wait_until(lambda: "vehicle_heard_again" in {event.name for event in events})


def test_a_flood_of_garbage_stops_nothing(link: Link, vehicle: FakeVehicle, events: list[LinkEvent]) -> None:
    source = random.Random(5)
    heartbeat = bytearray(mavlink.MAVLink_heartbeat_message(2, 12, 0, 0, 3, 3).pack(mavlink.MAVLink(None, 1, 1)))
    for _ in range(500):
        heartbeat[source.randrange(len(heartbeat))] ^= 1 << source.randrange(8)
        vehicle.send_bytes(source.randbytes(source.randrange(1, 300)))
        vehicle.send_bytes(bytes(heartbeat[: source.randrange(1, len(heartbeat))]))
    wait_until(lambda: link.parser.skipped_bytes > 1000)
    estimate, deadline = None, time.monotonic() + 5.0
    while estimate is None and time.monotonic() < deadline:  # the flood may still fill the kernel's buffer
        vehicle.send_odometry(x=2.0)
        estimate = link.wait_for_estimate(None, time.monotonic() + 0.1)
    assert estimate is not None
    assert estimate.position_world[1] == pytest.approx(2.0)
    assert "link_defect" not in {event.name for event in events}


def test_everything_that_passes_is_offered_to_the_recorder() -> None:
    frames: list[tuple[str, float, bytes]] = []
    messages: list[Any] = []
    callbacks = LinkCallbacks(
        frame=lambda direction, at, data: frames.append((direction, at, data)),
        message=lambda message, at: messages.append(message),
    )
    with open_link(callbacks=callbacks) as link, FakeVehicle((LOCAL, port_of(link))) as vehicle:
        link.wait_for_vehicle(5.0)
        vehicle.send_odometry()
        link.send_rate_setpoint((0.0, 0.0, 0.0), 0.5)
        wait_until(lambda: vehicle.count("SET_ATTITUDE_TARGET") and vehicle.count("HEARTBEAT"))
        wait_until(lambda: any(message.get_type() == "ODOMETRY" for message in messages))
    out = {frame.message.get_type() for way, _, data in frames if way == "out" for frame in FrameParser().feed(data)}
    into = {frame.message.get_type() for way, _, data in frames if way == "in" for frame in FrameParser().feed(data)}
    assert {"HEARTBEAT", "SET_ATTITUDE_TARGET"} <= out
    assert {"HEARTBEAT", "ODOMETRY"} <= into
    assert all(abs(at - time.monotonic()) < 60.0 for _, at, _ in frames)


def test_a_consumer_that_fails_does_not_take_the_link_down(events: list[LinkEvent]) -> None:
    def fail(message: Any, received: float) -> None:
        raise RuntimeError("the recorder's fault")

    with (
        open_link(callbacks=LinkCallbacks(message=fail, event=events.append)) as link,
        FakeVehicle((LOCAL, port_of(link))) as vehicle,
    ):
        link.wait_for_vehicle(5.0)
        vehicle.send_odometry()
        assert link.wait_for_estimate(None, time.monotonic() + 5.0) is not None
        wait_until(lambda: "link_defect" in {event.name for event in events})


@pytest.mark.filterwarnings("error::pytest.PytestUnhandledThreadExceptionWarning")
def test_a_serial_device_unplugged_in_flight_is_an_event_and_comes_back(events: list[LinkEvent], tmp_path: Any) -> None:
    path, name = str(tmp_path / "ttyVEHICLE"), "link_lost"
    heartbeat = bytes(mavlink.MAVLink_heartbeat_message(2, 12, 0, 0, 3, 3).pack(mavlink.MAVLink(None, 1, 1)))

    def plug() -> int:
        master, slave = os.openpty()
        tty.setraw(master)
        os.symlink(os.ttyname(slave), path)
        return master

    master = plug()
    with Link(Endpoint("serial", device=path), callbacks=LinkCallbacks(event=events.append)) as link:
        os.write(master, heartbeat)
        link.wait_for_vehicle(5.0)
        os.unlink(path)
        os.close(master)
        wait_until(lambda: name in {event.name for event in events})
        assert not link.send_rate_setpoint((0.0, 0.0, 0.0), 0.5)
        master = plug()
        wait_until(lambda: "link_restored" in {event.name for event in events})
        before = link.peer.last_heard
        os.write(master, heartbeat)
        wait_until(lambda: link.peer.last_heard > before)
    os.close(master)


# --- the same handling without a socket


class PeerHarness:
    """Feeds packed messages to a Peer, as a link or a recording does."""

    def __init__(self) -> None:
        self.peer, self.events = Peer(), list[LinkEvent]()
        self._packer = mavlink.MAVLink(None, 1, 1)
        self.feed(mavlink.MAVLink_heartbeat_message(2, 12, 0, 4 << 16 | 3 << 24, 3, 3), 0.0)

    def feed(self, message: Any, received: float) -> Any:
        (frame,) = FrameParser().feed(bytes(message.pack(self._packer)))
        reaction = self.peer.handle(frame, received)
        self.events += reaction.events
        return reaction


@pytest.fixture
def harness() -> PeerHarness:
    return PeerHarness()


def test_rotor_speeds_are_radians_per_second(harness: PeerHarness) -> None:
    kind = mavlink.mavlink_map[291]
    reaction = harness.feed(kind(0, 5_000_000, [60, 600, -60, 0], [16.0] * 4, [1.0] * 4), 1.0)
    assert isinstance(reaction.telemetry, RotorSpeeds)
    assert reaction.telemetry.speed == pytest.approx((6.2831853, 62.831853, -6.2831853, 0.0))


def test_specific_force_and_rates_are_forward_left_up(harness: PeerHarness) -> None:
    fields = [1.0, 2.0, -9.81, 0.1, 0.2, 0.3, *[0.0] * 7]
    reaction = harness.feed(mavlink.MAVLink_highres_imu_message(0, *fields, 63), 1.0)
    assert isinstance(reaction.telemetry, ImuSample)
    assert reaction.telemetry.specific_force_body == pytest.approx((1.0, -2.0, 9.81))
    assert reaction.telemetry.rate_body == pytest.approx((0.1, -0.2, -0.3))


def test_battery_and_outputs_are_read(harness: PeerHarness) -> None:
    cells = [4100, 4000, 3900, 65535, 65535, 65535, 65535, 65535, 65535, 65535]
    battery = harness.feed(
        mavlink.MAVLink_battery_status_message(0, 1, 1, 32767, cells, 1250, -1, -1, 80), 1.0
    ).telemetry
    assert isinstance(battery, BatterySample)
    assert (battery.voltage, battery.current, battery.remaining) == pytest.approx((12.0, 12.5, 0.8))
    assert harness.peer.status.battery_voltage == pytest.approx(12.0)
    outputs = harness.feed(
        mavlink.MAVLink_servo_output_raw_message(0, 0, 1100, 1200, 1300, 1400, 0, 0, 0, 0), 1.0
    ).telemetry
    assert isinstance(outputs, MotorOutputs)
    assert outputs.value[:4] == (1100.0, 1200.0, 1300.0, 1400.0)
    values = [0.1, 0.2, 0.3, 0.4] + [0.0] * 28
    outputs = harness.feed(mavlink.MAVLink_actuator_output_status_message(0, 0b1111, values), 1.0).telemetry
    assert isinstance(outputs, MotorOutputs)
    assert outputs.value == pytest.approx((0.1, 0.2, 0.3, 0.4))


def test_a_failsafe_is_observed_in_mode_and_state(harness: PeerHarness) -> None:
    harness.feed(mavlink.MAVLink_heartbeat_message(2, 12, 128, 6 << 16, 4, 3), 1.0)
    failsafe = mavlink.MAVLink_heartbeat_message(2, 12, 128, 4 << 16 | 5 << 24, mavlink.MAV_STATE_CRITICAL, 3)
    harness.feed(failsafe, 2.0)
    harness.feed(failsafe, 2.02)
    assert [event.name for event in harness.events][-2:] == ["vehicle_critical", "mode_changed"]
    assert "RTL" in harness.events[-2].text
    assert harness.peer.status.mode == "RTL"


def test_a_reboot_of_the_vehicle_is_published(harness: PeerHarness) -> None:
    for n in range(20):
        now = 10.0 + 0.1 * n
        harness.feed(mavlink.MAVLink_timesync_message(round((now + 500.0) * 1e9), round((now - 0.001) * 1e9)), now)
    assert harness.peer.clock.is_valid(12.0)
    harness.feed(mavlink.MAVLink_timesync_message(round(3.0 * 1e9), round(12.0 * 1e9)), 12.001)
    assert harness.events[-1].name == "clock_ran_backwards"
    assert not harness.peer.clock.is_valid(12.001)


def test_repeated_events_are_published_once_a_second(harness: PeerHarness) -> None:
    for n in range(250):
        harness.feed(odometry(frame_id=20), 5.0 + 0.01 * n)
    events = [event for event in harness.events if event.name == "estimate_frame_refused"]
    assert len(events) == 3
    assert events[1].repeats > 90


@given(st.text(alphabet=st.characters(min_codepoint=32, max_codepoint=126), max_size=400), st.integers(0, 7))
def test_texts_of_any_length_survive_the_chunks(text: str, severity: int) -> None:
    texts, assembler, packer = [], TextAssembler(), mavlink.MAVLink(None, 1, 1)
    for message in text_messages(text, severity, 17):
        (frame,) = FrameParser().feed(bytes(message.pack(packer)))
        texts += assembler.handle(frame.message, 1.0)
    assert [(each.text, each.severity) for each in texts] == [(text, severity)]


def test_a_text_with_a_lost_chunk_is_completed_by_a_mark() -> None:
    assembler = TextAssembler()
    messages = text_messages("a" * 50 + "b" * 50 + "c" * 10, 4, 3)
    for message in (messages[0], messages[2]):
        (frame,) = FrameParser().feed(bytes(message.pack(mavlink.MAVLink(None, 1, 1))))
        assert assembler.handle(frame.message, 1.0) == []
    assert assembler.expire(1.5) == []
    (text,) = assembler.expire(2.5)
    assert text.text == "a" * 50 + "[...]" + "c" * 10


def test_achieved_rates_are_measured(harness: PeerHarness) -> None:
    rate: Callable[[str, float], Any] = harness.peer.rates.rate
    for n in range(500):
        harness.feed(odometry(time_usec=n), 10.0 + 0.01 * n)
    measured = rate("ODOMETRY", 14.99)
    assert measured.rate == pytest.approx(100.0, abs=0.5)
    assert (measured.median, measured.p1, measured.p99) == pytest.approx((0.01, 0.01, 0.01))
    assert rate("ODOMETRY", 16.5).rate < 60.0
    assert rate("ODOMETRY", 30.0).rate == 0.0
    assert rate("HIGHRES_IMU", 15.0).count == 0


def frame_of(message_id: int, payload: bytes) -> bytes:
    """A frame of the vehicle with a right checksum, whatever is in it."""
    kind = mavlink.mavlink_map[message_id]
    header = bytes((len(payload), 0, 0, 0, 1, 1)) + message_id.to_bytes(3, "little")
    crc = x25crc(header + payload + bytes((kind.crc_extra,))).crc
    return bytes((0xFD,)) + header + payload + crc.to_bytes(2, "little")


HANDLED = [0, 1, 22, 30, 31, 32, 36, 77, 105, 111, 147, 245, 253, 291, 331, 345, 375, 436]
payloads = st.binary(min_size=1, max_size=255) | st.binary(min_size=4, max_size=8).map(lambda part: part * 30)


@given(st.lists(st.tuples(st.sampled_from(HANDLED), payloads, st.floats(0, 3)), max_size=30))
def test_no_contents_of_a_message_break_its_handling(messages: list[tuple[int, bytes, float]]) -> None:
    harness, now = PeerHarness(), 1.0
    for message_id, payload, pause in messages:
        now += pause
        (frame,) = FrameParser().feed(frame_of(message_id, payload))
        reaction = harness.peer.handle(frame, now)
        assert reaction.estimate is None or np.isfinite(reaction.estimate.state).all()
    assert np.isfinite(harness.peer.clock.offset(now))
