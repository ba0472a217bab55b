"""Transports: bytes over UDP, TCP or a serial line, with receives that block and sends that never do."""

from __future__ import annotations

import contextlib
import errno
import os
import select
import socket
import struct
import time
from typing import Protocol

import msgspec
import serial

from dynamics.errors import RequestError, VehicleError
from runtime.link.connection import Endpoint
from runtime.link.datagram import AnsweredEstimate, Datagram, ReadingThread
from runtime.link.vehicle_source import Address

PATIENCE = 0.05  # s that one receive waits
_MAX_READ = 65536
_TIMESPEC = struct.Struct("@ll")  # and timeval
_SO_TIMESTAMPNS = 35  # Linux; Python's socket module does not name it
_GONE = (errno.EIO, errno.ENODEV, errno.ENXIO, errno.EBADF, errno.ECONNRESET, errno.EPIPE, errno.ETIMEDOUT)
_SURVIVED = (errno.ECONNREFUSED, errno.ENETUNREACH, errno.EHOSTUNREACH, errno.ENETDOWN)


class Received(msgspec.Struct, frozen=True, gc=False):
    """Received bytes.

    time: of their arrival, s, monotonic; on UDP the kernel's, so that waiting for the processor counts as their age.
    source: the sender's address, None on a stream.
    answered: its estimate where a setpoint has answered that already.
    """

    data: bytes
    time: float
    source: Address | None = None
    answered: AnsweredEstimate | None = None


class TransportLostError(VehicleError):
    """The device or stream of a link is lost; opening it again may help."""


class Transport(Protocol):
    """The interface of UDP, TCP and serial lines for a link."""

    def receive(self, *, wait: bool = True) -> Received | None:
        """The next bytes, or None after PATIENCE, without `wait` at once. Raises TransportLostError."""

    def send(self, data: bytes) -> bool:
        """Pass bytes to the kernel without waiting. Returns whether it took them all."""

    def receive_other(self) -> Received | None:
        """The next datagram from elsewhere than the peer, once it keeps to it, or None; never waits."""

    def set_peer(self, source: Address | None) -> None:
        """Send from now on to the address that a packet came from."""

    def keep_to_peer(self) -> None:
        """Let the kernel keep what comes from elsewhere than the peer away from `receive`."""

    def close(self) -> None:
        """Close the socket or device."""


def open_transport(endpoint: Endpoint) -> Transport:
    """Open the socket or device of an endpoint.

    Raises VehicleError when it cannot be opened, RequestError for a host that does not exist.
    """
    match endpoint.kind:
        case "udpin" | "udpout":
            return UdpTransport(endpoint)
        case "tcpin" | "tcpout":
            return TcpTransport(endpoint)
        case "serial":
            return SerialTransport(endpoint)


class UdpTransport:
    """A UDP socket: bound, its peer the sender of what arrives (udpin), or with a fixed peer (udpout).

    Once it keeps to its peer, the socket is connected: the kernel gives it the peer's datagrams alone, with a buffer
    that nobody else fills, and all others go to a second socket on the same port.
    """

    def __init__(self, endpoint: Endpoint) -> None:
        self._family, self._address = _resolve(endpoint, socket.SOCK_DGRAM)
        self._socket = self._new_socket()
        self._others: socket.socket | None = None
        self._peer: Address | None = None
        if endpoint.kind == "udpin":
            try:
                self._socket.bind(self._address)
            except OSError as error:
                self._socket.close()
                raise _refused(endpoint, error) from None
        else:
            self._peer = self._address
        self._reader: ReadingThread | None = None
        self._view = memoryview(bytearray(_MAX_READ))
        self._buffers = [self._view]

    def _new_socket(self) -> socket.socket:
        new = socket.socket(self._family, socket.SOCK_DGRAM)
        # a blocking socket with a time limit in the kernel: one system call for each datagram, not two
        new.setsockopt(socket.SOL_SOCKET, socket.SO_RCVTIMEO, _TIMESPEC.pack(0, int(PATIENCE * 1e6)))
        new.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)
        new.setsockopt(socket.SOL_SOCKET, _SO_TIMESTAMPNS, 1)
        return new

    @property
    def port(self) -> int:
        """The local port."""
        return int(self._socket.getsockname()[1])

    def receive(self, *, wait: bool = True) -> Received | None:
        """The next datagram, or None after PATIENCE or when only an ICMP error came."""
        if self._reader is not None:
            return _received(self._reader.receive(PATIENCE if wait else 0.0))
        return self._receive(self._socket, 0 if wait else socket.MSG_DONTWAIT)

    @property
    def descriptor(self) -> int:
        """Of the socket; -1 before it keeps to its peer, or where a thread reads it already."""
        return -1 if self._others is None or self._reader is not None else self._socket.fileno()

    def read_by(self, reader: ReadingThread) -> None:
        """Let a thread read the socket from now on; it ends with the socket."""
        self._reader = reader

    def receive_other(self) -> Received | None:
        """The next datagram from elsewhere than the peer, once the socket keeps to it, or None."""
        return None if self._others is None else self._receive(self._others, socket.MSG_DONTWAIT)

    def _receive(self, source: socket.socket, flags: int) -> Received | None:
        try:
            length, ancillary, _, sender = source.recvmsg_into(self._buffers, 64, flags)
        except BlockingIOError:
            return None
        except OSError as error:
            if error.errno in _SURVIVED:
                return None
            raise TransportLostError(f"The UDP socket failed: {error.strerror}.") from None
        return Received(bytes(self._view[:length]), _arrival(ancillary), sender)

    def send(self, data: bytes) -> bool:
        """Send a datagram to the peer, if there is one yet."""
        if self._peer is None:
            return False
        try:
            return self._socket.sendto(data, socket.MSG_DONTWAIT, self._peer) == len(data)
        except OSError:
            return False

    def set_peer(self, source: Address | None) -> None:
        """Send from now on to this address."""
        if source is None or source == self._peer:
            return
        self._peer = source
        if self._others is not None:
            self._socket.connect(source)

    def keep_to_peer(self) -> None:
        """Connect the socket to the peer and open the one for others; without either, nothing changes."""
        if self._peer is None or self._others is not None:
            return
        others, shared = self._new_socket(), (self._socket,)
        try:
            # two sockets of one process may share a port while both allow it; nobody else may, before or after
            for each in (*shared, others):
                each.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEPORT, 1)
            others.bind(self._socket.getsockname())
            self._socket.connect(self._peer)
        except OSError:
            others.close()
            return
        finally:
            for each in shared:
                each.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEPORT, 0)
        others.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEPORT, 0)
        self._others = others

    def close(self) -> None:
        """Close the sockets."""
        if self._reader is not None:
            self._reader.close()
        self._socket.close()
        if self._others is not None:
            self._others.close()


