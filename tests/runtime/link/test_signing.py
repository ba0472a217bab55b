"""MAVLink 2 signing of the link, with pymavlink's own as the judge in both directions."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from pymavlink.dialects.v20 import development as mavlink

from dynamics.errors import RequestError, VehicleError
from dynamics.signing_key import TICKS, SigningKey, signing_ticks
from runtime.link.connection import parse_endpoint
from runtime.link.framing import Frame, FrameParser
from runtime.link.link import Link, LinkCallbacks, LinkSettings
from runtime.link.signing import Signing, Verdict, is_private
from runtime.link.telemetry import LinkEvent, VehicleStatus
from runtime.link.transport import UdpTransport
from tests.support.deadline import wait_until
from tests.support.fake_vehicle import FakeVehicle, odometry

SECRET, OTHER = bytes(range(1, 33)), bytes(range(2, 34))
KEY = SigningKey(SECRET)
VEHICLE = (1, 1)


@pytest.fixture(autouse=True)
def state(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A state folder of this test's own."""
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    return tmp_path / "state"


@pytest.fixture
def signing() -> Iterator[Signing]:
    with closing(Signing(KEY)) as each:
        yield each


@contextmanager
def closing(signing: Signing) -> Iterator[Signing]:
    try:
        yield signing
    finally:
        signing.close()


def now() -> int:
    return signing_ticks(time.time())


def signer(secret: bytes | None = SECRET, timestamp: int | None = None, link_id: int = 0, component: int = 1) -> Any:
    """pymavlink's packer of a vehicle. secret: None for frames without a signature."""
    mav = mavlink.MAVLink(None, 1, component)
    mav.signing.secret_key, mav.signing.link_id = secret, link_id
    mav.signing.timestamp = now() if timestamp is None else timestamp
    mav.signing.sign_outgoing = secret is not None
    return mav


def verifier(secret: bytes = SECRET) -> Any:
    """pymavlink's parser of a system with a key, which accepts nothing unsigned."""
    mav = mavlink.MAVLink(None)
    mav.signing.secret_key, mav.signing.timestamp = secret, now()
    return mav


def heartbeat() -> Any:
    return mavlink.MAVLink_heartbeat_message(2, 12, 0, 0, 3, 3)


def frame_of(data: bytes) -> Frame:
    (frame,) = FrameParser().feed(data)
    return frame


def judged_by_pymavlink(data: bytes, judge: Any) -> bool:
    try:
        return bool(judge.decode(bytearray(data)))
    except mavlink.MAVError:
        return False


def with_checksum(data: bytearray) -> bytes:
    """A signed heartbeat that was changed, with the checksum of its new content, as anybody can write it."""
    crc = mavlink.x25crc(data[1:-15])
    crc.accumulate(bytes([heartbeat().crc_extra]))
    data[-15:-13] = crc.crc.to_bytes(2, "little")
    return bytes(data)


def tampered(data: bytes) -> dict[str, bytes]:
    """A signed heartbeat with one thing changed."""
    places = {"payload": 10, "sequence": 4, "system": 5, "component": 6}
    frames = {name: bytearray(data) for name in (*places, "link id", "timestamp", "signature")}
    for name, place in places.items():
        frames[name][place] ^= 1
    frames["link id"][-13] ^= 1
    frames["timestamp"][-12] ^= 1
    frames["signature"][-1] ^= 1
    return {name: with_checksum(frame) for name, frame in frames.items()}


@pytest.mark.parametrize("message", [heartbeat(), odometry(), mavlink.MAVLink_statustext_message(6, b"text")])
def test_what_pymavlink_signs_is_accepted(message: Any, signing: Signing) -> None:
    mav = signer()
    for _ in range(3):
        assert signing.judge(frame_of(message.pack(mav)), VEHICLE) == "signed"
    assert signing.report(VEHICLE).autopilot_signs


