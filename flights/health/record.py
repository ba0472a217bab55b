"""Health channels of one log, in the log's time: the flight's own streams, and what the autopilot says of itself."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from dynamics.arrays import Floats
from flights.exclusion import excluded_rows, find_exclusions
from flights.filters import runs
from flights.flight import Flight
from flights.health.answer import HealthEvent
from flights.log import Log
from flights.rotor_layout import RotorLayout, rotor_layout

NEAR_GROUND = 1.0  # m above the lowest sample: the estimate's height drifts by so much in a flight
MOVES = 0.02  # of the range that commands cover at least; less is a column that nothing is connected to


@dataclass(frozen=True, eq=False)
class Series:
    """One channel. time: (n,) s since the log's start. values: (n,). channel: topic and field."""

    time: Floats
    values: Floats
    channel: str

    def within(self, start: float, end: float) -> Series:
        """The samples of a span of time."""
        rows = (self.time >= start) & (self.time <= end)
        return Series(self.time[rows], self.values[rows], self.channel)

    def finite(self) -> Series:
        """The samples that are numbers."""
        rows = np.isfinite(self.values)
        return Series(self.time[rows], self.values[rows], self.channel)


@dataclass(frozen=True, eq=False)
class AutopilotSeries:
    """Channels that an autopilot logs of itself beside the flight, each where it is logged.

    vibration: high-frequency acceleration, m/s^2, one for each accelerometer. vibration_of: "PX4" or "ArduPilot".
    clipping: samples at the accelerometer's limit since the start, one for each accelerometer.
    test_ratios: innovation over its gate by quantity. rejected: 1 where a measurement is rejected, by quantity.
    jumps: changes of the estimate by a reset, by quantity: size at the time of each.
    instance: of the estimator that is used.
    gps_fix, gps_satellites, gps_accuracy: of the receiver; accuracy in m.
    pack_voltage, cells, battery_warning: as logged, V.
    flags: 1 while a failsafe or failure is reported, by its name.
    esc_failures: bits of each ESC's failures, by motor from 1.
    landed: 1 on the ground, where the flight's own streams lack it.
    uses_gps: whether the estimator used it at any time; None where this is not logged.
    """

    vibration: tuple[Series, ...] = ()
    vibration_of: str = "PX4"
    clipping: tuple[Series, ...] = ()
    test_ratios: Mapping[str, Series] = field(default_factory=dict)
    rejected: Mapping[str, Series] = field(default_factory=dict)
    jumps: Mapping[str, Series] = field(default_factory=dict)
    instance: Series | None = None
    gps_fix: Series | None = None
    gps_satellites: Series | None = None
    gps_accuracy: Series | None = None
    pack_voltage: Series | None = None
    cells: int = 0
    battery_warning: Series | None = None
    flags: Mapping[str, Series] = field(default_factory=dict)
    esc_failures: Mapping[int, Series] = field(default_factory=dict)
    events: tuple[HealthEvent, ...] = ()
    landed: Series | None = None
    uses_gps: bool | None = None


