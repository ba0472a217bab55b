"""Streams are requested without waiting, one request at a time, and again only after a while."""

from __future__ import annotations

import threading
from collections.abc import Mapping

from runtime.stream_requests import REPEAT, StreamRequests
from tests.support.deadline import wait_until


def test_requests_do_not_wait_and_do_not_pile_up() -> None:
    requests: list[Mapping[str, float]] = []
    answered = threading.Event()

    def request(rates: Mapping[str, float]) -> None:
        requests.append(rates)
        answered.wait(10.0)

    streams = StreamRequests(request, {"ODOMETRY": 100.0})
    streams.send(0.0)
    streams.repeat(0.5 * REPEAT)
    streams.repeat(2.0 * REPEAT)  # the first is not answered yet
    answered.set()
    wait_until(lambda: (streams.repeat(3.0 * REPEAT), len(requests) == 2)[1])
    streams.repeat(3.5 * REPEAT)
    assert requests == [{"ODOMETRY": 100.0}] * 2