def test_frames_that_are_changed_signed_otherwise_sent_again_or_unsigned_are_refused_by_both(signing: Signing) -> None:
    judge, packer = verifier(), signer()
    data = bytes(heartbeat().pack(packer))
    forged = {name: ("wrong_key", each) for name, each in tampered(data).items()}
    forged["other key"] = ("wrong_key", bytes(heartbeat().pack(signer(OTHER))))
    forged["unsigned"] = ("unsigned", bytes(heartbeat().pack(signer(None))))
    forged["version 1"] = ("unsigned", bytes(heartbeat().pack(signer(None), force_mavlink1=True)))
    for name, (verdict, each) in forged.items():
        assert signing.judge(frame_of(each), VEHICLE) == verdict, name
        assert not judged_by_pymavlink(each, verifier()), name
    assert signing.judge(frame_of(data), VEHICLE) == "signed"
    assert judged_by_pymavlink(data, judge)
    assert signing.judge(frame_of(data), VEHICLE) == "replayed"
    assert not judged_by_pymavlink(data, judge)


AGES: list[tuple[float, Verdict]] = [(0.0, "signed"), (55.0, "signed"), (65.0, "outdated"), (1e8, "outdated")]


@pytest.mark.parametrize(("age", "verdict"), AGES)
def test_a_stream_begins_with_a_timestamp_of_the_last_minute(age: float, verdict: Verdict, signing: Signing) -> None:
    data = bytes(heartbeat().pack(signer(timestamp=now() - int(age * TICKS))))
    assert signing.judge(frame_of(data), VEHICLE) == verdict
    assert judged_by_pymavlink(data, verifier()) == (verdict == "signed")


def test_each_link_of_each_component_has_timestamps_of_its_own(signing: Signing) -> None:
    start = now()
    for link_id, component in ((0, 1), (1, 1), (0, 2)):
        for offset, verdict in ((5, "signed"), (4, "replayed"), (5, "replayed"), (6, "signed")):
            packer = signer(timestamp=start + offset, link_id=link_id, component=component)
            assert signing.judge(frame_of(heartbeat().pack(packer)), VEHICLE) == verdict


def test_a_forged_frame_moves_no_timestamp(signing: Signing) -> None:
    vehicle = signer()
    far = bytes(heartbeat().pack(signer(OTHER, timestamp=(1 << 48) - 2)))
    assert signing.judge(frame_of(far), VEHICLE) == "wrong_key"
    assert signing.judge(frame_of(heartbeat().pack(vehicle)), VEHICLE) == "signed"
    assert signing.clock is not None
    assert abs(signing.clock.now - now()) < 10 * TICKS


def test_a_radio_s_report_alone_may_be_unsigned_and_not_under_the_vehicle_s_ids(signing: Signing) -> None:
    report = mavlink.MAVLink_radio_status_message(200, 200, 100, 50, 50, 0, 0)
    radio, vehicle = mavlink.MAVLink(None, 51, 68), mavlink.MAVLink(None, 1, 1)
    assert signing.judge(frame_of(report.pack(radio)), VEHICLE) == "exempt"
    assert signing.judge(frame_of(report.pack(vehicle)), VEHICLE) == "unsigned"
    for message in (heartbeat(), odometry(), mavlink.MAVLink_statustext_message(6, b"text")):
        assert signing.judge(frame_of(message.pack(radio)), VEHICLE) == "unsigned"


def test_what_was_heard_is_refused_after_a_restart(signing: Signing) -> None:
    recorded = [frame_of(heartbeat().pack(mav)) for mav in [signer()] for _ in range(5)]
    assert {signing.judge(frame, VEHICLE) for frame in recorded} == {"signed"}
    signing.close()
    with closing(Signing(KEY)) as restarted:
        assert {restarted.judge(frame, VEHICLE) for frame in recorded} == {"replayed"}


# --- a link


def open_link(key: SigningKey | None = KEY, callbacks: LinkCallbacks | None = None, **settings: Any) -> Link:
    return Link(parse_endpoint("udpin:127.0.0.1:0"), LinkSettings(signing_key=key, **settings), callbacks)


def address_of(link: Link) -> tuple[str, int]:
    assert isinstance(link.transport, UdpTransport)
    return "127.0.0.1", link.transport.port


