"""Byte transports under a link: UDP, TCP (either end) and serial, all non-blocking.

A transport loses what nobody reads: the vehicle never waits for its listeners.
"""

from __future__ import annotations

import contextlib
import errno
import os
import select
import socket
import time
from collections.abc import Hashable, Iterator
from typing import Protocol

import serial

from dynamics.errors import RequestError

MAX_READ = 4096  # bytes; the rest of a larger datagram is lost, as in PX4
PEER_MEMORY = 30.0  # s for which a UDP peer is sent to after its last datagram
MAX_PEERS = 8
RETRY_AFTER = 0.5  # s between two attempts at a lost TCP connection or serial port


class Transport(Protocol):
    """One end of a wire."""

    def filenos(self) -> list[int]:
        """File descriptors that become readable when something arrives."""

    def receive(self) -> Iterator[tuple[Hashable, bytes]]:
        """Bytes that have arrived, with their sender."""

    def send(self, frame: bytes) -> None:
        """Send to everyone at the other end."""

    def close(self) -> None:
        """Release the device or port."""


class UdpTransport:
    """A UDP socket that sends to a fixed remote end, if it has one, and to all peers that sent recently."""

    def __init__(self, local: tuple[str, int], remote: tuple[str, int] | None):
        self._remote = _resolved(remote) if remote is not None else None
        self._peers: dict[tuple[str, int], float] = {}
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        _bind(self._socket, local, "UDP")

    @property
    def port(self) -> int:
        """The local port."""
        return int(self._socket.getsockname()[1])

    def filenos(self) -> list[int]:
        """The socket's."""
        return [self._socket.fileno()]

    def receive(self) -> Iterator[tuple[Hashable, bytes]]:
        """Datagrams with their senders' addresses."""
        while True:
            try:
                data, address = self._socket.recvfrom(MAX_READ)
            except BlockingIOError:
                return
            except OSError:
                continue  # "port unreachable", brought back by an earlier send
            self._note(address)
            yield address, data

    def _note(self, address: tuple[str, int]) -> None:
        now = time.monotonic()
        if address != self._remote and (address in self._peers or len(self._peers) < MAX_PEERS):
            self._peers[address] = now
        for peer in [peer for peer, last in self._peers.items() if now - last > PEER_MEMORY]:
            del self._peers[peer]

    def send(self, frame: bytes) -> None:
        """Send a datagram to the remote end and to every peer."""
        for address in ([self._remote] if self._remote else []) + list(self._peers):
            with contextlib.suppress(OSError):
                self._socket.sendto(frame, address)

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()


class TcpServerTransport:
    """A listening TCP socket with any number of clients."""

    def __init__(self, local: tuple[str, int]):
        self._clients: dict[int, socket.socket] = {}
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        self._socket.setblocking(False)
        _bind(self._socket, local, "TCP")
        self._socket.listen(8)

    @property
    def port(self) -> int:
        """The local port."""
        return int(self._socket.getsockname()[1])

    def filenos(self) -> list[int]:
        """The listener's and every client's."""
        return [self._socket.fileno(), *self._clients]

    def receive(self) -> Iterator[tuple[Hashable, bytes]]:
        """Bytes with the client they came from."""
        with contextlib.suppress(OSError):
            client, _ = self._socket.accept()
            client.setblocking(False)
            client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            self._clients[client.fileno()] = client
        for number, client in list(self._clients.items()):
            data = _read(client)
            if data is None:
                self._drop(number)
            elif data:
                yield number, data

    def send(self, frame: bytes) -> None:
        """Send to every client; one that does not read loses its connection, as a full buffer would garble it."""
        for number, client in list(self._clients.items()):
            if not _write(client, frame):
                self._drop(number)

    def _drop(self, number: int) -> None:
        self._clients.pop(number).close()

    def close(self) -> None:
        """Close the listener and all clients."""
        for number in list(self._clients):
            self._drop(number)
        self._socket.close()


