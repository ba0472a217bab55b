"""The mock signs and verifies as PX4 does, with pymavlink's own signing at the other end."""

from __future__ import annotations

from typing import Any

import pytest

from sitl_mock.wire.dialect import mavlink
from sitl_mock.wire.signing import ACCEPTED_UNSIGNED
from tests.support.bench import ARM, Bench

SECRET, OTHER = bytes(range(1, 33)), bytes(range(2, 34))
NOW = 40_000_000_000_000
PROVISIONED = NOW - 10**12  # months ago


class SignedBench(Bench):
    """A client that signs, beside an autopilot with a key; neither accepts what is unsigned."""

    def __init__(self, key: bytes | None = SECRET) -> None:
        super().__init__()
        self.mock.signing.set_key(SECRET, PROVISIONED)
        self.use_key(key)

    def use_key(self, key: bytes | None) -> None:
        """Sign with a key from now on. None: without a signature, and whatever comes is taken."""
        self._parser.signing = self._packer.signing
        self._packer.signing.secret_key, self._packer.signing.timestamp = key, NOW
        self._packer.signing.sign_outgoing = key is not None

    def arm(self) -> Any:
        """The acknowledgements of a command to arm."""
        before = len(self.of("COMMAND_ACK"))
        self.command(ARM, 1.0)
        self.run(0.1)
        return self.of("COMMAND_ACK")[before:]


def setup(secret: bytes, timestamp: int = NOW, *, system: int = 1) -> Any:
    return mavlink.MAVLink_setup_signing_message(system, 1, list(secret), timestamp)


def heartbeat() -> Any:
    return mavlink.MAVLink_heartbeat_message(18, 8, 0, 0, 4, 3)


def test_signed_commands_are_obeyed_and_answered_with_signatures() -> None:
    bench = SignedBench()
    bench.send(heartbeat())
    bench.run(2.0)  # heard from now on, since its timestamps continue from ours
    assert bench.arm()
    assert all(message.get_signed() for message in bench.of("COMMAND_ACK") + bench.of("HEARTBEAT"))
    assert bench.mock.commander.armed


@pytest.mark.parametrize("key", [None, OTHER], ids=["unsigned", "another key"])
def test_commands_that_are_not_signed_with_the_key_do_nothing(key: bytes | None) -> None:
    bench = SignedBench(key)
    assert not bench.arm()
    assert not bench.mock.commander.armed
    assert bench.link.bad_frames > 0


def test_a_command_that_is_sent_again_does_nothing() -> None:
    bench = SignedBench()
    bench.send(heartbeat())
    disarm = mavlink.MAVLink_command_long_message(1, 1, ARM, 0, 0.0, 0, 0, 0, 0, 0, 0).pack(bench._packer)
    bench.mock.receive(bench.link, "test", disarm)
    bench.run(0.1)
    answered = bench.link.bad_frames
    assert bench.arm()
    for sender in ("test", "stranger"):
        bench.mock.receive(bench.link, sender, disarm)
        bench.run(0.1)
        assert bench.mock.commander.armed
    assert bench.link.bad_frames == answered + 2


def test_a_forged_timestamp_locks_nobody_out() -> None:
    bench = SignedBench()
    forger = mavlink.MAVLink(None, 1, 191)
    forger.signing.secret_key, forger.signing.timestamp, forger.signing.sign_outgoing = OTHER, (1 << 48) - 2, True
    bench.mock.receive(bench.link, "stranger", heartbeat().pack(forger))
    assert bench.arm()


def test_what_px4_takes_unsigned_is_taken() -> None:
    bench = SignedBench(None)
    assert {mavlink.mavlink_map[number].msgname for number in ACCEPTED_UNSIGNED} == {
        "HEARTBEAT", "RADIO_STATUS", "ADSB_VEHICLE", "COLLISION"
    }  # fmt: skip
    assert bench.link.parse("client", heartbeat().pack(bench._packer))
    assert bench.link.bad_frames == 0


def test_a_key_is_set_up_changed_with_its_own_signature_and_removed_so() -> None:
    bench = Bench()
    mock, packer = bench.mock, bench._packer
    assert not mock.signing.is_active
    bench.send(setup(SECRET, system=2))  # for another vehicle
    assert not mock.signing.is_active
    bench.send(setup(SECRET))
    assert mock.signing.is_active
    for key in (None, OTHER):  # of a stranger
        packer.signing.secret_key, packer.signing.timestamp, packer.signing.sign_outgoing = key, NOW, key is not None
        bench.send(setup(OTHER))
        bench.send(setup(bytes(32), 0))
        assert mock.signing.is_active
    packer.signing.secret_key, packer.signing.timestamp, packer.signing.sign_outgoing = SECRET, NOW + 9, True
    bench.send(setup(bytes(32), 0))
    assert not mock.signing.is_active


def test_a_vehicle_that_is_armed_takes_no_key() -> None:
    bench = Bench()
    bench.command(ARM, 1.0)
    bench.run(0.1)
    assert bench.mock.commander.armed
    bench.send(setup(SECRET))
    assert not bench.mock.signing.is_active
