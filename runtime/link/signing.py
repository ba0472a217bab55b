"""MAVLink 2 signing on a link: frames out are signed, frames in are judged (mavlink.io, Message Signing)."""

from __future__ import annotations

import ipaddress
import time
from hmac import compare_digest
from typing import Literal

import msgspec

from dynamics.errors import RequestError, VehicleError
from dynamics.signing_key import TICKS, SigningKey, signing_ticks
from runtime.link.connection import Endpoint
from runtime.link.dialect import Message, mavlink
from runtime.link.framing import Frame
from runtime.link.signing_clock import SigningClock, Stream, state_path
from runtime.link.telemetry import VehicleStatus

Verdict = Literal["unverified", "signed", "exempt", "unsigned", "wrong_key", "replayed", "outdated"]
ACCEPTED: tuple[Verdict, ...] = ("unverified", "signed", "exempt")
PATIENCE = 60 * TICKS  # by which the first timestamp of a stream may be behind
# a radio modem's report on itself, which has no key; nothing is flown by it
EXEMPT = frozenset((mavlink.MAVLINK_MSG_ID_RADIO_STATUS,))
REFUSALS: dict[Verdict, str] = {
    "unsigned": "is not signed",
    "wrong_key": "is signed with another key, or was changed on its way",
    "replayed": "was sent before: its timestamp is not above the last one of its stream",
    "outdated": "begins a stream with a timestamp more than a minute old",
}
TAKES_SIGNED_ALONE = "signs its messages and obeys signed ones alone. Give its key: --signing-key FILE."
MESSAGES_LINK, SETPOINTS_LINK = 0, 1  # link ids: one for each thread that sends, so that neither waits for the other


class SigningReport(msgspec.Struct, frozen=True):
    """The signatures of a link's frames.

    required: whether a key was given, without which no signature can be verified.
    autopilot_signs: whether the vehicle's frames are signed, None before it was heard.
    signed: verified. unsigned, wrong_key, replayed, outdated: refused. exempt: unsigned and accepted, RADIO_STATUS.
    lead: of our timestamps, s ahead of this computer's clock.
    """

    required: bool = False
    autopilot_signs: bool | None = None
    signed: int = 0
    unsigned: int = 0
    wrong_key: int = 0
    replayed: int = 0
    outdated: int = 0
    exempt: int = 0
    lead: float = 0.0


