"""Requests reach the autopilot one at a time, the newest first, and a refusal is remembered until one is confirmed."""

from __future__ import annotations

import queue
import threading

import pytest

from runtime.flight.engagement import AutopilotRequest
from runtime.link.commands import Confirmation
from runtime.request_worker import RequestWorker
from tests.support.deadline import wait_until

pytestmark = pytest.mark.realtime

REFUSED = Confirmation(False, ("denied",), "The vehicle refused mode OFFBOARD: denied.")


def test_only_the_newest_of_several_requests_is_carried_out() -> None:
    requests: queue.SimpleQueue[AutopilotRequest] = queue.SimpleQueue()
    carried_out: list[AutopilotRequest] = []
    over = threading.Event()

    def handle(request: AutopilotRequest) -> Confirmation:
        carried_out.append(request)
        return Confirmation(True)

    handlers = {request: (lambda request=request: handle(request)) for request in AutopilotRequest}
    for request in (AutopilotRequest.OFFBOARD, AutopilotRequest.OFFBOARD, AutopilotRequest.ARM):
        requests.put(request)
    worker = RequestWorker(requests, handlers, over.is_set)
    worker.start()
    wait_until(lambda: carried_out)
    over.set()
    assert worker.join(5.0)
    assert carried_out == [AutopilotRequest.ARM]


def test_a_refusal_stands_until_a_request_is_confirmed() -> None:
    requests: queue.SimpleQueue[AutopilotRequest] = queue.SimpleQueue()
    answers = {AutopilotRequest.OFFBOARD: REFUSED, AutopilotRequest.ARM: Confirmation(True)}
    over = threading.Event()
    handlers = {request: (lambda answer=answer: answer) for request, answer in answers.items()}
    worker = RequestWorker(requests, handlers, over.is_set)
    worker.start()
    requests.put(AutopilotRequest.OFFBOARD)
    wait_until(lambda: worker.refusal == REFUSED.reason)
    requests.put(AutopilotRequest.ARM)
    wait_until(lambda: not worker.refusal)
    assert not worker.join(0.0)
    over.set()
    assert worker.join(5.0)
