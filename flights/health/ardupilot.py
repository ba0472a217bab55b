"""Health channels of an ArduPilot DataFlash log.

Fields: ArduPilot's message reference (ardupilot.org/copter/docs/logmessages.html); error codes: its page on EV and ERR.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np

from flights.health.answer import HealthEvent
from flights.health.record import AutopilotSeries, Series
from flights.readers.dataflash_messages import Messages, read_messages

NAMES = ("VIBE", "XKF4", "NKF4", "GPS", "ERR", "EV", "MODE", "MSG", "BAT", "CURR", "ARM", "XKF3", "NKF3")
RATIOS = {"velocity": "SV", "position": "SP", "height": "SH", "magnetometer": "SM"}
MODES = {0: "Stabilize", 1: "Acro", 2: "AltHold", 3: "Auto", 4: "Guided", 5: "Loiter", 6: "RTL", 7: "Circle", 9: "Land",
         11: "Drift", 13: "Sport", 14: "Flip", 15: "AutoTune", 16: "PosHold", 17: "Brake", 18: "Throw",
         19: "Avoid ADSB",
         20: "Guided without GPS", 21: "SmartRTL", 22: "FlowHold", 23: "Follow", 24: "ZigZag", 25: "System ID",
         26: "Autorotate", 27: "Auto RTL"}  # fmt: skip
SUBSYSTEMS = {2: "radio", 3: "compass", 5: "radio failsafe", 6: "battery failsafe", 8: "ground station failsafe",
              9: "fence", 10: "flight mode refused", 11: "GPS", 12: "crash check", 13: "flip", 15: "parachute",
              16: "EKF check", 17: "EKF failsafe", 18: "barometer", 19: "CPU load", 20: "ADSB", 21: "terrain",
              22: "navigation", 23: "terrain failsafe", 24: "EKF primary changed", 25: "thrust loss check",
              26: "sensor failsafe", 28: "pilot input", 29: "vibration failsafe", 30: "internal error",
              31: "dead-reckoning failsafe"}  # fmt: skip
EVENTS = {10: ("armed", "armed"), 11: ("disarmed", "disarmed"), 18: ("landed", "landed"), 28: ("takeoff", "took off"),
          17: ("maybe_landed", "maybe landed"), 54: ("kill", "motors emergency stop"),
          62: ("yaw_reset", "EKF yaw reset")}  # fmt: skip
PARACHUTE, CRASH, GPS_GLITCH = 15, 12, 11


def read(file: Path, start: float) -> AutopilotSeries:
    """The channels of an unpacked log. start: the log's time 0 on the file's clock, s."""
    with np.errstate(all="ignore"):
        messages = {name: rows for name, rows in read_messages(file, NAMES).messages.items() if rows.has("TimeUS")}
        filtered = "XKF4" if "XKF4" in messages else "NKF4"
        core = _first(messages.get(filtered))
        primary = _series(core, filtered, "PI", start)
        battery = "BAT" if "BAT" in messages else "CURR"
        gps = _first(messages.get("GPS"))
        events = tuple(_events(messages, start))
        return AutopilotSeries(
            vibration=tuple(_vibration(messages.get("VIBE"), start)),
            vibration_of="ArduPilot",
            clipping=tuple(_clipping(messages.get("VIBE"), start)),
            test_ratios={
                name: series
                for name, field in RATIOS.items()
                if (series := _series(core, filtered, field, start)) is not None
            },
            instance=primary,
            gps_fix=_series(gps, "GPS", "Status", start),
            gps_satellites=_series(gps, "GPS", "NSats", start),
            pack_voltage=_series(_first(messages.get(battery)), battery, "Volt", start),
            flags=_flags(messages.get("ERR"), start),
            events=events,
            landed=_landed(events),
            uses_gps=None if gps is None else True,
        )


def _first(rows: Messages | None) -> Messages | None:
    """The messages of the first core or instance."""
    if rows is None:
        return None
    for field in ("C", "I", "Instance", "Inst"):
        if rows.has(field):
            rows = rows.of(rows.integers(field) == 0)
    return rows if len(rows.rows) else None


def _time(rows: Messages, start: float) -> np.ndarray:
    return np.asarray(rows.integers("TimeUS") * 1e-6 - start)


def _series(rows: Messages | None, name: str, field: str, start: float) -> Series | None:
    if rows is None or not rows.has(field):
        return None
    return Series(_time(rows, start), rows.numbers(field), f"{name}.{field}")


def _by_instance(rows: Messages | None) -> Iterator[tuple[int, Messages]]:
    if rows is None:
        return
    field = next((name for name in ("IMU", "I") if rows.has(name)), None)
    if field is None:
        yield 0, rows
        return
    numbers = rows.integers(field)
    for number in np.unique(numbers).tolist():
        yield number, rows.of(numbers == number)


def _vibration(rows: Messages | None, start: float) -> Iterator[Series]:
    """The largest of the three axes, m/s^2."""
    for number, own in _by_instance(rows):
        axes = np.stack([own.numbers(f"Vibe{axis}") for axis in "XYZ"], axis=1)
        yield Series(_time(own, start), axes.max(axis=1), f"VIBE[{number}]")


def _clipping(rows: Messages | None, start: float) -> Iterator[Series]:
    for number, own in _by_instance(rows):
        fields = ["Clip"] if own.has("Clip") else [f"Clip{k}" for k in range(3) if own.has(f"Clip{k}")]
        for field in fields:
            yield Series(_time(own, start), own.numbers(field), f"VIBE[{number}].{field}")


def _flags(rows: Messages | None, start: float) -> dict[str, Series]:
    """Errors by subsystem: 1 from the error until its end (code 0)."""
    if rows is None:
        return {}
    time, systems, codes = _time(rows, start), rows.integers("Subsys"), rows.integers("ECode")
    by_subsystem = {}
    for number, name in SUBSYSTEMS.items():
        own = systems == number
        if own.any():
            by_subsystem[name] = Series(time[own], (codes[own] != 0).astype(float), f"ERR.Subsys {number}")
    return by_subsystem


def _events(messages: Mapping[str, Messages], start: float) -> Iterator[HealthEvent]:
    if (rows := messages.get("MODE")) is not None:
        numbers = rows.integers("ModeNum" if rows.has("ModeNum") else "Mode").tolist()
        for time, number in zip(_time(rows, start).tolist(), numbers, strict=True):
            yield HealthEvent(time, "mode", f"mode {MODES.get(number, number)}", "MODE")
    if (rows := messages.get("EV")) is not None:
        for time, number in zip(_time(rows, start).tolist(), rows.integers("Id").tolist(), strict=True):
            if number in EVENTS:
                yield HealthEvent(time, *EVENTS[number], f"EV.Id {number}")
    if (rows := messages.get("ERR")) is not None:
        pairs = zip(rows.integers("Subsys").tolist(), rows.integers("ECode").tolist(), strict=True)
        for time, (system, code) in zip(_time(rows, start).tolist(), pairs, strict=True):
            name = SUBSYSTEMS.get(system, f"subsystem {system}")
            text = f"{name}: over" if code == 0 else f"{name}: error {code}"
            if system == CRASH and code:
                text = "crash check: hit the ground or lost control, disarmed"
            yield HealthEvent(time, name.replace(" ", "_"), text, f"ERR.Subsys {system}, ECode {code}")
    if (rows := messages.get("MSG")) is not None and rows.has("Message"):
        for time, text in zip(_time(rows, start).tolist(), rows.texts("Message"), strict=True):
            yield HealthEvent(time, "message", text.split("\0")[0].strip(), "MSG")


def _landed(events: tuple[HealthEvent, ...]) -> Series | None:
    """The land detector by its events, in the order of time."""
    steps = sorted((e.time, float(e.name != "takeoff")) for e in events if e.name in ("landed", "takeoff", "disarmed"))
    if not any(value == 0.0 for _, value in steps):
        return None
    time, values = np.array(steps).T
    return Series(time, values, "EV")