class Signing:
    """Signs and judges the frames of a link; without a key all are sent unsigned and accepted unverified.

    clock: of the timestamps, None without a key.
    counts: frames by verdict.
    signers: senders whose last frame carried a signature, whether it could be verified or not.
    """

    def __init__(self, key: SigningKey | None) -> None:
        self._key = key
        self.clock = None if key is None else SigningClock(state_path(key))
        self.counts: dict[Verdict, int] = {}
        self.signers: dict[tuple[int, int], bool] = {}
        self._streams: dict[Stream, int] = {} if self.clock is None else self.clock.heard

    @property
    def is_required(self) -> bool:
        """Whether only signed frames are accepted."""
        return self._key is not None

    def close(self) -> None:
        """Save where the timestamps ended."""
        if self.clock is not None:
            self.clock.close()

    def equip(self, packer: Message, link_id: int) -> None:
        """Let a packer sign all that it packs. packer: pymavlink's, of one thread at a time."""
        if self._key is not None:
            packer.signing.secret_key, packer.signing.link_id = self._key.secret, link_id
            packer.signing.sign_outgoing = True

    def stamp(self, packer: Message) -> None:
        """Give a packer the timestamp of its next frame; its own has gone on by one with the last."""
        if self.clock is not None:
            packer.signing.timestamp = max(packer.signing.timestamp, self.clock.now)

    def heard_from(self, vehicle: tuple[int, int]) -> dict[int, int]:
        """The newest timestamp of each of a vehicle's streams, by link id."""
        return {stream[2]: stamp for stream, stamp in tuple(self._streams.items()) if stream[:2] == vehicle}

    @property
    def secret(self) -> bytes:
        """The key, for what signs in place of a packer; empty without one."""
        return b"" if self._key is None else self._key.secret

    def judge(self, frame: Frame, vehicle: tuple[int, int] | None) -> Verdict:
        """Whether a frame may be used, counted. vehicle: system and component that is followed."""
        verdict = self._verdict(frame, vehicle)
        self.counts[verdict] = self.counts.get(verdict, 0) + 1
        return verdict

    def _verdict(self, frame: Frame, vehicle: tuple[int, int] | None) -> Verdict:
        sender = (frame.system, frame.component)
        if self._key is None or self.clock is None:
            self.signers[sender] = frame.is_signed
            return "unverified"
        if not frame.is_signed:
            # never of the vehicle itself, whose every message is a sign of life
            return "exempt" if frame.message_id in EXEMPT and sender != vehicle else "unsigned"
        data = frame.data
        if not compare_digest(self._key.signature(data[:-6]), data[-6:]):
            return "wrong_key"
        # from here on the sender holds the key: nobody else can add a stream or move a timestamp
        self.signers[sender] = True
        stream, timestamp = (*sender, data[-13]), int.from_bytes(data[-12:-6], "little")
        last = self._streams.get(stream)
        if last is None and timestamp + PATIENCE < self.clock.now:
            return "outdated"
        if last is not None and timestamp <= last:
            return "replayed"
        self._streams[stream] = timestamp
        self.clock.move_up_to(timestamp)
        return "signed"

    def report(self, vehicle: tuple[int, int] | None) -> SigningReport:
        """The counts so far. vehicle: system and component that is followed."""
        count = self.counts.get
        return SigningReport(
            required=self.is_required,
            autopilot_signs=None if vehicle is None else self.signers.get(vehicle, False),
            signed=count("signed", 0),
            unsigned=count("unsigned", 0),
            wrong_key=count("wrong_key", 0),
            replayed=count("replayed", 0),
            outdated=count("outdated", 0),
            exempt=count("exempt", 0),
            lead=0.0 if self.clock is None else self.clock.lead,
        )

    def require_common(self, vehicle: tuple[int, int] | None) -> None:
        """Raise VehicleError where the vehicle signs and there is no key: PX4 then obeys nothing that it is sent."""
        if not self.is_required and vehicle is not None and self.signers.get(vehicle):
            raise VehicleError(f"The autopilot {TAKES_SIGNED_ALONE} Nothing was sent to fly.")

    def setup_message(self, key: SigningKey, endpoint: Endpoint, status: VehicleStatus) -> Message:
        """SETUP_SIGNING for a vehicle, which carries the key itself, in the clear.

        Raises RequestError for an endpoint that is neither a serial line nor within this machine, VehicleError for a
        vehicle that is armed or was not heard.
        """
        if not is_private(endpoint):
            raise not_private(endpoint)
        if not status.is_known or status.armed:
            raise VehicleError("A signing key is set up in a vehicle that is heard and disarmed. Disarm it first.")
        timestamp = signing_ticks(time.time()) if self.clock is None else self.clock.now
        return mavlink.MAVLink_setup_signing_message(status.system, status.component, list(key.secret), timestamp)

    def explain_refusals(self) -> str:
        """Why frames were refused, with what to do, or an empty text."""
        count = {verdict: self.counts[verdict] for verdict in REFUSALS if self.counts.get(verdict)}
        if not count:
            return ""
        advice: dict[Verdict, str] = {
            "unsigned": "leave --signing-key out, or give the autopilot the key (alula link --setup-signing FILE)",
            "wrong_key": "give the key that the autopilot has",
            "replayed": "the autopilot has not heard this computer yet: let both send to each other",
        }
        advice["outdated"] = advice["replayed"]
        main = max(count, key=lambda verdict: count[verdict])
        listed = ", ".join(f"{number} {verdict.replace('_', ' ')}" for verdict, number in count.items())
        return f"Frames refused by --signing-key: {listed}. Then {advice[main]}."


def is_private(endpoint: Endpoint) -> bool:
    """Whether a key may be sent in the clear over an endpoint: a serial line, or addresses of this machine alone."""
    if endpoint.kind == "serial":
        return True
    host = endpoint.host.partition("%")[0]
    try:
        return host == "localhost" or ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False  # a name may stand for any address


def not_private(endpoint: Endpoint) -> RequestError:
    """The error for an endpoint that no key is sent over."""
    return RequestError(
        f"a signing key is sent in the clear, and {endpoint} may reach other machines. Connect the autopilot by USB "
        "and give --link serial:DEVICE; a simulated one is reached by udpin:127.0.0.1:PORT."
    )
