"""The wire's faults: what they take, delay or double."""

from __future__ import annotations

from sitl_mock.wire.dialect import mavlink
from sitl_mock.wire.link import Link


def test_a_frame_that_was_put_back_does_not_pass_a_link_that_is_down() -> None:
    link = Link("test", "onboard", 1, frozenset())
    link.fault.reorder = 1.0
    link.send(1.0, mavlink.MAVLink_debug_message(0, 0, 1.0))
    assert link.take(1.0) == []
    link.fault.down = True
    assert link.take(2.0) == []
    link.fault.down, link.fault.reorder = False, 0.0
    link.send(3.0, mavlink.MAVLink_debug_message(0, 0, 2.0))
    assert len(link.take(3.0)) == 1