class TcpClientTransport:
    """A TCP connection that is made, and made again, to a listening companion."""

    def __init__(self, remote: tuple[str, int]):
        self._remote = _resolved(remote)
        self._socket: socket.socket | None = None
        self._pending: socket.socket | None = None
        self._try_at = 0.0

    def filenos(self) -> list[int]:
        """The socket's while connected."""
        self._connect()
        return [self._socket.fileno()] if self._socket else []

    def _connect(self) -> None:
        if self._socket is not None:
            return
        if self._pending is None and time.monotonic() >= self._try_at:
            self._try_at = time.monotonic() + RETRY_AFTER
            self._pending = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
            self._pending.setblocking(False)
            self._pending.connect_ex(self._remote)
        if self._pending is not None and select.select([], [self._pending], [], 0)[1]:
            self._take_pending(self._pending)

    def _take_pending(self, pending: socket.socket) -> None:
        self._pending = None
        if pending.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR):
            pending.close()
            return
        pending.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._socket = pending

    def receive(self) -> Iterator[tuple[Hashable, bytes]]:
        """Bytes from the remote end."""
        if self._socket is None:
            return
        data = _read(self._socket)
        if data is None:
            self.close()
        elif data:
            yield "tcp", data

    def send(self, frame: bytes) -> None:
        """Send if connected."""
        if self._socket is not None and not _write(self._socket, frame):
            self.close()

    def close(self) -> None:
        """Close the connection; the next pass tries again."""
        for handle in (self._socket, self._pending):
            if handle is not None:
                handle.close()
        self._socket = self._pending = None


class SerialTransport:
    """A serial port; one that is unplugged is reopened when it returns."""

    def __init__(self, device: str, baudrate: int):
        self._device, self._baudrate = device, baudrate
        self._try_at = 0.0
        self._port: serial.Serial | None = None
        try:
            self._open()
        except (OSError, serial.SerialException) as error:
            raise RequestError(
                f"cannot open the serial port {device} at {baudrate} baud: {error}. "
                "Check the device and that no other program holds it."
            ) from error

    def _open(self) -> None:
        self._port = serial.Serial(self._device, self._baudrate, timeout=0, write_timeout=0)

    def filenos(self) -> list[int]:
        """The port's while it is open."""
        if self._port is None and time.monotonic() >= self._try_at:
            self._try_at = time.monotonic() + RETRY_AFTER
            with contextlib.suppress(OSError, serial.SerialException):
                self._open()
        return [self._port.fileno()] if self._port else []

    def receive(self) -> Iterator[tuple[Hashable, bytes]]:
        """Bytes that have arrived."""
        if self._port is None:
            return
        try:
            data = os.read(self._port.fileno(), MAX_READ)
        except BlockingIOError:
            return
        except OSError:
            self.close()
            return
        if data:
            yield "serial", data

    def send(self, frame: bytes) -> None:
        """Write what the port takes at once; a full port loses the frame, as a slow radio does."""
        if self._port is None:
            return
        try:
            os.write(self._port.fileno(), frame)
        except BlockingIOError:
            pass
        except OSError:
            self.close()

    def close(self) -> None:
        """Close the port."""
        if self._port is not None:
            with contextlib.suppress(OSError):
                self._port.close()
            self._port = None


def _resolved(address: tuple[str, int]) -> tuple[str, int]:
    try:
        return socket.gethostbyname(address[0]), address[1]
    except OSError as error:
        raise RequestError(f"host {address[0]!r} is not known: {error}. Give an IP address.") from error


def _bind(handle: socket.socket, local: tuple[str, int], kind: str) -> None:
    try:
        handle.bind(local)
    except OSError as error:
        handle.close()
        if error.errno == errno.EADDRINUSE:
            raise RequestError(
                f"{kind} port {local[1]} is in use, probably by another autopilot or mock. "
                "Stop that one, or start this one with --instance 1 or another --link."
            ) from error
        raise RequestError(f"cannot listen on {local[0]}:{local[1]} ({kind}): {error}.") from error


def _read(handle: socket.socket) -> bytes | None:
    """The bytes that have arrived, b"" for none; None at the end of the connection."""
    try:
        return handle.recv(MAX_READ) or None
    except BlockingIOError:
        return b""
    except OSError:
        return None


def _write(handle: socket.socket, frame: bytes) -> bool:
    """Whether the frame was sent in full."""
    try:
        return handle.send(frame) == len(frame)
    except OSError:
        return False
