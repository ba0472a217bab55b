"""A flood on the link: what is no frame keeps nobody waiting, and no datagram is lost between two batches."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import pytest
from pymavlink.dialects.v20 import development as mavlink

from runtime.link import link as link_module
from runtime.link.connection import Endpoint
from runtime.link.link import Link, LinkCallbacks, LinkSettings
from runtime.link.transport import Received
from tests.support.deadline import wait_until

pytestmark = pytest.mark.realtime


class FedTransport:
    """A transport on which datagrams lie ready whenever they are asked for."""

    def __init__(self, datagrams: Callable[[], bytes | None]) -> None:
        self._datagrams, self.sent = datagrams, 0

    def receive(self, *, wait: bool = True) -> Received | None:
        data = self._datagrams()
        if data is None and wait:
            time.sleep(0.001)  # as a socket waits
        return None if data is None else Received(data, time.monotonic(), ("127.0.0.1", 5))

    def send(self, data: bytes) -> bool:
        self.sent += 1
        return True

    def receive_other(self) -> Received | None:
        return None

    def set_peer(self, source: Any) -> None:
        """No address."""

    def keep_to_peer(self) -> None:
        """No address."""

    def close(self) -> None:
        """Nothing is open."""


def test_datagrams_without_a_frame_in_them_keep_the_link_from_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    """At 50,000 a second there is always another one."""
    ended: list[bool] = []
    transport = FedTransport(lambda: None if ended else b"\xfe\x05" * 10)
    monkeypatch.setattr(link_module, "open_transport", lambda _: transport)
    with Link(Endpoint("udpin", "127.0.0.1", 0), LinkSettings(heartbeat_period=0.01)):
        try:
            wait_until(lambda: transport.sent >= 5, 2.0)
        finally:
            ended.append(True)


def test_no_datagram_is_lost_between_two_batches(monkeypatch: pytest.MonkeyPatch) -> None:
    packer = mavlink.MAVLink(None, 1, 1)
    numbers = iter(range(500))

    def next_datagram() -> bytes | None:
        number = next(numbers, None)
        if number is None:
            return None
        return bytes(mavlink.MAVLink_debug_message(number, 0, 0.0).pack(packer))

    heard: list[int] = []
    transport = FedTransport(next_datagram)
    monkeypatch.setattr(link_module, "open_transport", lambda _: transport)
    callbacks = LinkCallbacks(message=lambda message, _: heard.append(message.time_boot_ms))
    with Link(Endpoint("udpin", "127.0.0.1", 0), callbacks=callbacks):
        wait_until(lambda: heard and heard[-1] == 499)
    assert heard == list(range(500))
