"""Power and margin: battery voltage under load, the rotors' share of their range, time at the limit."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from dynamics.arrays import Floats
from flights.health.answer import Certainty, Evidence, Level, Statement
from flights.health.record import Record, Series, spans
from flights.health.rotors import hover_rows
from flights.health.thresholds import AT_LIMIT, CELL, HOVER_SHARE, NEAR_LIMIT, PLAUSIBLE_CELL, SAG, Limit

FULL_CELL = 4.25  # V, a little above 4.2: the least number of cells that the voltage at rest can have
SMOOTHED = 1.0  # s
REST = 3.0  # s before the load and after it between which a sag is read
MIN_HOVER_ROWS = 10  # of the outputs, one second at PX4's default rate


def level_of(value: float, limit: Limit) -> Level | None:
    """The level of a value that should be small; None below both limits."""
    return "fault" if value > limit.fault else "warning" if value > limit.warning else None


def battery_statements(record: Record) -> Iterator[Statement]:
    """Whether the battery is measured, how low it goes under load, and how much it sags."""
    series = voltage(record)
    if series is None:
        return
    flown = series.within(record.start, record.end)
    if not len(flown.values):
        return
    highest = float(np.max(series.values))
    if highest < PLAUSIBLE_CELL:
        text = (
            f"the battery is not measured: {flown.channel} reads {np.median(flown.values):.2f} V in flight, which no "
            "vehicle flies with: nothing about its charge can be told"
        )
        usual = float(np.median(flown.values))
        evidence = Evidence(float(series.time[0]), record.end, flown.channel, usual, "V", PLAUSIBLE_CELL)
        advice = "connect or set up the battery's sensor (BAT1_V_DIV, BAT1_V_CHANNEL; BATT_MONITOR in ArduPilot)"
        yield Statement("battery_not_measured", "warning", "seen", text, evidence, advice=advice)
        return
    cells = record.autopilot.cells or max(1, int(np.ceil(highest / FULL_CELL)))
    per_cell = Series(flown.time, _smoothed(flown.time, flown.values) / cells, flown.channel)
    yield from _low(record, per_cell, cells)
    yield from _sag(record, series, cells)


def voltage(record: Record) -> Series | None:
    """The pack's voltage, as the autopilot logs it or as the flight has it."""
    own = record.autopilot.pack_voltage
    if own is None:
        signal = record.values("battery_voltage")
        if signal is None:
            return None
        own = Series(signal[0], signal[1][:, 0], signal[2])
    own = own.finite()
    return own if len(own.values) > 1 else None


def _smoothed(time: Floats, values: Floats) -> Floats:
    """Means over SMOOTHED, which a single sample does not decide."""
    width = max(1, round(SMOOTHED / max(float(np.median(np.diff(time))), 1e-3))) if len(time) > 1 else 1
    padded = np.pad(values, (width // 2, width - 1 - width // 2), mode="edge")
    return np.convolve(padded, np.ones(width) / width, mode="valid")


def _low(record: Record, per_cell: Series, cells: int) -> Iterator[Statement]:
    lowest = float(per_cell.values.min())
    limit = CELL.warning if record.autopilot.cells else CELL.fault
    below = spans(per_cell.time, per_cell.values < limit, SMOOTHED)
    shown = f"{lowest:.2f} V a cell ({cells} cells) under load"
    if not below:
        evidence = Evidence(record.start, record.end, f"{per_cell.channel} a cell", lowest, "V", limit)
        yield Statement("battery", "note", "seen", f"the battery keeps at least {shown}", evidence)
        return
    level: Level = "fault" if lowest < CELL.fault and record.autopilot.cells else "warning"
    end = below[-1][1]
    evidence = Evidence(below[0][0], end, f"{per_cell.channel} a cell", lowest, "V", limit)
    certainty: Certainty = "seen" if record.autopilot.cells else "likely"
    text = f"the battery falls to {shown} from {below[0][0]:.1f} s on: empty, too small or too old for this load"
    yield Statement(
        "battery_low", level, certainty, text, evidence, advice="charge or replace the battery; land earlier"
    )


def _sag(record: Record, series: Series, cells: int) -> Iterator[Statement]:
    """Fall from before the take-off to shortly after it, over the former."""
    if not record.flights:
        return
    before = series.within(record.start - 10.0, record.start - 0.2)
    after = series.within(record.start + 1.0, record.start + 1.0 + REST)
    command = record.commands()
    if len(before.values) < 3 or len(after.values) < 3:
        return
    rest = float(np.max(before.values))
    if command is not None:
        idle = command[1][(command[0] >= before.time[0]) & (command[0] <= before.time[-1])]
        if len(idle) and np.nanmedian(idle) > 0.3:  # loaded already
            return
    share = 1 - float(np.median(after.values)) / rest
    level = level_of(share, SAG)
    if level is None or rest < PLAUSIBLE_CELL * cells:
        return
    text = (
        f"the battery sags by {100 * share:.0f} % of its {rest:.1f} V when the rotors take their load: its resistance "
        "or that of its connectors is high"
    )
    evidence = Evidence(record.start, record.start + 1 + REST, series.channel, share, "1", SAG.warning)
    advice = "measure the battery's internal resistance, look at its connectors; use one with a higher discharge rate"
    yield Statement("voltage_sag", level, "seen", text, evidence, advice=advice)


def margin_statements(record: Record) -> Iterator[Statement]:
    """The share of the range that hover takes, and the time in which a rotor is at its limit."""
    signal = record.commands()
    if signal is None:
        return
    time, command, source = signal
    air = record.airborne(time, 0.5) & np.isfinite(command).all(axis=1)
    if air.sum() < MIN_HOVER_ROWS:
        return
    rows = hover_rows(record, time) & air
    hovers = int(rows.sum()) >= MIN_HOVER_ROWS
    basis, where = (command[rows], "in hover") if hovers else (command[air], "in flight")
    share = float(np.median(basis.mean(axis=1)))
    evidence = Evidence(record.start, record.end, f"{source}, mean {where}", share, "1", HOVER_SHARE.warning)
    level = level_of(share, HOVER_SHARE) if hovers else None  # manoeuvres take more than the weight does
    text = f"the rotors work at {100 * share:.0f} % of their range {where}"
    if level is None:
        yield Statement("margin", "note", "seen", text, evidence)
    else:
        advice = "take weight off, or fit larger propellers, motors or a battery of more cells"
        yield Statement("low_margin", level, "seen", f"{text}: too heavy for its motors", evidence, advice=advice)
    at_limit = np.asarray((command >= NEAR_LIMIT).any(axis=1))
    limited = float(at_limit[air].mean())
    level = level_of(limited, AT_LIMIT)
    if level is not None:
        begins = float(time[air & at_limit][0])
        rotor = int((command[air] >= NEAR_LIMIT).sum(axis=0).argmax())
        text = (
            f"a rotor is at its upper limit in {100 * limited:.0f} % of the flight, mostly {record.motor_name(rotor)}: "
            "attitude and yaw are not held there"
        )
        evidence = Evidence(begins, record.end, f"{source} >= {NEAR_LIMIT}", limited, "1", AT_LIMIT.warning)
        yield Statement("saturation", level, "seen", text, evidence, rotor, "fly slower, or with less weight")
