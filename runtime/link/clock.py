"""The vehicle's clock relative to ours: offset and drift from MAVLink's TIMESYNC exchanges.

A Kalman filter with two states, offset and drift (as in time-transfer filters for oscillators, e.g. Galleani and
Tavella 2010). A request sent at s and answered at r with the vehicle's time v bounds the offset to v - (s + r) / 2 by
plus or minus (r - s) / 2 (NTP, RFC 5905 section 8), taken as uniform in between. Where the stamps scatter more than
that, as those of a simulator that counts in steps of 4 ms do, the measurement noise is their own spread: the second
difference of the measured offsets, which neither offset nor drift enters. A lasting step is followed; it is a jump, an
event, only beyond what such clocks do.
"""

from __future__ import annotations

import math
from collections import deque
from typing import Literal

import msgspec

Verdict = Literal["accepted", "stepped", "slow", "outlier", "out_of_order", "jumped", "ran_backwards"]

# a Gaussian's standard deviation from the mean absolute second difference of its samples
_TO_SPREAD = math.sqrt(math.pi / 12)


class ClockLimits(msgspec.Struct, frozen=True):
    """The filter's noise, and when its result is valid; all times in s.

    stamp_noise: standard deviation of a time stamp, however short the round trip.
    one_way_noise: standard deviation of a vehicle stamp received without a round trip.
    drift_noise: standard deviation of the drift's change within one second.
    initial_drift: standard deviation of the drift at the start.
    initial_spread: standard deviation of the stamps before their own is measured.
    spread_samples: exchanges over which that is measured.
    outlier: innovation in standard deviations beyond which a sample is rejected.
    step_samples: consecutive outliers that agree with each other and are followed as a step.
    jump: offset, beyond which and beyond `outlier` spreads a step is a jump. PX4's simulator steps by up to 18 ms, and
        an age that is wrong by more than this is half of what makes an estimate stale.
    jump_samples: consecutive outliers that agree with each other, after which a jump restarts the filter.
    slow_factor: medians beyond which a round trip is rejected.
    min_samples: before the conversion is valid.
    max_uncertainty: standard deviation of the offset up to which it is valid.
    max_silence: without a sample until it is invalid.
    """

    stamp_noise: float = 5e-5
    one_way_noise: float = 3e-3
    drift_noise: float = 3e-3
    initial_drift: float = 0.02
    initial_spread: float = 2e-3
    spread_samples: int = 30
    outlier: float = 5.0
    step_samples: int = 2
    jump: float = 0.03
    jump_samples: int = 5
    slow_factor: float = 3.0
    min_samples: int = 5
    max_uncertainty: float = 5e-3
    max_silence: float = 3.0


