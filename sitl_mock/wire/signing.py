"""MAVLink 2 signing as PX4 does it: with a key all links sign, and accept little that is unsigned.

pymavlink signs and verifies; the rules around it are PX4's (docs.px4.io, MAVLink Message Signing). A vehicle has no
clock of its own: its timestamp is the one that came with the key, until a correctly signed frame brings a later one.
"""

from __future__ import annotations

import hashlib
from typing import Any

from dynamics.signing_key import KEY_BYTES
from sitl_mock.wire.dialect import Message, mavlink

ACCEPTED_UNSIGNED = frozenset(
    {
        mavlink.MAVLINK_MSG_ID_HEARTBEAT,
        mavlink.MAVLINK_MSG_ID_RADIO_STATUS,
        mavlink.MAVLINK_MSG_ID_ADSB_VEHICLE,
        mavlink.MAVLINK_MSG_ID_COLLISION,
    }
)
REFUSED = "Invalid signature"  # pymavlink's reason


class SignedParser(mavlink.MAVLink):  # type: ignore[misc]
    """pymavlink's parser, in which a forged frame moves no timestamp: PX4's C library looks at the signature first."""

    def check_signature(self, msgbuf: bytearray, srcSystem: int, srcComponent: int) -> bool:
        """Whether signature and timestamp are right."""
        expected = hashlib.sha256(self.signing.secret_key + msgbuf[:-6]).digest()[:6]
        return expected == msgbuf[-6:] and bool(super().check_signature(msgbuf, srcSystem, srcComponent))


class AutopilotSigning:
    """The key of an autopilot and what its links share of it.

    is_active: whether there is one.
    """

    def __init__(self) -> None:
        self.is_active = False
        self._secret: bytes | None = None
        self._timestamp = 0
        self._heard: dict[tuple[int, int, int], int] = {}
        self._links: list[Any] = []

    def add_link(self) -> Any:
        """Signing of a further link, for its packer and its parsers."""
        signing = mavlink.MAVLinkSigning()
        signing.link_id, signing.stream_timestamps = len(self._links), self._heard
        signing.allow_unsigned_callback = lambda _, number: number in ACCEPTED_UNSIGNED
        self._links.append(signing)
        self._provision(signing)
        return signing

    def set_key(self, secret: bytes, timestamp: int) -> None:
        """Sign with a key from now on, or no more where key and timestamp are 0. secret: 32 bytes."""
        self.is_active = any(secret) or timestamp > 0
        self._secret, self._timestamp = (secret, timestamp) if self.is_active else (None, 0)
        for signing in self._links:
            self._provision(signing)

    def handle_setup(self, message: Message) -> None:
        """Take the key of a SETUP_SIGNING."""
        self.set_key(bytes(message.secret_key).ljust(KEY_BYTES, b"\0"), message.initial_timestamp)

    def _provision(self, signing: Any) -> None:
        signing.secret_key, signing.timestamp = self._secret, self._timestamp
        signing.sign_outgoing = self.is_active
