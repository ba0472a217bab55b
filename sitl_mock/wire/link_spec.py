"""Connection strings of the mock: where a link goes, in pymavlink's and MAVSDK's spellings."""

from __future__ import annotations

from dataclasses import dataclass

from dynamics.errors import RequestError
from sitl_mock.wire.streams import Role
from sitl_mock.wire.transport import SerialTransport, TcpClientTransport, TcpServerTransport, Transport, UdpTransport

ONBOARD_PORTS, GCS_PORTS = (14580, 14540), (18570, 14550)
EXAMPLES = (
    "udpout:127.0.0.1:14540, udpin:0.0.0.0:14580, tcp:127.0.0.1:5760, tcpin:0.0.0.0:5760, serial:/dev/ttyS0:921600"
)
DEFAULT_BAUDRATE = 921_600


@dataclass(frozen=True, slots=True)
class LinkSpec:
    """A link as it is requested.

    scheme: udpout, udpin, tcp, tcpin or serial.
    host: address, or the serial device.
    number: port, or the baud rate.
    role: whose streams it carries.
    local_port: for udpout, 0 for any.
    """

    scheme: str
    host: str
    number: int
    role: Role = "onboard"
    local_port: int = 0

    @property
    def name(self) -> str:
        """The link's name in messages."""
        return f"{self.scheme}:{self.host}:{self.number}"

    def open(self) -> Transport:
        """The transport. Raises RequestError when a port is in use or a device cannot be opened."""
        address = (self.host, self.number)
        if self.scheme == "udpout":
            # what speaks to this machine alone hears this machine alone
            local = "127.0.0.1" if self.host in ("127.0.0.1", "localhost") else "0.0.0.0"
            return UdpTransport((local, self.local_port), address)
        if self.scheme == "udpin":
            return UdpTransport(address, None)
        if self.scheme == "tcpin":
            return TcpServerTransport(address)
        if self.scheme == "tcp":
            return TcpClientTransport(address)
        return SerialTransport(self.host, self.number)


def default_links(instance: int = 0) -> list[LinkSpec]:
    """PX4's two SITL links: 14580 to 14540 for companions, 18570 to 14550 for ground stations, plus the instance."""
    onboard = LinkSpec("udpout", "127.0.0.1", ONBOARD_PORTS[1] + instance, "onboard", ONBOARD_PORTS[0] + instance)
    gcs = LinkSpec("udpout", "127.0.0.1", GCS_PORTS[1] + instance, "gcs", GCS_PORTS[0] + instance)
    return [onboard, gcs]


def parse_link(text: str, role: Role = "onboard", instance: int = 0) -> LinkSpec:
    """A link from its connection string.

    udpout to PX4's own remote port comes from PX4's own local port; a fourth field names another local port.
    Raises RequestError for a string that is no link.
    """
    scheme, _, rest = text.partition(":")
    scheme = {"udp": "udpout", "tcpout": "tcp"}.get(scheme, scheme)
    rest = rest.removeprefix("//")
    if scheme == "serial":
        device, _, baud = rest.partition(":")
        return LinkSpec(scheme, device, _number(text, baud or str(DEFAULT_BAUDRATE), 1, 20_000_000), role)
    if scheme not in ("udpout", "udpin", "tcp", "tcpin"):
        raise RequestError(f"link {text!r}: wanted something like {EXAMPLES}.")
    host, _, ports = rest.partition(":")
    remote, _, local = ports.partition(":")
    if not host or (local and scheme != "udpout"):
        raise RequestError(f"link {text!r}: wanted something like {EXAMPLES}.")
    number = _number(text, remote, 0 if scheme in ("udpin", "tcpin") else 1, 65535)
    local_port = _number(text, local, 0, 65535) if local else _usual_local_port(number, role, instance)
    return LinkSpec(scheme, host, number, role, local_port if scheme == "udpout" else 0)


def _usual_local_port(remote: int, role: Role, instance: int) -> int:
    local, usual = ONBOARD_PORTS if role == "onboard" else GCS_PORTS
    return local + instance if remote == usual + instance else 0


def _number(text: str, digits: str, low: int, high: int) -> int:
    if not digits.isdigit() or not low <= int(digits) <= high:
        raise RequestError(f"link {text!r}: {digits!r} is no number from {low} to {high}. Examples: {EXAMPLES}.")
    return int(digits)
