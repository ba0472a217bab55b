"""Connection strings: the address of a vehicle, in our spelling, MAVSDK's or pymavlink's."""

from __future__ import annotations

import re
from typing import Literal

import msgspec

from dynamics.errors import RequestError

Kind = Literal["udpin", "udpout", "tcpin", "tcpout", "serial"]

PX4_OFFBOARD_PORT = 14540
DEFAULT_BAUD = 921600
ACCEPTED = (
    "udpin:0.0.0.0:14540 (listen), udpout:192.168.1.10:14580 (send first), tcp:127.0.0.1:5760 or tcpin:0.0.0.0:5760, "
    "serial:/dev/ttyACM0:921600; MAVSDK's udpin://0.0.0.0:14540 and serial:///dev/ttyACM0:57600 "
    "and pymavlink's udp:127.0.0.1:14540 and /dev/ttyACM0,57600 are accepted as well"
)
_KINDS: dict[str, Kind] = {
    "udp": "udpin",  # both MAVSDK and pymavlink listen on it
    "udpin": "udpin",
    "udpout": "udpout",
    "udpbcast": "udpout",
    "tcp": "tcpout",
    "tcpout": "tcpout",
    "tcpin": "tcpin",
    "serial": "serial",
}
_SCHEME = re.compile(r"(?P<scheme>[A-Za-z_]+):(//)?(?P<rest>.*)", re.DOTALL)
_HOST_AND_PORT = re.compile(r"(?P<host>\[[0-9A-Fa-f:.%]+\]|[^:\[\]/\s]*)(:(?P<port>\d+))?/?")
_DEVICE_AND_BAUD = re.compile(r"(?P<device>[^,:\s]+?)([,:](?P<baud>\d+))?")


class Endpoint(msgspec.Struct, frozen=True):
    """One end of a link: a socket address (host, port), or a serial device with its baud rate."""

    kind: Kind
    host: str = ""
    port: int = 0
    device: str = ""
    baud: int = DEFAULT_BAUD

    def __str__(self) -> str:
        if self.kind == "serial":
            return f"serial:{self.device}:{self.baud}"
        host = f"[{self.host}]" if ":" in self.host else self.host
        return f"{self.kind}:{host}:{self.port}"


def parse_endpoint(text: str) -> Endpoint:
    """The endpoint that a connection string names.

    text: any spelling listed in ACCEPTED. Raises RequestError for everything else.
    """
    stripped = text.strip()
    if stripped.startswith("/dev/") or re.fullmatch(r"COM\d+([,:]\d+)?", stripped):
        return _serial_endpoint(text, stripped)
    match = _SCHEME.fullmatch(stripped)
    if match is None or match["scheme"].lower() not in _KINDS:
        raise _refusal(text, "it does not start with a kind of connection")
    kind = _KINDS[match["scheme"].lower()]
    if kind == "serial":
        return _serial_endpoint(text, match["rest"])
    return _socket_endpoint(text, kind, match["rest"])


def _socket_endpoint(text: str, kind: Kind, rest: str) -> Endpoint:
    match = _HOST_AND_PORT.fullmatch(rest)
    if match is None:
        raise _refusal(text, f"'{rest}' is not host:port")
    host, listens = match["host"].strip("[]"), kind in ("udpin", "tcpin")
    if not host and not listens:
        raise _refusal(text, f"{kind} needs the host to send to")
    if match["port"] is None and kind != "udpin":
        raise _refusal(text, "the port is missing")
    port = int(match["port"] or PX4_OFFBOARD_PORT)
    if not (0 if listens else 1) <= port <= 65535:
        raise _refusal(text, f"port {port} is not within 1 to 65535")
    return Endpoint(kind, host=host or "0.0.0.0", port=port)


def _serial_endpoint(text: str, rest: str) -> Endpoint:
    match = _DEVICE_AND_BAUD.fullmatch(rest)
    if match is None:
        raise _refusal(text, f"'{rest}' is not device:baud")
    baud = int(match["baud"] or DEFAULT_BAUD)
    if baud == 0:
        raise _refusal(text, "a baud rate of 0 carries nothing")
    return Endpoint("serial", device=match["device"], baud=baud)


def _refusal(text: str, reason: str) -> RequestError:
    return RequestError(f"'{text}' is not a link: {reason}. Give one of: {ACCEPTED}.")