@dataclass(frozen=True, eq=False)
class Record:
    """One flight's channels.

    flights: start and end of each time in the air, s.
    layout: of the rotors, where the log states it and it has as many as the log.
    """

    log: Log
    autopilot: AutopilotSeries
    flights: tuple[tuple[float, float], ...]
    layout: RotorLayout | None

    @property
    def in_air(self) -> float:
        """Time in the air, s."""
        return sum(end - start for start, end in self.flights)

    @property
    def start(self) -> float:
        """First take-off, or the log's start."""
        return self.flights[0][0] if self.flights else 0.0

    @property
    def end(self) -> float:
        """Last landing, or the log's end."""
        return self.flights[-1][1] if self.flights else self.log.duration

    def airborne(self, time: Floats, margin: float = 0.0) -> NDArray[np.bool_]:
        """(n,) which times are in the air, away from take-off and landing by a margin, s."""
        rows = np.zeros(len(time), dtype=bool)
        for start, end in self.flights:
            rows |= (time >= start + margin) & (time <= end - margin)
        return rows

    def values(self, name: str) -> tuple[Floats, Floats, str] | None:
        """Time, (n, k) values and source of a quantity's rows with numbers, of a position its height; None without."""
        stream = self.log.stream(name)
        if stream is None:
            return None
        numbers = np.isfinite(stream.values)
        rows = numbers[:, 2] if name == "position" else numbers.all(axis=1)
        return (stream.time[rows], stream.values[rows], stream.source) if rows.sum() > 1 else None

    def commands(self) -> tuple[Floats, Floats, str] | None:
        """Rotor commands that are more than a column of constants, else None."""
        signal = self.values("rotor_command")
        if (
            signal is None
            or not np.isfinite(signal[1]).any()
            or float(np.nanmax(signal[1]) - np.nanmin(signal[1])) < MOVES
        ):
            return None
        return signal

    def clear_of_ground(self, time: Floats) -> NDArray[np.bool_]:
        """(n,) which times are at a height where the ground carries nothing, as far as the log tells."""
        signal = self.values("position")
        if signal is None or not np.isfinite(signal[1][:, 2]).any():
            return np.ones(len(time), dtype=bool)
        height = signal[1][:, 2] - np.nanmin(signal[1][:, 2])
        limit = min(NEAR_GROUND, 0.4 * float(np.nanmax(height)))
        return np.asarray(np.interp(time, signal[0], np.nan_to_num(height)) > limit)

    def until(self, end: float) -> Record:
        """The record with its times in the air cut at a time, s."""
        flights = tuple((start, min(stop, end)) for start, stop in self.flights if start < end)
        return replace(self, flights=flights)

    def motor_name(self, rotor: int) -> str:
        """The autopilot's number of a rotor's motor and its place."""
        if self.layout is None:
            return f"rotor {rotor}"
        x, y, _ = self.layout.position[rotor]
        reach = max(abs(v) for place in self.layout.position for v in place[:2])
        lengthwise = "front" if x > 0.2 * reach else "back" if x < -0.2 * reach else ""
        sideways = "left" if y > 0.2 * reach else "right" if y < -0.2 * reach else ""
        return f"motor {self.layout.motor[rotor]} ({' '.join(filter(None, (lengthwise, sideways))) or 'centre'})"


def build_record(log: Log, autopilot: AutopilotSeries) -> Record:
    """The channels of a log."""
    command = log.stream("rotor_command") or log.stream("rotor_speed_command") or log.stream("rotor_speed")
    kind = log.metadata.get("vehicle_type")
    layout = rotor_layout(log.parameters, int(kind) if kind else None)
    count = 0 if command is None else command.values.shape[1]
    if layout is not None and len(layout.position) != count:
        layout = None
    return Record(log, autopilot, _times_in_air(log, autopilot.landed), layout)


def _times_in_air(log: Log, reported: Series | None) -> tuple[tuple[float, float], ...]:
    """Spans between take-off and landing: by the land detector, or else where `flights.exclusion` finds no ground."""
    if not log.streams:
        return ()
    end = max(float(stream.time[-1]) for stream in log.streams)
    landed, armed = log.stream("landed"), log.stream("armed")
    if landed is not None and len(landed.time):
        flying = landed.values[:, 0] == 0
        time = landed.time
    elif reported is not None and len(reported.time):
        flying, time = reported.values == 0, reported.time
    else:
        flight = Flight.from_log(log)
        standing = [item for item in find_exclusions(flight) if item.reason == "ground"]
        flying, time = ~excluded_rows(flight, standing), flight.time
    if armed is not None and len(armed.time):
        rows = np.searchsorted(armed.time, time, side="right") - 1
        flying = flying & (armed.values[np.maximum(rows, 0), 0] != 0)
    spans = []
    for start, stop in runs(flying):
        last = float(time[stop]) if stop < len(time) else end
        if last - float(time[start]) > 1.0:
            spans.append((max(0.0, float(time[start])), last))
    return tuple(spans)


def spans(time: Floats, flags: NDArray[np.bool_], shortest: float) -> list[tuple[float, float]]:
    """Start and end, s, of the runs of true flags that last so long, a lone sample counting to the next one."""
    times = []
    for start, stop in runs(flags):
        last = float(time[min(stop, len(time) - 1)])
        if last - float(time[start]) >= shortest:
            times.append((float(time[start]), last))
    return times