class TcpTransport:
    """A TCP stream: connected to the vehicle (tcpout), or accepting its connections one after the other (tcpin)."""

    def __init__(self, endpoint: Endpoint) -> None:
        family, address = _resolve(endpoint, socket.SOCK_STREAM)
        self._listener: socket.socket | None = None
        self._stream: socket.socket | None = None
        try:
            if endpoint.kind == "tcpin":
                self._listener = socket.create_server(address[:2], family=family)
                self._listener.setblocking(False)
            else:
                self._adopt(socket.create_connection(address[:2], timeout=3.0))
        except OSError as error:
            raise _refused(endpoint, error) from None

    @property
    def port(self) -> int:
        """The local port."""
        open_socket = self._listener or self._stream
        return int(open_socket.getsockname()[1]) if open_socket is not None else 0

    def _adopt(self, stream: socket.socket) -> None:
        stream.setblocking(False)
        stream.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._stream = stream

    def receive(self, *, wait: bool = True) -> Received | None:
        """The next bytes of the stream, or None after PATIENCE or while no peer is connected."""
        source = self._stream or self._listener
        if source is None:
            raise TransportLostError("The TCP connection is closed.")
        if not _readable(source.fileno()).poll(PATIENCE * 1e3 if wait else 0):
            return None
        if self._stream is None:
            self._accept()
            return None
        try:
            data = self._stream.recv(_MAX_READ)
        except BlockingIOError:
            return None
        except OSError:
            data = b""
        if data:
            return Received(data, time.monotonic())
        self._stream.close()
        self._stream = None
        if self._listener is None:
            raise TransportLostError("The other end closed the TCP connection.")
        return None

    def _accept(self) -> None:
        if self._listener is not None:
            with contextlib.suppress(OSError):
                self._adopt(self._listener.accept()[0])

    def send(self, data: bytes) -> bool:
        """Send bytes if a peer is connected and the kernel takes them at once."""
        stream = self._stream
        try:
            return stream is not None and stream.send(data) == len(data)
        except OSError:
            return False

    def receive_other(self) -> Received | None:
        """None: a stream has one other end."""
        return None

    def keep_to_peer(self) -> None:
        """Nothing: a stream has one other end."""

    def set_peer(self, source: Address | None) -> None:
        """Nothing to do: a stream has one peer."""

    def close(self) -> None:
        """Close the stream and the listener."""
        for each in (self._stream, self._listener):
            if each is not None:
                each.close()
        self._stream = self._listener = None