@pytest.mark.realtime
def test_pymavlink_accepts_all_that_the_link_sends_from_every_thread() -> None:
    """The vehicle refuses what is unsigned or older than what came before, within each stream."""
    with (
        open_link(gcs_heartbeat=True, heartbeat_period=0.05, timesync_period=0.01) as link,
        FakeVehicle(address_of(link), key=SECRET, timestamp=now()) as vehicle,
    ):
        link.wait_for_vehicle(5.0)
        for sent in range(0, 300, 30):  # a burst of all is more than a socket holds of a vehicle that does not run yet
            for number in range(30):
                assert link.send_rate_setpoint((0.0, 0.0, 0.0), 0.5)
                if number % 3 == 0:
                    link.send_text("text")
            wait_until(lambda sent=sent: vehicle.count("SET_ATTITUDE_TARGET") == sent + 30)
        assert vehicle.mav.signing.badsig_count == vehicle.mav.signing.reject_count == 0
        assert vehicle.mav.signing.goodsig_count == len(vehicle.received)
        # a link id for each thread: under one, a stamp that is overtaken on its way to the socket is a replay
        assert {each.get_link_id() for each in vehicle.received if each.get_type() == "SET_ATTITUDE_TARGET"} == {1}
        assert {each.get_link_id() for each in vehicle.received if each.get_type() != "SET_ATTITUDE_TARGET"} == {0}
        assert {"HEARTBEAT", "TIMESYNC", "STATUSTEXT"} <= {message.get_type() for message in vehicle.received}


@pytest.mark.realtime
def test_a_vehicle_without_a_clock_is_heard_once_it_has_heard_us() -> None:
    """PX4 begins with the timestamp of the day on which it got its key, and cannot be believed before it hears ours."""
    with open_link() as link, FakeVehicle(address_of(link), key=SECRET, timestamp=now() - 10**9) as vehicle:
        link.wait_for_vehicle(5.0)
        for _ in range(50):  # a heartbeat of the other thread that was signed later may arrive before one
            vehicle.send_odometry(x=1.0)
            if link.wait_for_estimate(None, time.monotonic() + 0.1) is not None:
                break
        assert link.estimate is not None
        assert link.signing.counts["outdated"] >= 1


@pytest.mark.realtime
def test_frames_that_arrive_together_are_judged_in_the_order_in_which_they_were_signed() -> None:
    """The link handles estimates first, whatever else a burst begins with."""
    with open_link() as link, FakeVehicle(address_of(link), key=SECRET, timestamp=now()) as vehicle:
        link.wait_for_vehicle(5.0)
        vehicle.sends = False
        accepted = link.signing.counts["signed"]
        burst = signer(timestamp=vehicle.mav.signing.timestamp + TICKS)
        vehicle.send_bytes(b"".join(message.pack(burst) for message in (heartbeat(), heartbeat(), odometry())))
        wait_until(lambda: link.estimate is not None)
        wait_until(lambda: sum(link.signing.counts.values()) >= accepted + 3)
        assert link.signing.report(link.peer.address).replayed == 0


@pytest.mark.realtime
def test_strangers_neither_move_nor_stop_a_signed_flight() -> None:
    frames: list[bytes] = []
    events: list[LinkEvent] = []

    def keep(direction: str, _: float, data: bytes) -> None:
        frames.append(data)

    callbacks = LinkCallbacks(frame=keep, event=events.append)
    with open_link(callbacks=callbacks) as link:
        target = address_of(link)
        # the first to speak is the stranger, unsigned and with another key: he fixes no address
        with FakeVehicle(target), FakeVehicle(target, key=OTHER, timestamp=now()):
            wait_until(lambda: link.signing.counts.get("unsigned", 0) > 3 and link.signing.counts["wrong_key"] > 3)
            assert link.peer.address is None
            with FakeVehicle(target, key=SECRET, timestamp=now()) as vehicle:
                vehicle.armed = True
                link.wait_for_vehicle(5.0)
                assert link.source.address == vehicle.socket.getsockname()
                # the vehicle's own address is forged, too: from its socket, without its key
                for kind in (heartbeat(), odometry(x=7.0)):
                    for mav in (mavlink.MAVLink(None, 1, 1), signer(OTHER)):
                        vehicle.send_bytes(kind.pack(mav))
                vehicle.send_odometry(x=1.0)
                estimate = link.wait_for_estimate(None, time.monotonic() + 5.0)
                assert estimate is not None
                assert estimate.position_world[1] == pytest.approx(1.0)
                wait_until(lambda: link.status.armed)
                assert link.source.address == vehicle.socket.getsockname()
    names = [event.name for event in events]
    assert names.count("unsigned_frame") == names.count("wrong_key_frame") == 1
    assert all(frame[2] & 1 for frame in frames)  # what is refused is not recorded


