"""Which message is due when: PX4's default rates, its interval command and its 4 ms quantisation."""

from __future__ import annotations

import math
import random
from dataclasses import dataclass, field
from typing import Literal

from sitl_mock.wire.dialect import EscInfo, EscStatus, mavlink

Role = Literal["onboard", "gcs"]

STEP = 0.004  # s, the period of PX4's mavlink loop as measured
TOLERANCE = 0.0006  # s by which PX4 sends early rather than a whole loop late: 0.3 of its own 2 ms loop delay

_M = mavlink
ONBOARD_RATES: dict[int, float] = {
    _M.MAVLINK_MSG_ID_TIMESYNC: 10.0,
    _M.MAVLINK_MSG_ID_HIGHRES_IMU: 50.0,
    _M.MAVLINK_MSG_ID_LOCAL_POSITION_NED: 30.0,
    _M.MAVLINK_MSG_ID_ATTITUDE: 100.0,
    _M.MAVLINK_MSG_ID_ALTITUDE: 10.0,
    EscInfo.id: 10.0,
    EscStatus.id: 10.0,
    _M.MAVLINK_MSG_ID_ODOMETRY: 30.0,
    _M.MAVLINK_MSG_ID_ATTITUDE_QUATERNION: 50.0,
    _M.MAVLINK_MSG_ID_ATTITUDE_TARGET: 10.0,
    _M.MAVLINK_MSG_ID_BATTERY_STATUS: 0.5,
    _M.MAVLINK_MSG_ID_DISTANCE_SENSOR: 10.0,
    _M.MAVLINK_MSG_ID_ESTIMATOR_STATUS: 1.0,
    _M.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: 5.0,
    _M.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: 50.0,
    _M.MAVLINK_MSG_ID_GPS_RAW_INT: 8.0,
    _M.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN: 1.0,
    _M.MAVLINK_MSG_ID_HOME_POSITION: 0.5,
    _M.MAVLINK_MSG_ID_MISSION_CURRENT: 1.0,
    _M.MAVLINK_MSG_ID_PING: 1.0,
    _M.MAVLINK_MSG_ID_POSITION_TARGET_LOCAL_NED: 10.0,
    _M.MAVLINK_MSG_ID_SCALED_PRESSURE: 1.0,
    _M.MAVLINK_MSG_ID_SERVO_OUTPUT_RAW: 10.0,
    _M.MAVLINK_MSG_ID_SYS_STATUS: 5.0,
    _M.MAVLINK_MSG_ID_SYSTEM_TIME: 1.0,
    _M.MAVLINK_MSG_ID_VFR_HUD: 10.0,
    _M.MAVLINK_MSG_ID_VIBRATION: 0.5,
}
GCS_RATES: dict[int, float] = {
    _M.MAVLINK_MSG_ID_ALTITUDE: 1.0,
    _M.MAVLINK_MSG_ID_ATTITUDE: 15.0,
    _M.MAVLINK_MSG_ID_ATTITUDE_QUATERNION: 10.0,
    _M.MAVLINK_MSG_ID_ATTITUDE_TARGET: 2.0,
    _M.MAVLINK_MSG_ID_BATTERY_STATUS: 0.5,
    EscInfo.id: 1.0,
    EscStatus.id: 1.0,
    _M.MAVLINK_MSG_ID_ESTIMATOR_STATUS: 0.5,
    _M.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: 1.0,
    _M.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: 5.0,
    _M.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN: 1.0,
    _M.MAVLINK_MSG_ID_GPS_RAW_INT: 1.0,
    _M.MAVLINK_MSG_ID_HOME_POSITION: 0.5,
    _M.MAVLINK_MSG_ID_LOCAL_POSITION_NED: 1.0,
    _M.MAVLINK_MSG_ID_POSITION_TARGET_LOCAL_NED: 1.5,
    _M.MAVLINK_MSG_ID_SCALED_PRESSURE: 1.0,
    _M.MAVLINK_MSG_ID_SERVO_OUTPUT_RAW: 1.0,
    _M.MAVLINK_MSG_ID_SYS_STATUS: 1.0,
    _M.MAVLINK_MSG_ID_VFR_HUD: 4.0,
    _M.MAVLINK_MSG_ID_VIBRATION: 0.1,
}
DEFAULT_RATES: dict[Role, dict[int, float]] = {"onboard": ONBOARD_RATES, "gcs": GCS_RATES}
HEARTBEAT_PERIOD = 1.0