class VehicleClock:
    """Converts vehicle time to ours and back.

    Times are seconds, on our monotonic clock or on the vehicle's since its boot, and always arguments.

    samples: accepted since the last restart.
    resets: restarts because the vehicle's clock jumped or ran backwards.
    """

    def __init__(self, limits: ClockLimits | None = None) -> None:
        self._limits = limits or ClockLimits()
        self.resets = 0
        self.reset()

    def reset(self) -> None:
        """Restart without samples, as after a reboot of the vehicle."""
        self._offset, self._drift = 0.0, 0.0
        self._variance = (1.0, 0.0, self._limits.initial_drift**2)  # of the offset, covariance, of the drift
        self._updated = 0.0
        self._latest_sent = float("-inf")
        self._latest_remote = float("-inf")
        self._latest_two_way = float("-inf")
        self._round_trips: deque[float] = deque(maxlen=50)
        self._outliers: list[tuple[float, float]] = []
        self._measured: deque[float] = deque(maxlen=3)
        limits = self._limits
        self._scatter = deque([limits.initial_spread / _TO_SPREAD] * limits.spread_samples, limits.spread_samples)
        self.samples = 0
        self._valid_until = float("-inf")

    def handle(self, sent: float, received: float, remote: float) -> Verdict:
        """Add a TIMESYNC exchange. sent, received: of request and answer, our clock. remote: the vehicle's stamp."""
        round_trip = received - sent
        if sent <= self._latest_sent or round_trip < 0.0:
            return "out_of_order"
        self._latest_sent = sent
        if not self.is_two_way:
            self.samples = 0  # the first exchange replaces all stamps before it, which were late by the link's delay
        middle = (sent + received) / 2
        self._round_trips.append(round_trip)
        verdict = self._handle_stamp(middle, remote, round_trip / 12**0.5, self._is_slow(round_trip))
        self._latest_two_way = received
        self._valid_until = self._find_valid_until()
        return verdict

    def handle_one_way(self, received: float, remote: float) -> Verdict | None:
        """Add a stamp of the vehicle without a round trip; used only while no exchange is answered."""
        if received - self._latest_two_way < self._limits.max_silence:
            return None
        if received <= self._updated:
            return "out_of_order"
        verdict = self._handle_stamp(received, remote, self._limits.one_way_noise, False)
        self._valid_until = self._find_valid_until()
        return verdict

    def _is_slow(self, round_trip: float) -> bool:
        median = sorted(self._round_trips)[len(self._round_trips) // 2]
        return len(self._round_trips) >= 5 and round_trip > self._limits.slow_factor * median + 1e-3

    @property
    def spread(self) -> float:
        """Standard deviation of the stamps about the clock, as measured, s."""
        return _TO_SPREAD * sum(self._scatter) / len(self._scatter)

    def _scatters(self, measured: float) -> None:
        """Enter a measured offset into the spread; a lost sample counts as scatter."""
        self._measured.append(measured)
        if len(self._measured) == 3:
            first, second, third = self._measured
            self._scatter.append(min(abs(third - 2 * second + first), self._limits.jump))

    def _handle_stamp(self, ours: float, remote: float, noise: float, slow: bool) -> Verdict:
        measured = remote - ours
        if self.samples and remote < self._latest_remote - noise - self._limits.max_uncertainty:
            self._start_again(ours, remote, noise)
            return "ran_backwards"
        if slow:
            return "slow"
        self._latest_remote = remote
        if self.samples == 0:
            self._start(ours, measured, noise)
            return "accepted"
        self._scatters(measured)
        offset, variance = self._predict(ours)
        innovation = measured - offset
        spread = max(noise**2 + self._limits.stamp_noise**2, self.spread**2)
        if innovation**2 > self._limits.outlier**2 * (variance[0] + spread):
            return self._handle_outlier(ours, remote, noise, innovation, spread)
        self._outliers.clear()
        self._update(ours, innovation, spread)
        return "accepted"

    def _start(self, ours: float, measured: float, noise: float) -> None:
        self._offset, self._drift, self._updated = measured, 0.0, ours
        self._variance = (noise**2 + self._limits.stamp_noise**2, 0.0, self._limits.initial_drift**2)
        self.samples = 1

    def _start_again(self, ours: float, remote: float, noise: float) -> None:
        sent, two_way, round_trips = self._latest_sent, self._latest_two_way, self._round_trips
        self.reset()
        self._latest_sent, self._latest_two_way, self._round_trips = sent, two_way, round_trips
        self._latest_remote = remote
        self._start(ours, remote - ours, noise)
        self.resets += 1

    def _handle_outlier(self, ours: float, remote: float, noise: float, innovation: float, spread: float) -> Verdict:
        measured, limits = remote - ours, self._limits
        if self._outliers:
            time, previous = self._outliers[-1]
            if abs(measured - previous) > 2 * noise + limits.initial_drift * (ours - time) + limits.max_uncertainty:
                self._outliers.clear()
        self._outliers.append((ours, measured))
        if abs(innovation) <= max(limits.jump, limits.outlier * spread**0.5):
            if len(self._outliers) < limits.step_samples:
                return "outlier"
            offset, covariance, drift = self._variance
            self._variance = (offset + innovation**2, covariance, drift)
            self._outliers.clear()
            self._update(ours, innovation, spread)
            return "stepped"
        if len(self._outliers) < limits.jump_samples:
            return "outlier"
        self._start_again(ours, remote, noise)
        return "jumped"

    def _predict(self, ours: float) -> tuple[float, tuple[float, float, float]]:
        step = max(0.0, ours - self._updated)
        offset, covariance, drift = self._variance
        noise = self._limits.drift_noise**2
        variance = (
            offset + 2 * step * covariance + step**2 * drift + noise * step**3 / 3,
            covariance + step * drift + noise * step**2 / 2,
            drift + noise * step,
        )
        return self._offset + self._drift * (ours - self._updated), variance

    def _update(self, ours: float, innovation: float, spread: float) -> None:
        """Correct the state by an innovation, s. spread: variance of its measurement, s^2."""
        offset, variance = self._predict(ours)
        gain_offset, gain_drift = variance[0] / (variance[0] + spread), variance[1] / (variance[0] + spread)
        self._offset, self._drift = offset + gain_offset * innovation, self._drift + gain_drift * innovation
        self._variance = (
            (1 - gain_offset) * variance[0],
            (1 - gain_offset) * variance[1],
            variance[2] - gain_drift * variance[1],
        )
        self._updated = ours
        self.samples += 1

    def offset(self, ours: float) -> float:
        """Vehicle time minus ours at a time on our clock, s."""
        return self._offset + self._drift * (ours - self._updated)

    def to_ours(self, remote: float) -> float:
        """The time on our clock, s, of a time on the vehicle's."""
        return self._updated + (remote - self._offset - self._updated) / (1.0 + self._drift)

    @property
    def conversion(self) -> tuple[float, float, float, float]:
        """Time of the last sample, s, offset then, s, drift, and until when they are valid, s: those of `to_ours`."""
        return self._updated, self._offset, self._drift, self._valid_until

    def to_vehicle(self, ours: float) -> float:
        """The time on the vehicle's clock, s, of a time on ours."""
        return ours + self.offset(ours)

    def is_valid(self, now: float) -> bool:
        """Whether enough recent samples agree for use in flight. now: our clock, s."""
        return now < self._valid_until

    def _find_valid_until(self) -> float:
        limits, end = self._limits, self._updated + self._limits.max_silence
        if self.samples < limits.min_samples or self.uncertainty(self._updated) >= limits.max_uncertainty:
            return float("-inf")
        while self.uncertainty(end) >= limits.max_uncertainty:
            end -= 0.1
        return end

    def uncertainty(self, now: float) -> float:
        """Standard deviation of the offset, s; an asymmetric path is not included."""
        return float(self._predict(now)[1][0] ** 0.5)

    @property
    def drift(self) -> float:
        """Seconds that the vehicle's clock gains on ours in one second."""
        return self._drift

    @property
    def is_two_way(self) -> bool:
        """Whether the vehicle answers TIMESYNC, so that the link's delay is measured."""
        return self._latest_two_way > float("-inf")

    @property
    def round_trip(self) -> float:
        """Median round trip of the last 50 exchanges, s; nan before the first."""
        return sorted(self._round_trips)[len(self._round_trips) // 2] if self._round_trips else float("nan")