@pytest.mark.realtime
@pytest.mark.parametrize(("key", "text"), [(None, "unsigned"), (OTHER, "wrong key")], ids=["none", "other"])
def test_a_vehicle_that_signs_otherwise_is_not_found_and_the_error_says_why(key: bytes | None, text: str) -> None:
    with open_link() as link, FakeVehicle(address_of(link), key=key, timestamp=now()):
        wait_until(lambda: link.signing.counts)
        with pytest.raises(VehicleError, match=rf"refused by --signing-key: \d+ {text}"):
            link.wait_for_vehicle(0.2)


@pytest.mark.realtime
def test_a_vehicle_that_signs_is_not_flown_without_a_key() -> None:
    with open_link(None) as link, FakeVehicle(address_of(link), key=SECRET, timestamp=now()):
        link.wait_for_vehicle(5.0)
        with pytest.raises(VehicleError, match="--signing-key FILE"):
            link.signing.require_common(link.peer.address)


@pytest.mark.realtime
def test_a_key_that_passes_the_link_is_neither_recorded_nor_passed_on() -> None:
    passed: list[Any] = []

    def keep(_: str, __: float, data: bytes) -> None:
        passed.append(data)

    def note(message: Any, _: float) -> None:
        passed.append(repr(message).encode())

    with (
        open_link(None, LinkCallbacks(frame=keep, message=note)) as link,
        FakeVehicle(address_of(link)) as vehicle,
        link.listening(lambda message: passed.append(repr(message).encode())),
    ):
        link.wait_for_vehicle(5.0)
        link.send_signing_setup(KEY)
        vehicle.send(mavlink.MAVLink_setup_signing_message(1, 191, list(SECRET), 0))
        wait_until(lambda: vehicle.count("SETUP_SIGNING") == 1)
        sent = next(message for message in vehicle.received if message.get_type() == "SETUP_SIGNING")
        assert bytes(sent.secret_key) == SECRET
        assert (sent.target_system, sent.target_component) == VEHICLE
        before = link.parser.frames
        wait_until(lambda: link.parser.frames > before + 2)
    assert not any(SECRET in data or str(list(SECRET))[1:20].encode() in data for data in passed)
    assert SECRET.hex() not in repr(link.settings)


PRIVATE = [
    "serial:/dev/ttyACM0",
    "udpin:127.0.0.1:14540",
    "udpout:127.0.0.1:14580",
    "tcp:localhost:5760",
    "udpin:[::1]:1",
]
PUBLIC = ["udpin:0.0.0.0:14540", "udpin:14540", "udpout:192.168.1.10:14580", "tcp:drone.local:5760", "udpin:[::]:14540"]


@pytest.mark.parametrize(
    ("text", "private"), [*((text, True) for text in PRIVATE), *((text, False) for text in PUBLIC)]
)
def test_a_key_is_sent_only_where_nobody_else_listens(text: str, private: bool) -> None:
    endpoint = parse_endpoint(text)
    assert is_private(endpoint) == private
    status = VehicleStatus(system=1, component=1)
    with closing(Signing(None)) as signing:
        if private:
            assert signing.setup_message(KEY, endpoint, status).get_type() == "SETUP_SIGNING"
        else:
            with pytest.raises(RequestError, match="in the clear"):
                signing.setup_message(KEY, endpoint, status)


def test_no_key_is_sent_to_a_vehicle_that_is_armed_or_unknown() -> None:
    endpoint = parse_endpoint("udpin:127.0.0.1:14540")
    with closing(Signing(None)) as signing:
        for status in (VehicleStatus(system=1, component=1, armed=True), VehicleStatus()):
            with pytest.raises(VehicleError, match="disarmed"):
                signing.setup_message(KEY, endpoint, status)