@dataclass(slots=True)
class _Stream:
    interval: float
    last: float


@dataclass(slots=True)
class Streams:
    """The streams of one link. All times in s.

    role: whose default rates apply.
    sendable: ids of the messages that the mock can make.
    seed: of the streams' phases.
    """

    role: Role
    sendable: frozenset[int]
    seed: int = 0
    _streams: dict[int, _Stream] = field(init=False, default_factory=dict)
    _random: random.Random = field(init=False)
    _heartbeat_at: float = 0.0

    def __post_init__(self) -> None:
        self._random = random.Random(self.seed)
        for identifier, rate in DEFAULT_RATES[self.role].items():
            self._start(identifier, 1.0 / rate, 0.0)

    def _start(self, identifier: int, interval: float, time: float) -> None:
        # PX4's streams do not start in step, so neither do these; but all are sent in passes of the loop, and a phase
        # between two passes would let some intervals escape the quantisation
        passes = round(time / STEP) - self._random.randrange(max(1, round(interval / STEP)))
        self._streams[identifier] = _Stream(interval, passes * STEP)

    def set_interval(self, time: float, identifier: int, interval_us: float) -> bool:
        """Apply SET_MESSAGE_INTERVAL (us; 0 the default rate, negative stops). False where PX4 answers FAILED."""
        if identifier not in self.sendable or identifier == mavlink.MAVLINK_MSG_ID_HEARTBEAT:
            return False
        if math.isnan(interval_us):
            return False
        if interval_us < 0:
            self._streams.pop(identifier, None)
            return True
        if interval_us == 0:
            rate = DEFAULT_RATES[self.role].get(identifier)
            if rate is None:
                self._streams.pop(identifier, None)
            else:
                self._start(identifier, 1.0 / rate, time)
            return True
        self._start(identifier, interval_us * 1e-6, time)
        return True

    def interval_us(self, identifier: int) -> int:
        """The interval that MESSAGE_INTERVAL reports: the requested one; -1 not sent, 0 unknown to the mock."""
        if identifier not in self.sendable:
            return 0
        stream = self._streams.get(identifier)
        return -1 if stream is None else round(stream.interval * 1e6)

    def due(self, time: float) -> list[int]:
        """The ids of the messages to send in the loop at a time; call it once per STEP."""
        identifiers = []
        if time >= self._heartbeat_at:
            identifiers.append(mavlink.MAVLINK_MSG_ID_HEARTBEAT)
            self._heartbeat_at += HEARTBEAT_PERIOD
        for identifier, stream in self._streams.items():
            elapsed = time - stream.last
            if elapsed > stream.interval - TOLERANCE:
                # as in PX4's MavlinkStream::update: keep the average rate unless that would mean a burst
                keeps_pace = elapsed < 1.5 * stream.interval
                stream.last = stream.last + stream.interval if keeps_pace else time
                identifiers.append(identifier)
        return identifiers


def loop_delay(source: random.Random) -> float:
    """How late, in s, one pass of PX4's mavlink loop sends what is due.

    Drawn so that a 10 ms stream has the measured spread of intervals (p1 5.9, p99 14.3, max 16.3 ms): most passes are
    on time, a few late by up to one loop.
    """
    draw = source.random()
    if draw < 0.90:
        return source.random() * 0.0003
    if draw < 0.955:
        return source.uniform(0.0003, 0.0021)
    if draw < 0.995:
        return source.uniform(0.0021, 0.0025)
    return source.uniform(0.0025, 0.0042)