class SerialTransport:
    """A serial line, written through its file descriptor so that a full buffer never blocks."""

    def __init__(self, endpoint: Endpoint) -> None:
        try:
            self._port = serial.Serial(endpoint.device, endpoint.baud, timeout=0, exclusive=True)
        except (serial.SerialException, ValueError) as error:
            raise _refused(endpoint, error) from None
        self._device, self._descriptor = endpoint.device, int(self._port.fileno())
        self._poll = _readable(self._descriptor)

    def receive(self, *, wait: bool = True) -> Received | None:
        """The bytes that have arrived, or None after PATIENCE. Raises TransportLostError once unplugged."""
        events = self._poll.poll(PATIENCE * 1e3 if wait else 0)
        if not events:
            return None
        try:
            data = os.read(self._descriptor, _MAX_READ)
        except BlockingIOError:
            return None
        except OSError as error:
            if error.errno not in _GONE:
                return None
            data = b""
        if not data:
            raise TransportLostError(f"{self._device} is gone: unplugged, or the vehicle lost power.")
        return Received(data, time.monotonic())

    def send(self, data: bytes) -> bool:
        """Write bytes if the line's buffer has room for them."""
        try:
            return os.write(self._descriptor, data) == len(data)
        except OSError:
            return False

    def receive_other(self) -> Received | None:
        """None: a stream has one other end."""
        return None

    def keep_to_peer(self) -> None:
        """Nothing: a stream has one other end."""

    def set_peer(self, source: Address | None) -> None:
        """Nothing to do: a line has one peer."""

    def close(self) -> None:
        """Close the device, present or not."""
        self._descriptor = -1  # the number may be that of another file soon, and the control thread may still send
        with contextlib.suppress(OSError, serial.SerialException):
            self._port.close()


def _received(datagram: Datagram | None) -> Received | None:
    """A datagram of the thread in C, None when only an ICMP error came. Raises TransportLostError."""
    if datagram is None or datagram.error in _SURVIVED:
        return None
    if datagram.error:
        raise TransportLostError(f"The UDP socket failed: {os.strerror(datagram.error)}.")
    return Received(datagram.data, datagram.received, datagram.address, datagram.answered)


def _readable(descriptor: int) -> select.poll:
    poll = select.poll()
    poll.register(descriptor, select.POLLIN)
    return poll


def _arrival(ancillary: list[tuple[int, int, bytes]]) -> float:
    """Monotonic time of arrival, s, from the kernel's wall-clock stamp of a datagram."""
    now = time.monotonic()
    for level, kind, data in ancillary:
        if level == socket.SOL_SOCKET and kind == _SO_TIMESTAMPNS and len(data) >= _TIMESPEC.size:
            seconds, nanoseconds = _TIMESPEC.unpack_from(data)
            age: float = (time.time_ns() - (seconds * 1_000_000_000 + nanoseconds)) * 1e-9
            if 0.0 <= age < 1.0:  # the wall clock may have been set in between
                return now - age
    return now


def _resolve(endpoint: Endpoint, kind: socket.SocketKind) -> tuple[socket.AddressFamily, Address]:
    try:
        family, _, _, _, address = socket.getaddrinfo(endpoint.host, endpoint.port, type=kind)[0]
    except OSError as error:
        raise RequestError(
            f"'{endpoint}': the host '{endpoint.host}' cannot be resolved ({error.strerror}). "
            "Give an address such as 192.168.1.10, or a name that this machine can resolve."
        ) from None
    return family, address


def _refused(endpoint: Endpoint, error: Exception) -> VehicleError:
    """The operating system's refusal in a user's words, with a remedy."""
    match getattr(error, "errno", None):
        case errno.EADDRINUSE:
            advice = (
                f"port {endpoint.port} is taken, usually by another `alula fly`, mavsdk_server, MAVROS, "
                f"mavlink-router or a ground station (`ss -lunp | grep {endpoint.port}` names it). "
                "Stop that one, or listen elsewhere: PX4 instance i sends to 14540 + i"
            )
        case errno.EADDRNOTAVAIL:
            advice = f"{endpoint.host} is no address of this machine. Listen on 0.0.0.0, or send there with udpout:"
        case errno.ECONNREFUSED:
            advice = "nobody listens there. Start the vehicle or simulator first, and check host and port"
        case errno.EACCES | errno.EPERM:
            advice = (
                "this user may not open it. Serial devices belong to the group dialout: "
                "`sudo usermod -aG dialout $USER`, then log in again; ports below 1024 need root"
            )
        case errno.ENOENT | errno.ENODEV | errno.ENXIO:
            present = ", ".join(sorted(_serial_devices())) or "none"
            advice = (
                f"there is no such device. Serial devices present: {present}. Plug the vehicle in and check the name"
            )
        case errno.EBUSY | errno.EAGAIN:
            advice = (
                f"another process holds it (`fuser {endpoint.device}` names it); ModemManager often does. Stop it first"
            )
        case _:
            advice = f"{error}. Check that the vehicle is on and reachable"
    return VehicleError(f"Cannot open the link {endpoint}: {advice}.")


def _serial_devices() -> list[str]:
    return [f"/dev/{name}" for name in os.listdir("/dev") if name.startswith(("ttyACM", "ttyUSB", "ttyAMA", "ttyTHS"))]
